"""Plane geometry of the shapes: checks, edge normals, and exact mass properties.

Every shape is the sum of a convex core (a point, a line, a convex polygon) and a disc of a radius, so one
formula serves disc, capsule, polygon and rounded polygon: the core, a rectangle on each edge, and a circular
sector at each vertex. Everything is numpy in float64; leading axes are a batch.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from dc_kernels.model.settings import numeric

MAX_POINTS = 64  # given for a polygon, of which those within a side are left out
SEGMENT_VERTICES = 4  # two ends and the chain's neighbours
MAX_VERTICES = 8  # of a polygon: a feature id of 4 bits an edge or vertex fits the key with room to spare

LARGEST = 1e60
"""Largest magnitude of a number of a body or shape, in the number's unit; float64 holds its fourth power."""
TOLERANCE = 1e-6
"""Relative tolerance of the checks: a distance to the polygon's size, an area to its square, a sine to 1."""
ROUNDINGS = 16
"""Of a coordinate, that an exact relation of a finished shape may be off by."""
NEAR = 1e-4
"""Relative: what was computed from a shape's vertices may be off by this in any scalar."""


class MassProperties(NamedTuple):
    """Area, centroid and inertia of shapes (...) of unit density: arrays of shape (...), the centroid's (..., 2)."""

    area: np.ndarray  # [m^2]
    centroid: np.ndarray  # [m]
    inertia: np.ndarray  # polar second moment of area about the centroid [m^4]


def edge_normals(vertices: np.ndarray) -> np.ndarray:
    """Right-hand unit normals ``(dy, -dx) / length`` of the edges from each vertex to the next, cyclically.

    They point outward for counter-clockwise vertices. One vertex has no edge: its normal is zero; two have an
    edge there and one back.

    Args:
        vertices: (..., n, 2) [m].

    Returns:
        (..., n, 2) [1].
    """
    if vertices.shape[-2] == 1:
        return np.zeros_like(vertices)
    edges = np.roll(vertices, -1, axis=-2) - vertices
    normals = np.stack((edges[..., 1], -edges[..., 0]), axis=-1)
    return normals / np.hypot(edges[..., 0], edges[..., 1])[..., None]


def mass_properties(vertices: np.ndarray, radius: Any = 0.0) -> MassProperties:
    """Exact area, centroid and inertia of convex shapes rounded by a disc.

    Args:
        vertices: (..., n, 2) [m]: n = 1 is a disc, 2 a capsule, more a convex polygon, counter-clockwise.
        radius: (...) [m], of the disc that rounds them, >= 0; it must be positive for n < 3.
    """
    vertices = np.asarray(vertices, np.float64)
    radius = np.broadcast_to(np.asarray(radius, np.float64), vertices.shape[:-2])
    if vertices.shape[-2] == 1:  # what follows comes to this for a disc, to the bit
        area = 2 * math.pi * radius**2 / 2
        return MassProperties(area, vertices[..., 0, :] + 0.0, area * (radius**2 / 2))
    middle = vertices.mean(axis=-2)  # sums are taken about it: no cancellation far from the frame's origin
    start = vertices - middle[..., None, :]
    end = np.roll(start, -1, axis=-2)
    r = radius[..., None]

    # the core, as a fan of triangles
    cross = start[..., 0] * end[..., 1] - start[..., 1] * end[..., 0]
    area = cross.sum(-1) / 2
    first = (cross[..., None] * (start + end)).sum(-2) / 6
    second = (cross * ((start * start).sum(-1) + (start * end).sum(-1) + (end * end).sum(-1))).sum(-1) / 12

    # a rectangle of height r on each edge
    normals = edge_normals(vertices)
    length = np.hypot(*np.moveaxis(end - start, -1, 0))
    center = (start + end) / 2 + normals * (r / 2)[..., None]
    rectangle = length * r
    area = area + rectangle.sum(-1)
    first = first + (rectangle[..., None] * center).sum(-2)
    second = second + (rectangle * ((length**2 + r**2) / 12 + (center * center).sum(-1))).sum(-1)

    # a sector at each vertex, between the normals of its two edges; the integral of the unit vector over the
    # sector's angle is the difference of the normals, turned by -90 degrees
    before = np.roll(normals, 1, axis=-2)
    turn = before[..., 0] * normals[..., 1] - before[..., 1] * normals[..., 0]
    angle = np.abs(np.arctan2(turn, (before * normals).sum(-1)))
    change = normals - before
    moment = np.stack((change[..., 1], -change[..., 0]), axis=-1) * (r**3 / 3)[..., None]
    sector = angle * r**2 / 2
    area = area + sector.sum(-1)
    first = first + (sector[..., None] * start + moment).sum(-2)
    second = second + (sector * (r**2 / 2 + (start * start).sum(-1)) + 2 * (start * moment).sum(-1)).sum(-1)

    offset = first / area[..., None]
    return MassProperties(area, middle + offset, second - area * (offset * offset).sum(-1))


def box_vertices(half_width: float, half_height: float, center: Any = (0.0, 0.0), angle: float = 0.0) -> np.ndarray:
    """The corners of a box, counter-clockwise: (4, 2) [m]; ``angle`` [rad] turns it about its centre."""
    c, s = math.cos(angle), math.sin(angle)
    ux, uy, vx, vy = half_width * c, half_width * s, -half_height * s, half_height * c
    x, y = center
    return np.array(
        (
            (x - ux - vx, y - uy - vy),
            (x + ux - vx, y + uy - vy),
            (x + ux + vx, y + uy + vy),
            (x - ux + vx, y - uy + vy),
        )
    )


