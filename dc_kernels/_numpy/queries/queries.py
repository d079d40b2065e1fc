"""Queries that test every shape of a world; what is asked with meets the hull of all differences of corners."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from dc_kernels._numpy.common import Array, Kernels, cross, dot
from dc_kernels.model.enums import ShapeType
from dc_kernels.queries.fields import CHUNK


def kernels(dtype: str) -> Kernels:
    """``build_tree``, ``cast_shapes``, ``find_overlaps``, ``find_closest``; all is worked out in float64."""
    return {
        "build_tree": build_tree,
        "cast_shapes": cast_shapes,
        "find_overlaps": find_overlaps,
        "find_closest": find_closest,
    }


def build_tree(tid: int, world_offset: int, model: Any, boxes: Any, scratch: Array, tree: Any) -> None:
    """Make no tree: every shape is tested."""


def cast_shapes(
    tid: int, world_offset: int, queries: int, model: Any, tree: Any, probe: Any, query: Any, hit: Any
) -> None:
    """Find what the probe of each query meets first along its translation; of equals the shape of least index."""
    for q in _of_chunk(tid + world_offset, queries):
        origin, translation = _vector(query.place, q), _vector(query.translation, q)
        own = _corners(query, probe, q)
        best, met, normal = 1.0, -1, np.zeros(2)
        for s, hull, radius in _shapes(q, model, tree, query):
            found = _cast(_difference(hull, own), radius + probe.radius, origin, translation)
            if found is not None and (found[0] < best or (found[0] == best and met < 0)):
                (best, normal), met = found, s
        point = origin + best * translation
        if met >= 0 and normal.any():
            point = point + _front(own, probe.radius, -normal, _placed(met, model, tree) - point)
        hit.shape[q], hit.fraction[q], hit.point[q], hit.normal[q] = met, best, point, normal


def find_overlaps(
    tid: int,
    world_offset: int,
    queries: int,
    model: Any,
    tree: Any,
    probe: Any,
    query: Any,
    list_start: Array,
    list_count: Array,
    index: Array,
) -> None:
    """Count the shapes that the probe of each query overlaps or touches, and store them where there is room."""
    for q in _of_chunk(tid + world_offset, queries):
        origin, own = _vector(query.place, q), _corners(query, probe, q)
        found = [
            s
            for s, hull, radius in _shapes(q, model, tree, query)
            if _distance(_difference(hull, own), origin)[0] <= radius + probe.radius
        ]
        list_count[q] = len(found)
        if len(index):
            index[list_start[q] : list_start[q] + len(found)] = found


def find_closest(
    tid: int, world_offset: int, queries: int, model: Any, tree: Any, probe: Any, query: Any, hit: Any
) -> None:
    """Find the shape of least signed distance from each point, none beyond ``query.most``."""
    for q in _of_chunk(tid + world_offset, queries):
        place = _vector(query.place, q)
        best, met, normal = float(query.most[q]), -1, np.zeros(2)
        for s, hull, radius in _shapes(q, model, tree, query):
            far, direction = _distance(hull, place)
            if far - radius < best or (far - radius == best and met < 0):
                best, met, normal = far - radius, s, direction
        point = place - best * normal if met >= 0 else place
        hit.shape[q], hit.fraction[q], hit.point[q], hit.normal[q] = met, best, point, normal


def _of_chunk(chunk: int, queries: int) -> range:
    return range(chunk * CHUNK, min((chunk + 1) * CHUNK, queries))


def _vector(values: Array, q: int) -> Array:
    return values[q].astype(np.float64)


def _corners(query: Any, probe: Any, q: int) -> Array:
    """The corners of what a query asks with, about its position."""
    corners = probe.corner.astype(np.float64)
    if len(query.scale):
        corners = corners * query.scale[q]
    if len(query.rotation):
        c, s = query.rotation[q].astype(np.float64)
        corners = corners @ np.array([[c, s], [-s, c]])
    return corners


def _placed(s: int, model: Any, tree: Any) -> Array:
    """The corners of a shape where its body is."""
    first, last = model.vertex_start[s : s + 2]
    if model.shape_type[s] == ShapeType.SEGMENT:
        last = first + 2
    b = model.shape_body[s]
    c, sine = tree.rotation[b].astype(np.float64)
    return model.vertices[first:last].astype(np.float64) @ np.array([[c, sine], [-sine, c]]) + tree.place[b]


def _shapes(q: int, model: Any, tree: Any, query: Any) -> Iterator[tuple[int, Array, float]]:
    """Index, corners and radius of the shapes that a query asks about."""
    w = int(query.world[q]) if len(query.world) else 0
    for s in range(model.shape_start[w], model.shape_start[w + 1]):
        if len(query.mask) and not model.shape_category[s] & query.mask[q]:
            continue
        if len(query.skip) and model.shape_body[s] == query.skip[q]:
            continue
        if np.isnan(tree.place[model.shape_body[s]]).any():  # of an empty slot
            continue
        yield s, _placed(s, model, tree), float(model.shape_radius[s])


def _difference(hull: Array, own: Array) -> Array:
    """The convex hull of all differences of corners, counter-clockwise (Andrew 1979)."""
    points = np.unique((hull[:, None] - own).reshape(-1, 2), axis=0)
    if len(points) < 3:
        return points

    def half(rows: Array) -> list[Array]:
        chain: list[Array] = []
        for p in rows:
            while len(chain) > 1 and cross(chain[-1] - chain[-2], p - chain[-2]) <= 0:
                chain.pop()
            chain.append(p)
        return chain[:-1]

    return np.array(half(points) + half(points[::-1]))


def _edges(hull: Array) -> tuple[Array, Array]:
    """Edges of a hull, and their normals out of it."""
    edge = np.roll(hull, -1, axis=0) - hull
    normal = np.stack([edge[:, 1], -edge[:, 0]], axis=1)
    return edge, normal / np.hypot(*normal.T)[:, None]


def _distance(hull: Array, point: Array) -> tuple[float, Array]:
    """Signed distance of a point to a hull, and the direction along which it is taken."""
    if len(hull) == 1:
        away = point - hull[0]
        far = np.hypot(*away)
        return far, away / far if far > 0 else np.array([0.0, 1.0])
    edge, normal = _edges(hull)
    ahead = dot(normal, point - hull)
    if len(hull) > 2 and (ahead <= 0).all():
        k = int(ahead.argmax())
        return float(ahead[k]), normal[k]
    along = np.clip(dot(edge, point - hull) / dot(edge, edge), 0.0, 1.0)
    away = point - (hull + along[:, None] * edge)
    far = np.hypot(*away.T)
    k = int(far.argmin())
    return float(far[k]), away[k] / far[k] if far[k] > 0 else normal[k]


def _cast(hull: Array, radius: float, origin: Array, translation: Array) -> tuple[float, Array] | None:
    """Fraction and normal where a point meets a rounded hull first; None where it does not."""
    if (radius > 0 or len(hull) > 2) and _distance(hull, origin)[0] <= radius:
        return 0.0, np.zeros(2)
    found = []
    if len(hull) > 1:
        edge, normal = _edges(hull)
        for corner, side, out in zip(hull + radius * normal, edge, normal):
            speed = dot(out, translation)
            if speed < 0:
                t = dot(out, corner - origin) / speed
                part = dot(side, origin + t * translation - corner) / dot(side, side)
                if 0 <= t <= 1 and -1e-12 <= part <= 1 + 1e-12:
                    found.append((t, out))
    square = dot(translation, translation)
    for corner in hull if radius > 0 and square > 0 else []:
        away = origin - corner
        half = radius**2 - cross(away, translation) ** 2 / square
        if half >= 0:
            t = -dot(away, translation) / square - np.sqrt(half / square)
            if 0 <= t <= 1:
                found.append((t, (away + t * translation) / radius))
    return min(found, key=lambda hit: hit[0], default=None)


def _front(own: Array, radius: float, ahead: Array, other: Array) -> Array:
    """The foremost point of what is cast; where a side meets a side, the middle of what both have in common."""
    if len(own) == 1:
        return radius * ahead
    tangent = np.array([-ahead[1], ahead[0]])
    spans = []
    for corners, direction in ((own, ahead), (other, -ahead)):
        out = dot(corners, direction)
        front = corners[out >= out.max() - 1e-6 * np.abs(corners).sum(axis=1).max()]
        spans.append((dot(front, tangent).min(), dot(front, tangent).max()))
    middle = (max(low for low, _ in spans) + min(high for _, high in spans)) / 2
    return middle * tangent + (dot(own, ahead).max() + radius) * ahead
