"""Checks of shapes' vertices, normals and extents, of all shapes of a kind at once."""

from __future__ import annotations

import math

import numpy as np

from dc_kernels.model.enums import ShapeType
from dc_kernels.model.rules import refuse
from dc_kernels.model.shapes import MAX_VERTICES, NEAR, ROUNDINGS, SEGMENT_VERTICES, TOLERANCE
from dc_kernels.model.validate.glance import Arrays

PART = 2**14  # shapes that are looked at together, within the processor's cache


def check_geometry(model: Arrays, label: str) -> None:
    """Hold the shapes of a model to what its builder guarantees, to the rounding of its scalar.

    A disc has one vertex, its centre; a polygon 2 vertices (a capsule) or 3 to 8, convex and counter-clockwise; a
    segment 4. Discs and capsules have a radius. Normals are the unit normals of the edges. The centre lies within the
    vertices' box, and the extent is the distance of the farthest point.

    Args:
        model: arrays of a model whose offsets and types are right.
        label: what stands before the name of an array in errors.

    Raises:
        BrokenRule: naming array, index, value and limit.
    """
    start, kinds, radii = model["vertex_start"], model["shape_type"], model["shape_radius"]
    counts = np.diff(start)
    # most scenes are nearly all discs, whose centre is their vertex and whose extent is their radius
    vertex, center = _as_complex(model["vertices"]), _as_complex(model["shape_center"])
    plain = np.zeros(len(kinds), bool)
    for first in range(0, len(kinds), PART):
        part = slice(first, first + PART)
        fine = (kinds[part] == ShapeType.DISC) & (counts[part] == 1) & (radii[part] > 0)
        fine &= (model["shape_extent"][part] == radii[part]) & (vertex.take(start[:-1][part]) == center[part])
        plain[part] = fine
    others = np.flatnonzero(~plain)
    kind, count, radius = kinds[others], counts[others], radii[others]
    segment = kind == ShapeType.SEGMENT
    polygon = kind == ShapeType.POLYGON
    wrong = np.where(polygon, (count < 2) | (count > MAX_VERTICES), count != np.where(segment, SEGMENT_VERTICES, 1))
    if wrong.any():
        i = int(others[wrong.argmax()])
        words = {ShapeType.DISC: "1", ShapeType.POLYGON: f"2 to {MAX_VERTICES}", ShapeType.SEGMENT: "4"}
        shape = ShapeType(int(kinds[i]))
        limit = f"{words[shape]} above the one before it, for shape {i} is a {shape.name}"
        _refuse_first(label, "vertex_start", model, others + 1, wrong, limit)
    thin = (radius == 0) & ~segment & (count < 3)
    _refuse_first(label, "shape_radius", model, others, thin, "> 0, for its shape is a disc or capsule")
    code = kind * 16 + count
    for found in np.flatnonzero(np.bincount(code)):
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            _check_kind(model, others[code == found], int(found) // 16, int(found) % 16, label)


def _as_complex(points: np.ndarray) -> np.ndarray:
    """Points (n, 2) as complex numbers, (n,), the same memory: they are compared in one go."""
    return np.ascontiguousarray(points).view(f"c{2 * points.itemsize}")[:, 0]


def _columns(points: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Some of the points (n, 2), as x and y, (2, ...) float64, each in one piece."""
    return np.ascontiguousarray(np.moveaxis(points.take(chosen, axis=0), -1, 0), np.float64)


def _check_kind(model: Arrays, chosen: np.ndarray, kind: int, count: int, label: str) -> None:
    """Check the shapes of one type with so many vertices; a row for each vertex is faster than one for each shape."""
    n = 2 if kind == ShapeType.SEGMENT else count
    place = model["vertex_start"][chosen] + np.arange(n)[:, None]
    corners = _columns(model["vertices"], place)
    center = _columns(model["shape_center"], chosen)
    epsilon = ROUNDINGS * float(np.finfo(model["vertices"].dtype).eps)
    size = np.abs(corners).max(axis=(0, 1))
    rounding = epsilon * (size + np.abs(center).max(axis=0))

    low, high = corners.min(axis=1), corners.max(axis=1)
    outside = ((center < low - rounding) | (center > high + rounding)).any(axis=0)
    _refuse_first(label, "shape_center", model, chosen, outside, "within its shape's vertices")
    reach = np.hypot(*(corners - center[:, None])).max(axis=0) + model["shape_radius"][chosen]
    far = ~(np.abs(model["shape_extent"][chosen] - reach) <= rounding + NEAR * reach)
    _refuse_first(label, "shape_extent", model, chosen, far, "the distance of its farthest point, radius included")
    if n == 1:
        return

    edge = np.roll(corners, -1, axis=1) - corners
    length = np.hypot(*edge)
    unit = edge / length
    blur = np.nan_to_num(epsilon * size / length, nan=np.inf) + NEAR  # how far a direction may be off
    normal = _columns(model["vertex_normals"], place)
    off = np.hypot(normal[0] - unit[1], normal[1] + unit[0])
    bad = (off > blur) | ~(np.abs(np.hypot(*normal) - 1.0) <= NEAR)
    _refuse_first(label, "vertex_normals", model, place, bad, "the unit normal of the edge from its vertex")
    if n > 2:
        _check_convex(model, place, corners, unit, blur, label)


def _check_convex(
    model: Arrays, place: np.ndarray, corners: np.ndarray, unit: np.ndarray, blur: np.ndarray, label: str
) -> None:
    """Refuse polygons that turn right at a vertex, wind around more than once, or have no area."""
    before = np.roll(unit, 1, axis=1)
    sine = before[0] * unit[1] - before[1] * unit[0]
    bad = sine < -(np.roll(blur, 1, axis=0) + blur)
    _refuse_first(label, "vertices", model, place, bad, "a convex corner of a counter-clockwise polygon")
    turn = np.zeros(place.shape[1])
    if len(place) > 4:  # fewer vertices cannot wind around twice without a turn to the right
        turn = np.arctan2(np.maximum(sine, 0.0), before[0] * unit[0] + before[1] * unit[1]).sum(axis=0)
    x, y = corners[:, 1:] - corners[:, :1]
    area = (x[:-1] * y[1:] - y[:-1] * x[1:]).sum(axis=0) / 2
    square = ((corners.max(axis=1) - corners.min(axis=1)) ** 2).sum(axis=0)
    bad = (area <= TOLERANCE / 2 * square) & (blur.max(axis=0) < 2 * NEAR)
    bad |= np.rint(turn / (2 * math.pi)) > 1
    limit = "the first of a convex polygon around which vertices go once"
    _refuse_first(label, "vertices", model, place[0], bad, limit)


def _refuse_first(label: str, name: str, model: Arrays, place: np.ndarray, bad: np.ndarray, limit: str) -> None:
    """Refuse the first of some shapes or vertices, by its index among all."""
    if bad.any():
        i = int(place[bad].min())
        refuse(f"{label}{name}", model[name][i : i + 1], np.array([True]), limit, i)
