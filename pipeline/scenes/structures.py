"""Structures that friction and balance hold up: a house of cards, an arch of blocks, a row of dominoes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

import dc_kernels as dc
from dc_kernels.model.settings import Count, Limits, NotNegative, Positive
from pipeline.scenes.base import Scene


@dataclass(frozen=True, kw_only=True)
class CardHouse(Scene):
    """Tents of two cards each, with flat cards between their levels."""

    name: ClassVar[str] = "card-house"

    friction: NotNegative = 0.6
    """Coulomb coefficient of all shapes; the house stands where it is above about half of tan(lean) [1]."""
    levels: Count = 3
    """Levels of tents [1]."""
    length: Positive = 1.0
    """Length of a card [m]."""
    thickness: Annotated[float, Limits(above=0.0, most=0.1)] = 0.02
    """Thickness of a card, at most 0.1 [length]."""
    lean: Annotated[float, Limits(least=0.1, most=0.6)] = 0.25
    """Angle of a card of a tent to the vertical, 0.1 to 0.6 [rad]."""

    @property
    def count(self) -> int:
        """How many bodies a world has [1]."""
        return self.levels * (self.levels + 1) + self.levels * (self.levels - 1) // 2

    def add_bodies(self, builder: dc.ModelBuilder, stream: np.random.Generator) -> None:
        """Add the floor and the cards from the lowest level up; nothing is drawn."""
        half, thin = 0.5 * self.length, 0.5 * self.thickness * self.length
        cosine, sine = math.cos(self.lean), math.sin(self.lean)
        width, height = thin * cosine + half * sine, thin * sine + half * cosine
        pitch, base = 4.08 * width, 0.0  # two tents side by side do not touch
        extent = pitch * (self.levels + 1)
        self.add_static_chain(builder, [(-extent, 0.0), (extent, 0.0)])
        for level in range(self.levels):
            tents = self.levels - level
            for i in range(tents):
                x = (i - 0.5 * (tents - 1)) * pitch
                for side in (-1.0, 1.0):
                    card = builder.add_body((x + side * width, base + height), angle=side * self.lean)
                    builder.add_box(card, thin, half, **self.material)
            base += 2.0 * height
            for i in range(tents - 1):
                card = builder.add_body(((i - 0.5 * (tents - 2)) * pitch, base + thin))
                # one alone rests on two ridges and must reach beyond both; of several each meets the next
                builder.add_box(card, (1.2 if tents == 2 else 0.96) * 0.5 * pitch, thin, **self.material)
            base += 2.0 * thin


@dataclass(frozen=True, kw_only=True)
class Arch(Scene):
    """A semicircular arch of blocks, which stand on the floor and hold each other up without mortar.

    A continuous one needs a thickness of 0.1075 of its mean radius (Couplet 1730), one of few blocks a little less.
    """

    name: ClassVar[str] = "arch"

    friction: NotNegative = 0.8
    """Coulomb coefficient of all shapes [1]."""
    bodies: Annotated[int, Limits(least=2, most=1000)] = 15
    """Number of blocks, 2 to 1000 [1]."""
    radius: Positive = 5.0
    """Mean radius of the arch [m]."""
    thickness: Annotated[float, Limits(least=0.01, most=1.0)] = 0.2
    """Thickness of the ring, 0.01 to 1 [radius]."""

    def add_bodies(self, builder: dc.ModelBuilder, stream: np.random.Generator) -> None:
        """Add the floor and the blocks from the right to the left; nothing is drawn."""
        extent = 2.0 * self.radius
        self.add_static_chain(builder, [(-extent, 0.0), (extent, 0.0)])
        angle = np.linspace(0.0, math.pi, self.bodies + 1)
        ray = self.radius * np.stack((np.cos(angle), np.sin(angle)), axis=1)
        ray[[0, -1], 1] = 0.0  # the feet stand flat
        inner, outer = (1.0 - 0.5 * self.thickness) * ray, (1.0 + 0.5 * self.thickness) * ray
        for block in np.stack((inner[:-1], outer[:-1], outer[1:], inner[1:]), axis=1):
            center = block.mean(axis=0)
            body = builder.add_body((float(center[0]), float(center[1])))
            builder.add_polygon(body, block - center, **self.material)


@dataclass(frozen=True, kw_only=True)
class Dominoes(Scene):
    """A row of dominoes on the floor, the first of which is pushed over and brings down the rest."""

    name: ClassVar[str] = "dominoes"

    friction: NotNegative = 0.4
    """Coulomb coefficient of all shapes [1]."""
    bodies: Count = 20
    """Number of dominoes [1]."""
    height: Positive = 1.0
    """Height of a domino [m]."""
    thickness: Annotated[float, Limits(least=0.02, most=0.3)] = 0.15
    """Thickness of a domino, 0.02 to 0.3 [height]."""
    spacing: Annotated[float, Limits(above=0.0, most=0.9)] = 0.45
    """Free width between two dominoes, at most 0.9 so that each reaches the next; where it is not larger than the
    thickness the first one may be held before it tips [height]."""

    def add_bodies(self, builder: dc.ModelBuilder, stream: np.random.Generator) -> None:
        """Add the floor and the dominoes from the left to the right; nothing is drawn."""
        thin, half = 0.5 * self.thickness * self.height, 0.5 * self.height
        pitch = (self.thickness + self.spacing) * self.height
        self.add_static_chain(builder, [(-2.0 * self.height, 0.0), (pitch * self.bodies + 2.0 * self.height, 0.0)])
        edge = math.hypot(thin, half)  # from the centre to the edge that the first turns about
        # half as fast again as brings the centre above the edge: I w^2 / 2 = m g (edge - half), I = 4/3 m edge^2
        rate = 1.5 * math.sqrt(1.5 * max(self.gravity, 0.0) * (edge - half)) / edge
        for i in range(self.bodies):
            spin = rate if i == 0 else 0.0
            body = builder.add_body((i * pitch, half), 0.0, (spin * half, spin * thin), -spin)
            builder.add_box(body, thin, half, **self.material)
