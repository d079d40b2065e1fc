"""Bodies on joints: a bridge, ragdolls, a net, gears, a ball on a chain, cars."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

import dc_kernels as dc
from dc_kernels.model.settings import Count, NotNegative, Positive
from pipeline.scenes.base import Scene


@dataclass(frozen=True, kw_only=True)
class Bridge(Scene):
    """Planks on hinges between two fixed points, on which discs fall."""

    name: ClassVar[str] = "bridge"

    bodies: Count = 30
    """Number of planks [1]."""
    length: Positive = 1.0
    """Length of a plank [m]."""
    loads: Count = 5
    """Number of discs [1]."""

    @property
    def count(self) -> int:
        """How many bodies a world has [1]."""
        return self.bodies + self.loads

    def add_bodies(self, builder: dc.ModelBuilder, stream: np.random.Generator) -> None:
        """Add the fixed points, the planks from the left, and the discs at random places above them."""
        half, span = 0.5 * self.length, self.bodies * self.length
        posts = body = builder.add_body(type=dc.BodyType.STATIC)
        anchor = (0.0, 0.0)
        for i in range(self.bodies):
            plank = builder.add_body(((i + 0.5) * self.length, 0.0))
            builder.add_box(plank, half, 0.125 * self.length, **self.material)
            builder.add_revolute_joint(body, plank, anchor, (-half, 0.0))
            body, anchor = plank, (half, 0.0)
        builder.add_revolute_joint(posts, body, (span, 0.0), anchor)
        for i, x in enumerate(stream.uniform(0.3, 0.7, self.loads)):
            disc = builder.add_body((x * span, (1.0 + 1.2 * i) * self.length))
            builder.add_disc(disc, half, **self.material)


@dataclass(frozen=True, kw_only=True)
class Ragdolls(Scene):
    """Dolls of eleven bodies with joints that bend as far as limbs do, dropped in columns."""

    name: ClassVar[str] = "ragdolls"

    bodies: Count = 33
    """About how many bodies; a doll has eleven [1]."""
    size: Positive = 1.8
    """Height of a doll [m]."""
    abreast: Count = 1
    """Columns side by side, in which the dolls stand one above the other [1]."""

    @property
    def count(self) -> int:
        """How many bodies a world has [1]."""
        return 11 * max(1, round(self.bodies / 11))

    def add_bodies(self, builder: dc.ModelBuilder, stream: np.random.Generator) -> None:
        """Add the floor and the dolls from below, each turned at random."""
        dolls, aside = self.count // 11, 0.5 * (self.abreast - 1)
        self.add_static_chain(builder, [((-3.0 - aside) * self.size, 0.0), ((3.0 + aside) * self.size, 0.0)])
        for i, turn in enumerate(stream.uniform(-0.5, 0.5, dolls)):
            place = (i % self.abreast - aside) * self.size, (0.8 + 1.3 * (i // self.abreast)) * self.size
            self._add_doll(builder, place, float(turn))

    def _add_doll(self, builder: dc.ModelBuilder, place: tuple[float, float], turn: float) -> None:
        """Add a doll whose hips are at a place, turned by an angle [rad]; its limbs pass through each other."""
        cosine, sine, unit = math.cos(turn), math.sin(turn), self.size

        def limb(x: float, y: float, half: float, radius: float) -> int:
            x, y = x * unit, y * unit
            body = builder.add_body((place[0] + cosine * x - sine * y, place[1] + sine * x + cosine * y), angle=turn)
            ends = ((0.0, -half * unit), (0.0, half * unit))
            builder.add_capsule(body, *ends, radius * unit, category=2, mask=1, **self.material)
            return body

        def hinge(a: int, b: int, at: tuple[float, float], below: float, lower: float, upper: float) -> None:
            anchors = (at[0] * unit, at[1] * unit), (0.0, below * unit)
            builder.add_revolute_joint(a, b, *anchors, lower=lower, upper=upper)

        hips, chest = limb(0.0, 0.0, 0.04, 0.06), limb(0.0, 0.17, 0.07, 0.07)
        head = limb(0.0, 0.34, 0.02, 0.06)
        hinge(hips, chest, (0.0, 0.08), -0.09, -0.5, 0.5)
        hinge(chest, head, (0.0, 0.1), -0.07, -0.6, 0.6)
        for side in (-1.0, 1.0):
            thigh, shin = limb(0.04 * side, -0.16, 0.09, 0.035), limb(0.04 * side, -0.38, 0.09, 0.03)
            hinge(hips, thigh, (0.04 * side, -0.05), 0.11, -0.6, 1.4)
            hinge(thigh, shin, (0.0, -0.11), 0.11, -2.0, 0.1)
            arm, hand = limb(0.08 * side, 0.13, 0.07, 0.028), limb(0.08 * side, -0.05, 0.07, 0.025)
            hinge(chest, arm, (0.08 * side, 0.05), 0.09, -1.5, 2.5)
            hinge(arm, hand, (0.0, -0.09), 0.09, -0.1, 2.0)


@dataclass(frozen=True, kw_only=True)
class JointGrid(Scene):
    """A net of discs, each on hinges with its neighbours, that hangs on its upper corners."""

    name: ClassVar[str] = "joint-grid"

    bodies: Count = 100
    """About how many discs; the net is square [1]."""
    radius: Positive = 0.4
    """Radius of the discs [m]."""
    tilt: NotNegative = 0.1
    """Largest angle of the net to the vertical at first, uniform [rad]."""

    @property
    def count(self) -> int:
        """How many bodies a world has [1]."""
        return max(2, round(math.sqrt(self.bodies))) ** 2

    def add_bodies(self, builder: dc.ModelBuilder, stream: np.random.Generator) -> None:
        """Add the fixed points and the discs row by row, from the uppermost on."""
        side, pitch = math.isqrt(self.count), 2.5 * self.radius
        posts = builder.add_body(type=dc.BodyType.STATIC)
        discs = np.empty((side, side), np.int64)
        angle = float(stream.uniform(-self.tilt, self.tilt))
        cosine, sine = math.cos(angle), math.sin(angle)
        for row in range(side):
            for column in range(side):
                x, y = column * pitch, -row * pitch
                place = (cosine * x - sine * y, sine * x + cosine * y)
                disc = builder.add_body(place, angle=angle)
                builder.add_disc(disc, self.radius, mask=0, **self.material)
                discs[row, column] = disc
                if column:
                    builder.add_revolute_joint(int(discs[row, column - 1]), disc, (0.5 * pitch, 0.0))
                if row:
                    builder.add_revolute_joint(int(discs[row - 1, column]), disc, (0.0, -0.5 * pitch))
                if row == 0 and column in (0, side - 1):
                    builder.add_revolute_joint(posts, disc, place)


@dataclass(frozen=True, kw_only=True)
class Gears(Scene):
    """Wheels on hinges in a row, of random sizes, each of which turns the next; the first spins."""

    name: ClassVar[str] = "gears"

    bodies: Count = 8
    """Number of wheels [1]."""
    radius: Positive = 1.0
    """Largest radius of a wheel; the least is half of it [m]."""
    spin: float = 5.0
    """Angular velocity of the first wheel at first [rad/s]."""

    def add_bodies(self, builder: dc.ModelBuilder, stream: np.random.Generator) -> None:
        """Add the fixed axles and the wheels from the left."""
        axles = builder.add_body(type=dc.BodyType.STATIC)
        x, before, last = 0.0, 0.0, -1
        for radius in map(float, stream.uniform(0.5, 1.0, self.bodies) * self.radius):
            x += before + radius
            wheel = builder.add_body((x, 0.0), angular_velocity=self.spin if last < 0 else 0.0)
            builder.add_disc(wheel, 0.98 * radius, mask=0, **self.material)
            builder.add_revolute_joint(axles, wheel, (x, 0.0), (0.0, 0.0))
            if last >= 0:
                builder.add_gear_joint(last, wheel, -before / radius)
            before, last = radius, wheel


@dataclass(frozen=True, kw_only=True)
class BallAndChain(Scene):
    """A chain of light links that carries a heavy ball, let go from a line that is almost horizontal."""

    name: ClassVar[str] = "ball-and-chain"

    bodies: Count = 20
    """Number of links [1]."""
    length: Positive = 0.25
    """Length of a link [m]."""
    load: Positive = 100.0
    """Mass of the ball [links]."""
    jitter: NotNegative = 0.1
    """Largest angle of the line to the horizontal, uniform [rad]."""

    @property
    def count(self) -> int:
        """How many bodies a world has [1]."""
        return self.bodies + 1

    def add_bodies(self, builder: dc.ModelBuilder, stream: np.random.Generator) -> None:
        """Add the fixed point, the links from it on, and the ball."""
        angle = float(stream.uniform(-self.jitter, self.jitter))
        cosine, sine, half = math.cos(angle), math.sin(angle), 0.5 * self.length
        body, anchor = builder.add_body(type=dc.BodyType.STATIC), (0.0, 0.0)
        for i in range(self.bodies):
            along = (2 * i + 1) * half
            link = builder.add_body((along * cosine, along * sine), angle=angle)
            builder.add_box(link, half, 0.2 * self.length, mask=0, **self.material)
            builder.add_revolute_joint(body, link, anchor, (-half, 0.0))
            body, anchor = link, (half, 0.0)
        reach, mass = self.bodies * self.length, self.load * self.density * 0.4 * self.length**2
        ball = builder.add_body((reach * cosine, reach * sine), angle=angle, mass=mass)
        builder.add_disc(ball, 2.0 * self.length, mask=0, **self.material)
        builder.add_revolute_joint(body, ball, anchor, (0.0, 0.0))


@dataclass(frozen=True, kw_only=True)
class Cars(Scene):
    """Cars with sprung wheels and a motor, one behind the other on random hills."""

    name: ClassVar[str] = "cars"

    bodies: Count = 3
    """Number of cars [1]."""
    torque: NotNegative = 4.0
    """Largest torque of the motor of a wheel [N m]."""
    spin: NotNegative = 15.0
    """Angular velocity that the motors drive the wheels at, which makes for the right [rad/s]."""
    height: NotNegative = 0.4
    """Height of the hills, the most that a corner of the ground is above the lowest possible [m]."""

    @property
    def count(self) -> int:
        """How many bodies a world has [1]."""
        return 3 * self.bodies

    def add_bodies(self, builder: dc.ModelBuilder, stream: np.random.Generator) -> None:
        """Add the ground and the cars from the right."""
        corners = 4 * self.bodies + 30
        heights = stream.uniform(-self.height, 0.0, corners)
        self.add_static_chain(builder, [(2.0 * i - 4.0 * self.bodies, float(y)) for i, y in enumerate(heights)])
        for i in range(self.bodies):
            x = 2.0 - 4.0 * i
            body = builder.add_body((x, 0.8))
            builder.add_box(body, 1.0, 0.25, category=2, mask=1, **self.material)
            for side in (-0.7, 0.7):
                wheel = builder.add_body((x + side, 0.4))
                builder.add_disc(wheel, 0.35, category=2, mask=1, **{**self.material, "friction": 2 * self.friction})
                builder.add_wheel_joint(
                    body, wheel, anchor_a=(side, -0.4), motor_speed=-self.spin, max_motor_torque=self.torque
                )
