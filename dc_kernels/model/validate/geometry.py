"""Checks of shapes' vertices, normals and extents, of all shapes of a kind at once."""

from __future__ import annotations

import math

import numpy as np

from dc_kernels.model.enums import ShapeType
from dc_kernels.model.rules import refuse
from dc_kernels.model.shapes import MAX_VERTICES, NEAR, ROUNDINGS, SEGMENT_VERTICES, TOLERANCE
from dc_kernels.model.validate.glance import UNSEEN, Arrays, Glance

PART = 2**14  # shapes that are looked at together, within the processor's cache


def check_geometry(model: Arrays, label: str, glance: Glance = UNSEEN) -> None:
    """Hold the shapes of a model to what its builder guarantees, to the rounding of its scalar.

    A disc has one vertex, its centre; a polygon 2 vertices (a capsule) or 3 to 8, convex and counter-clockwise; a
    segment 4. Discs and capsules have a radius. Normals are the unit normals of the edges. The centre lies within the
    vertices' box, and the extent is the distance of the farthest point.

    Args:
        model: arrays of a model whose offsets and types are right.
        label: what stands before the name of an array in errors.
        glance: compiled looks, if the arrays have those that they need.

    Raises:
        BrokenRule: naming array, index, value and limit.
    """
    if glance.shapes(model):
        return
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
    """Some of the points (n, 2), as x and y, (2, m) float64, each in one piece."""
    return np.ascontiguousarray(points.take(chosen, axis=0).T, np.float64)


def _check_kind(model: Arrays, chosen: np.ndarray, kind: int, count: int, label: str) -> None:
    """Check the shapes of one type with so many vertices; arrays of a vertex each are faster than short rows."""
    n = 2 if kind == ShapeType.SEGMENT else count
    first = model["vertex_start"][chosen]
    corners = [_columns(model["vertices"], first + k) for k in range(n)]
    center = _columns(model["shape_center"], chosen)
    epsilon = ROUNDINGS * float(np.finfo(model["vertices"].dtype).eps)
    size = np.max([np.maximum(abs(x), abs(y)) for x, y in corners], axis=0)
    rounding = epsilon * (size + np.maximum(abs(center[0]), abs(center[1])))

    low, high = np.min(corners, axis=0), np.max(corners, axis=0)
    outside = ((center < low - rounding) | (center > high + rounding)).any(axis=0)
    _refuse_first(label, "shape_center", model, chosen, outside, "within its shape's vertices")
    reach = np.max([np.hypot(*(corner - center)) for corner in corners], axis=0) + model["shape_radius"][chosen]
    far = ~(np.abs(model["shape_extent"][chosen] - reach) <= rounding + NEAR * reach)
    _refuse_first(label, "shape_extent", model, chosen, far, "the distance of its farthest point, radius included")
    if n == 1:
        return

    unit, blur = [], []  # direction of each edge, and how far it may be off
    for k in range(n):
        edge = corners[(k + 1) % n] - corners[k]
        length = np.hypot(*edge)
        unit.append(edge / length)
        blur.append(np.nan_to_num(epsilon * size / length, nan=np.inf) + NEAR)
        normal = _columns(model["vertex_normals"], first + k)
        off = np.hypot(normal[0] - unit[k][1], normal[1] + unit[k][0])
        bad = (off > blur[k]) | ~(np.abs(np.hypot(*normal) - 1.0) <= NEAR)
        _refuse_first(label, "vertex_normals", model, first + k, bad, "the unit normal of the edge from its vertex")
    if n > 2:
        _check_convex(model, first, corners, unit, blur, label)


def _check_convex(
    model: Arrays,
    first: np.ndarray,
    corners: list[np.ndarray],
    unit: list[np.ndarray],
    blur: list[np.ndarray],
    label: str,
) -> None:
    """Refuse polygons that turn right at a vertex, wind around more than once, or have no area."""
    n = len(corners)
    turn = np.zeros(len(first))
    area = np.zeros(len(first))
    for k in range(n):
        before, after = unit[k - 1], unit[k]
        sine = before[0] * after[1] - before[1] * after[0]
        bad = sine < -(blur[k - 1] + blur[k])
        _refuse_first(label, "vertices", model, first + k, bad, "a convex corner of a counter-clockwise polygon")
        if n > 4:  # fewer vertices cannot wind around twice without a turn to the right
            turn += np.arctan2(np.maximum(sine, 0.0), before[0] * after[0] + before[1] * after[1])
        one, next_one = corners[k] - corners[0], corners[(k + 1) % n] - corners[0]
        area += (one[0] * next_one[1] - one[1] * next_one[0]) / 2
    square = np.sum((np.max(corners, axis=0) - np.min(corners, axis=0)) ** 2, axis=0)
    bad = (area <= TOLERANCE / 2 * square) & (np.max(blur, axis=0) < 2 * NEAR)
    bad |= np.rint(turn / (2 * math.pi)) > 1
    _refuse_first(label, "vertices", model, first, bad, "the first of a convex polygon around which vertices go once")


def _refuse_first(label: str, name: str, model: Arrays, place: np.ndarray, bad: np.ndarray, limit: str) -> None:
    """Refuse the first of some shapes or vertices, by its index among all."""
    if bad.any():
        i = int(place[bad.argmax()])
        refuse(f"{label}{name}", model[name][i : i + 1], np.array([True]), limit, i)
