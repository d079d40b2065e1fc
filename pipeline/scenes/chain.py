"""Discs on joints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

import dc_kernels as dc
from dc_kernels.model.settings import Count, NotNegative, Positive
from pipeline.scenes.base import Scene


@dataclass(frozen=True, kw_only=True)
class Chain(Scene):
    """A pendulum: discs hung one after the other on distance joints, let go from a horizontal line."""

    name: ClassVar[str] = "chain"

    bodies: Count = 10
    """Number of discs [1]."""
    radius: Positive = 0.2
    """Radius of the discs [m]."""
    length: Positive = 1.0
    """Length of a joint [m]."""
    jitter: NotNegative = 0.01
    """Largest vertical offset of a disc, uniform [m]."""

    def check(self) -> None:
        """Raise a ``ValueError`` for discs that overlap."""
        if not self.length > 2.0 * self.radius:
            raise ValueError(f"chain.length is {self.length!r}; it must be > {2.0 * self.radius}, 2 radius")

    def add_bodies(self, builder: dc.ModelBuilder, stream: np.random.Generator) -> None:
        """Add the fixed point, the discs and the joints."""
        previous = builder.add_body(type=dc.BodyType.STATIC)
        for i, offset in enumerate(stream.uniform(-self.jitter, self.jitter, self.bodies)):
            body = builder.add_body(((i + 1) * self.length, float(offset)))
            builder.add_disc(body, self.radius, **self.material)
            builder.add_distance_joint(previous, body)
            previous = body
