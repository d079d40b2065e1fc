"""Discs in an open box: the worlds of the thesis protocol, and two that begin otherwise."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

import dc_kernels as dc
from dc_kernels.model.settings import Count, Positive
from pipeline.scenes.base import Scene
from pipeline.scenes.placement import CLEARANCE, Sampler, place_discs

THESIS_BODIES = 100
"""Discs of a world of the thesis protocol [1]."""
THESIS_RADIUS = 0.5
"""Radius of these discs [m]."""
THESIS_SIDE = 15.0
"""Width and height of the box that holds them [m]."""
AHEAD = 3
"""Blocks of candidates that are drawn together, as nobody draws from the streams later; the fastest of 1 to 8 [1]."""
SETTLED_GAP = 5e-4
"""Gap of the dense packing, which lies inside the speculative margin [diameters]."""


def box_side(bodies: int, radius: float) -> float:
    """Return the side of a box that is as full as that of the thesis protocol, 15 m for 100 bodies of 0.5 m [m]."""
    return THESIS_SIDE * math.sqrt(bodies / THESIS_BODIES) * radius / THESIS_RADIUS


@dataclass(frozen=True, kw_only=True)
class Thesis(Scene):
    """Discs at random places in an open box whose area grows with theirs: the worlds of the thesis protocol."""

    name: ClassVar[str] = "thesis"

    bodies: Count = THESIS_BODIES
    """Discs in each world [1]."""
    radius: Positive = THESIS_RADIUS
    """Radius of the discs [m]."""

    @property
    def side(self) -> float:
        """Width and height of the box [m]."""
        return box_side(self.bodies, self.radius)

    def add_worlds(self, builder: dc.ModelBuilder, streams: Sequence[np.random.Generator]) -> None:
        """Place the discs of all worlds at once, then add them."""
        low = self.radius * (1.0 + CLEARANCE)
        free = self.side - 2.0 * low
        distance = 2.0 * self.radius * (1.0 + CLEARANCE)
        samplers = [self.sampler(s, free) for s in streams]
        centres = place_discs(samplers, self.bodies, distance, (free, free), ahead=AHEAD) + low
        for world in centres:
            builder.add_world(gravity=(0.0, -self.gravity))
            self.add_open_box(builder, self.side, self.side)
            # numbered by place, up and down strips: neighbours then are near in memory, worth a third at 1e5 discs
            strip = np.floor(world[:, 0] / (2.0 * distance))
            builder.add_discs(world[np.lexsort((world[:, 1], strip))], self.radius, **self.material)

    def sampler(self, stream: np.random.Generator, free: float) -> Sampler:
        """Make candidates that are uniform in the square of side ``free`` [m]."""
        return lambda first, count: stream.random((count, 2)) * free


@dataclass(frozen=True, kw_only=True)
class ThesisClustered(Thesis):
    """The worlds of thesis, but the discs begin in Gaussian clusters."""

    name: ClassVar[str] = "thesis-clustered"

    clusters: Count = 3
    """Number of clusters, whose centres are uniform in the middle half of the box [1]."""
    spread: Positive = 0.12
    """Standard deviation of a cluster, which widens as it fills [side of the box]."""

    def sampler(self, stream: np.random.Generator, free: float) -> Sampler:
        """Make candidates that are normal around each centre in turn; their deviation grows, up to the box's side."""
        centres = (0.25 + 0.5 * stream.random((self.clusters, 2))) * free

        def sample(first: int, count: int) -> np.ndarray:
            number = np.arange(first, first + count)
            deviation = self.side * np.minimum(self.spread * (1.0 + number / (10.0 * self.bodies)), 1.0)
            return centres[number % self.clusters] + deviation[:, None] * stream.standard_normal((count, 2))

        return sample


@dataclass(frozen=True, kw_only=True)
class Settled(Thesis):
    """The discs of thesis, packed hexagonally on the floor with a small jitter, so that they begin near rest."""

    name: ClassVar[str] = "settled"

    def add_worlds(self, builder: dc.ModelBuilder, streams: Sequence[np.random.Generator]) -> None:
        """Add rows of discs from wall to wall and, in the pockets between them, rows of one disc less."""
        diameter = 2.0 * self.radius
        pitch = diameter * (1.0 + SETTLED_GAP)
        gap = diameter * SETTLED_GAP
        columns = max(int(self.side / diameter), 2)
        width = max(self.side, diameter + (columns - 1) * pitch + 2.0 * gap)
        step = (width - diameter - 2.0 * gap) / (columns - 1)  # stretched, so that full rows lean on both walls
        rise = math.sqrt(max(pitch**2 - (0.5 * step) ** 2, 0.25 * pitch**2))
        number = np.arange(self.bodies)
        pair, place = np.divmod(number, 2 * columns - 1)  # of a full row and a short one
        short = place >= columns
        x = self.radius + gap + step * np.where(short, place - columns + 0.5, place)
        y = self.radius + gap + rise * (2 * pair + short)
        for stream in streams:
            angle = 2.0 * math.pi * stream.random(self.bodies)
            shift = 0.45 * gap * stream.random(self.bodies)  # two of them stay below the gap
            builder.add_world(gravity=(0.0, -self.gravity))
            self.add_open_box(builder, width, max(self.side, float(y[-1]) + diameter))
            positions = np.stack([x + shift * np.cos(angle), y + shift * np.sin(angle)], axis=1)
            builder.add_discs(positions, self.radius, **self.material)
