"""What the kernel files share: small vectors. A vec2 is an array of shape (2,)."""

from __future__ import annotations

from typing import Any

import numpy as np

Array = np.ndarray
Kernels = dict[str, Any]


def dot(a: Array, b: Array) -> Any:
    """Scalar product, last axis; written out because a BLAS may contract or reorder it."""
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1]


def cross(a: Array, b: Array) -> Any:
    """The third component of the cross product."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def rotation(angle: Any) -> Array:
    """R = [[c, -s], [s, c]], (2, 2)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


def rotate(r: Array, v: Array) -> Array:
    """R v for vectors along the last axis."""
    return np.stack([dot(r[0], v), dot(r[1], v)], axis=-1)


def tangent(n: Array) -> Array:
    """The normal turned by -90 degrees."""
    return np.array([n[1], -n[0]])
