"""Shapes of every kind in an open box."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

import dc_kernels as dc
from dc_kernels.model.settings import Count, Limits, Positive
from dc_kernels.model.shapes import MAX_VERTICES
from pipeline.scenes.base import Scene
from pipeline.scenes.discs import box_side
from pipeline.scenes.placement import CLEARANCE, place_discs


@dataclass(frozen=True, kw_only=True)
class Mixed(Scene):
    """Discs, boxes, polygons of 3 to 8 vertices and capsules of random sizes, which fall into an open box."""

    name: ClassVar[str] = "mixed"

    bodies: Count = 100
    """Bodies in each world [1]."""
    radius: Positive = 0.5
    """Radius of the largest body [m]."""
    size_ratio: Annotated[float, Limits(least=1.0)] = 2.0
    """Ratio of the largest radius to the smallest [1]."""

    @property
    def side(self) -> float:
        """Width and height of the box, which is as full as that of the thesis protocol would be with discs [m]."""
        return box_side(self.bodies, self.radius)

    def add_bodies(self, builder: dc.ModelBuilder, stream: np.random.Generator) -> None:
        """Add the box and the bodies, whose kinds take turns; each lies inside a disc of its size."""
        self.add_open_box(builder, self.side, self.side)
        free = self.side - 2.0 * self.radius

        def sample(first: int, count: int) -> np.ndarray:
            return stream.random((count, 2)) * free

        centres = place_discs([sample], self.bodies, 2.0 * self.radius, (free, free))[0] + self.radius
        for i, centre in enumerate(centres):
            size = self.radius * float(stream.uniform(1.0 / self.size_ratio, 1.0)) * (1.0 - CLEARANCE)
            angle = float(stream.uniform(-math.pi, math.pi))
            body = builder.add_body((float(centre[0]), float(centre[1])), angle=angle)
            kind = i % 4
            if kind == 0:
                builder.add_disc(body, size, **self.material)
            elif kind == 1:
                slant = float(stream.uniform(0.2, 0.3)) * math.pi
                builder.add_box(body, size * math.cos(slant), size * math.sin(slant), **self.material)
            elif kind == 2:
                count = int(stream.integers(3, MAX_VERTICES + 1))
                turn = (np.arange(count) + stream.uniform(-0.3, 0.3, count)) * (2.0 * math.pi / count)
                builder.add_polygon(body, size * np.stack([np.cos(turn), np.sin(turn)], axis=1), **self.material)
            else:
                thickness = size * float(stream.uniform(0.3, 0.6))
                reach = size - thickness
                builder.add_capsule(body, (-reach, 0.0), (reach, 0.0), thickness, **self.material)
