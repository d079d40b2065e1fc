"""A body on a slope."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

import dc_kernels as dc
from pipeline.scenes.base import Scene, check_above


@dataclass(frozen=True, kw_only=True)
class Incline(Scene):
    """One body on a slope, touching it, at rest."""

    name: ClassVar[str] = "incline"

    shape: Literal["box", "disc"] = "box"
    """What lies on the slope."""
    angle: float = 0.4
    """Angle of the slope; downhill is to the left [rad]."""
    radius: float = 0.5
    """Radius of the disc, half of the box's side [m]."""
    length: float = 200.0
    """Length of the slope, in whose middle the body begins [m]."""

    def check(self) -> None:
        super().check()
        check_above(self, 0.0, ("length",))
        if not 0.0 <= self.angle < 0.5 * math.pi:
            raise ValueError(f"{self.name}.angle is {self.angle!r}; it must lie in [0, pi / 2)")

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
