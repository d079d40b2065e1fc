"""Boxes that stand on each other: a stack and a pyramid."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

import dc_kernels as dc
from dc_kernels.model.settings import Count, NotNegative, Positive
from pipeline.scenes.base import Scene


@dataclass(frozen=True, kw_only=True)
class Stack(Scene):
    """Boxes on top of each other."""

    name: ClassVar[str] = "stack"

    bodies: Count = 10
    """Number of boxes [1]."""
    half_width: Positive = 0.5
    """Half of the boxes' side [m]."""
    jitter: NotNegative = 0.005
    """Largest sideways offset of a box, uniform [m]."""

    def add_bodies(self, builder: dc.ModelBuilder, stream: np.random.Generator) -> None:
        """Add the floor and the boxes."""
        half = self.half_width
        self.add_static_chain(builder, [(-20.0 * half, 0.0), (20.0 * half, 0.0)])
        for i, offset in enumerate(stream.uniform(-self.jitter, self.jitter, self.bodies)):
            body = builder.add_body((float(offset), (2 * i + 1) * half))
            builder.add_box(body, half, half, **self.material)


@dataclass(frozen=True, kw_only=True)
class Pyramid(Scene):
    """Rows of boxes, each with one box less than the row below."""

    name: ClassVar[str] = "pyramid"

    rows: Count = 10
    """Boxes in the lowest row [1]."""
    half_width: Positive = 0.5
    """Half of the boxes' side [m]."""
    spacing: NotNegative = 0.1
    """Free width between two boxes of a row [half_width]."""
    jitter: NotNegative = 0.002
    """Largest sideways offset of a box, uniform [m]."""

    @property
    def count(self) -> int:
        """How many bodies a world has [1]."""
        return self.rows * (self.rows + 1) // 2

    def add_bodies(self, builder: dc.ModelBuilder, stream: np.random.Generator) -> None:
        """Add the floor and the boxes."""
        half, pitch = self.half_width, self.half_width * (2.0 + self.spacing)
        extent = pitch * self.rows
        self.add_static_chain(builder, [(-extent, 0.0), (extent, 0.0)])
        for row in range(self.rows):
            count = self.rows - row
            for column, offset in enumerate(stream.uniform(-self.jitter, self.jitter, count)):
                x = (column - 0.5 * (count - 1)) * pitch + float(offset)
                body = builder.add_body((x, (2 * row + 1) * half))
                builder.add_box(body, half, half, **self.material)