def points(values: Any, where: str, low: int = 1, high: int | None = None) -> np.ndarray:
    """Points as an (n, 2) float64 array [m].

    Raises:
        ValueError: naming ``where`` and the index: another shape, fewer than ``low`` or more than ``high`` points,
            NaN or inf.
    """
    array = numeric(where, values, "numbers of shape (n, 2)", inner=(2,)).astype(np.float64)
    if array.ndim != 2 or array.shape[1] != 2:
        raise ValueError(f"{where}: has shape {array.shape}; it must be (n, 2)")
    if len(array) < low or (high is not None and len(array) > high):
        limit = f"at least {low}" if high is None else f"{low} to {high}"
        raise ValueError(f"{where}: {len(array)} points; there must be {limit}")
    good = np.abs(array) <= LARGEST
    if not good.all():
        i, j = (int(k) for k in np.argwhere(~good)[0])
        limit = f"within {LARGEST:g} of zero" if np.isfinite(array[i, j]) else "finite"
        raise ValueError(f"{where}[{i}, {j}] is {array[i, j]}; it must be {limit}")
    return array


def convex_polygon(values: Any, where: str = "vertices") -> np.ndarray:
    """Checked vertices of a convex polygon in counter-clockwise order, beginning with the first one given.

    A vertex that lies on the line between its neighbours (sine of the turn up to 1e-6) is left out.

    Args:
        values: (n, 2) [m], in either order; 3 to 8 of them, besides those that are left out.
        where: what the error messages call them.

    Raises:
        ValueError: naming ``where`` and the index: wrong shape or count, NaN or inf; two vertices closer than
            1e-6 of the polygon's size (the diagonal of its bounding box); an area below 1e-6 of the size squared;
            a self-intersection, also that of a side that runs back on itself; a concave corner.
    """
    vertices = points(values, where, 0)
    if 3 <= len(vertices) <= MAX_POINTS:
        vertices, index = _corners(vertices)
        if len(vertices) < 3:
            raise ValueError(f"{where}: zero area, all vertices lie in a line")
    if not 3 <= len(vertices) <= MAX_VERTICES:
        raise ValueError(f"{where}: {len(vertices)} points; there must be 3 to {MAX_VERTICES} corners")
    size = math.hypot(*np.ptp(vertices, axis=0))
    apart = vertices[:, None] - vertices[None]
    close = np.hypot(apart[..., 0], apart[..., 1]) <= TOLERANCE * size
    if close.sum() > len(vertices):
        i, j = (int(k) for k in np.argwhere(np.triu(close, 1))[0])
        i, j, at = index[i], index[j], vertices[j]
        raise ValueError(
            f"{where}[{j}] = {tuple(map(float, at))} repeats {where}[{i}]; "
            f"two vertices must be further apart than {TOLERANCE:g} of the polygon's size {size:g}"
        )
    edges = np.roll(vertices, -1, axis=0) - vertices  # edge i leaves vertex i
    before = np.roll(edges, 1, axis=0)
    cross = before[:, 0] * edges[:, 1] - before[:, 1] * edges[:, 0]
    sine = cross / (np.hypot(edges[:, 0], edges[:, 1]) * np.hypot(before[:, 0], before[:, 1]))
    start = vertices - vertices[0]
    end = np.roll(start, -1, axis=0)
    area = float((start[:, 0] * end[:, 1] - start[:, 1] * end[:, 0]).sum() / 2)
    back = np.abs(sine) <= TOLERANCE  # those that go on ahead are left out
    if back.any():
        i = index[int(back.argmax())]
        raise ValueError(f"{where}[{i}] is the tip of a side that runs back on itself; the polygon must be convex")
    turns = np.arctan2(cross, (before * edges).sum(-1))
    winding = round(float(turns.sum()) / (2 * math.pi))
    if abs(winding) != 1:
        raise ValueError(f"{where}: the polygon intersects itself (it winds {winding} times); it must be convex")
    wrong = turns * winding < 0
    if wrong.any():
        raise ValueError(f"{where}[{index[int(wrong.argmax())]}] is a concave corner; the polygon must be convex")
    if abs(area) <= TOLERANCE * size**2:
        raise ValueError(f"{where}: area {abs(area):g} m^2; it must exceed {TOLERANCE:g} of the size squared")
    return vertices if winding > 0 else np.roll(vertices[::-1], 1, axis=0)


def _corners(vertices: np.ndarray) -> tuple[np.ndarray, list[int]]:
    """Leave out vertices on the line between their neighbours; returns the others, and their places.

    The one that turns least goes first, so that of several in a row each is judged by the corners that remain.
    """
    index = list(range(len(vertices)))
    while len(index) > 2:
        kept = vertices[index]
        before, after = kept - np.roll(kept, 1, axis=0), np.roll(kept, -1, axis=0) - kept
        lengths = np.hypot(before[:, 0], before[:, 1]) * np.hypot(after[:, 0], after[:, 1])
        turn = np.abs(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0])
        ahead = (before * after).sum(axis=1) > 0  # not back, nor a vertex that repeats its neighbour
        flat = ahead & (turn <= TOLERANCE * lengths)
        if not flat.any():
            break
        del index[int(np.where(flat, turn / np.where(ahead, lengths, 1.0), np.inf).argmin())]
    return vertices[index], index
