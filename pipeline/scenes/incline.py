"""A body on a slope."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np

import dc_kernels as dc
from dc_kernels.model.settings import Limits, Positive
from pipeline.scenes.base import Scene


@dataclass(frozen=True, kw_only=True)
class Incline(Scene):
    """One body on a slope, touching it, at rest."""

    name: ClassVar[str] = "incline"

    shape: Literal["box", "disc"] = "box"
    """What lies on the slope."""
    angle: Annotated[float, Limits(least=0.0, below=0.5 * math.pi)] = 0.4
    """Angle of the slope; downhill is to the left [rad]."""
    radius: Positive = 0.5
    """Radius of the disc, half of the box's side [m]."""
    length: Positive = 200.0
    """Length of the slope, in whose middle the body begins [m]."""

    def add_bodies(self, builder: dc.ModelBuilder, stream: np.random.Generator) -> None:
        """Add the slope and the body."""
        cosine, sine = math.cos(self.angle), math.sin(self.angle)
        half = 0.5 * self.length
        self.add_static_chain(builder, [(-half * cosine, -half * sine), (half * cosine, half * sine)])
        body = builder.add_body((-sine * self.radius, cosine * self.radius), angle=self.angle)
        if self.shape == "disc":
            builder.add_disc(body, self.radius, **self.material)
        else:
            builder.add_box(body, self.radius, self.radius, **self.material)
