"""Bodies on surfaces that move, and on surfaces that hold from one side."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

import dc_kernels as dc
from dc_kernels.model.settings import Count, Limits, NotNegative, Positive
from pipeline.scenes.base import Scene


@dataclass(frozen=True, kw_only=True)
class Conveyor(Scene):
    """Crates on a belt that climbs to the right, and drops them onto one that carries them back into a bin."""

    name: ClassVar[str] = "conveyor"

    bodies: Count = 8
    """Number of crates [1]."""
    size: Positive = 0.4
    """Half of a crate's width; it is between half as high and as high as it is wide, uniform [m]."""
    speed: Positive = 2.0
    """Speed of the belts [m/s]."""
    slope: Annotated[float, Limits(least=0.0, most=0.5)] = 0.15
    """Angle of the upper belt, which crates climb where friction exceeds its tangent [rad]."""
    jitter: NotNegative = 0.1
    """Largest distance of a crate from its place in the row, uniform [m]."""

    def add_bodies(self, builder: dc.ModelBuilder, stream: np.random.Generator) -> None:
        """Add the belts, the bin and a row of crates at rest on the upper belt."""
        size, radius = self.size, 0.8 * self.size
        pitch = 2.5 * size + 2.0 * self.jitter
        length, drop = self.bodies * pitch, 5.0 * size
        cosine, sine = math.cos(self.slope), math.sin(self.slope)
        material = {name: value for name, value in self.material.items() if name != "density"}
        for end, at, speed in (
            ((length * cosine, length * sine), (0.0, 0.0), self.speed),
            ((length + 3.0 * size, 0.0), (2.0 * size, -drop), -self.speed),
        ):
            belt = builder.add_body(at, type=dc.BodyType.STATIC)
            builder.add_capsule(belt, (0.0, 0.0), end, radius, surface_speed=speed, **material)
        right, left, low = length + 6.0 * size, -5.0 * size, -2.5 * drop
        self.add_static_chain(builder, [(right, -drop), (right, drop)])  # which stops what flies past the lower belt
        edges = [(left, -drop), (left, low), (left + 7.0 * size, low), (left + 7.0 * size, -1.8 * drop)]
        self.add_static_chain(builder, edges)
        along = pitch * (np.arange(self.bodies) + 0.5) + stream.uniform(-self.jitter, self.jitter, self.bodies)
        for way, half in zip(along.tolist(), (size * stream.uniform(0.5, 1.0, self.bodies)).tolist()):
            up = radius + half
            crate = builder.add_body((way * cosine - up * sine, way * sine + up * cosine), angle=self.slope)
            builder.add_box(crate, size, half, **self.material)


@dataclass(frozen=True, kw_only=True)
class Platforms(Scene):
    """Discs and boxes that are thrown up through one-way platforms, land on them, and on a one-sided ground."""

    name: ClassVar[str] = "platforms"

    bodies: Count = 16
    """Number of discs and boxes, in turns [1]."""
    size: Positive = 0.3
    """Radius of a disc, and half of a box's width [m]."""
    levels: Count = 3
    """Number of rows of platforms above each other [1]."""
    height: Positive = 2.0
    """From one row to the next [m]."""
    jitter: NotNegative = 0.1
    """Largest distance of a body from its place in the row, uniform [m]."""

    def add_bodies(self, builder: dc.ModelBuilder, stream: np.random.Generator) -> None:
        """Add ground, walls and platforms, and the bodies, thrown from below the ground and from above it."""
        pitch, top = 3.0 * self.size + self.jitter, self.levels * self.height
        width = self.bodies * pitch
        material = {name: value for name, value in self.material.items() if name != "density"}
        fixed = builder.add_body(type=dc.BodyType.STATIC)
        outline = [(width, top + self.height), (width, 0.0), (0.0, 0.0), (0.0, top + self.height)]
        builder.add_chain(fixed, outline, one_sided=True, **material)
        for level in range(1, self.levels + 1):
            for k in range(4):
                x = (k + 0.35 + 0.3 * (level % 2)) * width / 4.0
                builder.add_box(fixed, width / 12.0, 0.1, (x, level * self.height), one_way=(0.0, 1.0), **material)
        reach = stream.uniform(0.6, self.levels + 0.4, self.bodies) * self.height
        places = pitch * (np.arange(self.bodies) + 0.5) + stream.uniform(-self.jitter, self.jitter, self.bodies)
        for i, x in enumerate(places.tolist()):
            y = -self.height if i % 4 == 0 else self.size
            speed = float(np.sqrt(2.0 * self.gravity * (reach[i] - y))) if self.gravity > 0 else 1.0
            body = builder.add_body((x, y), velocity=(0.0, speed), angular_velocity=float(stream.normal()))
            if i % 2:
                builder.add_disc(body, self.size, **self.material)
            else:
                builder.add_box(body, self.size, 0.8 * self.size, **self.material)
