"""Discs on joints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

import dc_kernels as dc
from pipeline.scenes.base import Scene, check_above


@dataclass(frozen=True, kw_only=True)
class Chain(Scene):
    """A pendulum: discs hung one after the other on distance joints, let go from a horizontal line."""

    name: ClassVar[str] = "chain"

    bodies: int = 10
    """Number of discs [1]."""
    radius: float = 0.2
    """Radius of the discs [m]."""
    length: float = 1.0
    """Length of a joint [m]."""
    jitter: float = 0.01
    """Largest vertical offset of a disc, uniform [m]."""

    def check(self) -> None:
        super().check()
        check_above(self, 2.0 * self.radius, ("length",))

    def add_bodies(self, builder: dc.ModelBuilder, stream: np.random.Generator) -> None:
        """Add the fixed point, the discs and the joints."""
        previous = builder.add_body(type=dc.BodyType.STATIC)
        for i, offset in enumerate(stream.uniform(-self.jitter, self.jitter, self.bodies)):
            body = builder.add_body(((i + 1) * self.length, float(offset)))
            builder.add_disc(body, self.radius, **self.material)
            builder.add_distance_joint(previous, body)
            previous = body
