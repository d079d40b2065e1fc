"""A drum that turns and the boxes in it, which never come to rest."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

import dc_kernels as dc
from dc_kernels.model.settings import Count, Limits, NotNegative, Positive
from pipeline.scenes.base import Scene

PITCH = 1.6
"""Distance of two boxes that begin side by side, over their side; that of Box2D's benchmark of this name [1]."""


@dataclass(frozen=True, kw_only=True)
class Tumbler(Scene):
    """Boxes in a closed square drum that turns about its middle at a constant rate."""

    name: ClassVar[str] = "tumbler"

    bodies: Count = 100
    """Number of boxes [1]."""
    half_width: Positive = 0.5
    """Half of the boxes' side [m]."""
    rate: float = 0.4363
    """Angular velocity of the drum, 25 degrees in a second [rad/s]."""
    filling: Annotated[float, Limits(above=0.0, most=0.38)] = 0.35
    """Share of the drum that the boxes fill, at most 0.38, so that they have room where they begin [1]."""
    jitter: NotNegative = 0.02
    """Largest offset of a box to each side and up or down, uniform [half_width]."""

    @property
    def side(self) -> float:
        """Inner width and height of the drum [m]."""
        pitch = 2.0 * self.half_width * PITCH
        fill = 2.0 * self.half_width * math.sqrt(self.bodies / self.filling)
        return max(fill, pitch * math.ceil(math.sqrt(self.bodies)))

    def add_bodies(self, builder: dc.ModelBuilder, stream: np.random.Generator) -> None:
        """Add the drum about the origin and the boxes in a square grid, each turned a little."""
        half, wall = 0.5 * self.side, self.half_width
        drum = builder.add_body(angular_velocity=self.rate, type=dc.BodyType.KINEMATIC)
        material = {**self.material}
        del material["density"]
        for x, y in ((0.0, -1.0), (0.0, 1.0), (-1.0, 0.0), (1.0, 0.0)):
            size = (half + 2.0 * wall, wall) if y else (wall, half)
            builder.add_box(drum, *size, center=((half + wall) * x, (half + wall) * y), **material)
        columns = math.ceil(math.sqrt(self.bodies))
        places = np.stack(np.divmod(np.arange(self.bodies), columns), axis=1)[:, ::-1] - 0.5 * (columns - 1)
        offsets = self.half_width * self.jitter * stream.uniform(-1.0, 1.0, (self.bodies, 2))
        centres = 2.0 * self.half_width * PITCH * places + offsets
        for place, turn in zip(centres, stream.uniform(-0.05, 0.05, self.bodies)):
            body = builder.add_body((float(place[0]), float(place[1])), angle=float(turn))
            builder.add_box(body, self.half_width, self.half_width, **self.material)
