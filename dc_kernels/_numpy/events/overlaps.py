"""Sensors: which shapes overlap one, and what a step has changed of that."""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels._numpy.common import Array, Kernels, cross, dot, rotate, rotation
from dc_kernels._numpy.events.lists import compare, passes, write
from dc_kernels.model.enums import ShapeRole, ShapeType


def kernels(dtype: str) -> Kernels:
    """``sense_overlaps`` and ``note_overlaps``; the arrays bring their scalar type."""
    return {"sense_overlaps": sense_overlaps, "note_overlaps": note_overlaps}


def core_of(shape: int, origin: Array, model: Any, state: Any) -> Array:
    """Corners of the core of a shape, against an origin."""
    body, first, last = model.shape_body[shape], model.vertex_start[shape], model.vertex_start[shape + 1]
    corners = model.vertices[first : first + 2 if model.shape_type[shape] == ShapeType.SEGMENT else last]
    return state.position[body] - origin + rotate(rotation(state.angle[body]), corners)


def hull_of(points: Array) -> Array:
    """The corners of the convex hull of some points, counter-clockwise (Andrew 1979)."""
    order = points[np.lexsort((points[:, 1], points[:, 0]))]
    chains = []
    for way in (order, order[::-1]):
        chain: list[Array] = []
        for p in way:
            while len(chain) > 1 and cross(chain[-1] - chain[-2], p - chain[-2]) <= 0:
                chain.pop()
            chain.append(p)
        chains.append(chain[:-1] or chain)
    return np.array([*chains[0], *chains[1]])


def distance(a: Array, b: Array) -> Any:
    """Least distance of two convex polygons: that of the origin to the hull of all differences of their corners."""
    corners = hull_of((a[:, None] - b[None]).reshape(-1, 2))
    edges = np.roll(corners, -1, axis=0) - corners
    if len(corners) > 2 and (cross(edges, -corners) >= 0).all():
        return 0.0
    square = np.maximum(dot(edges, edges), np.finfo(corners.dtype).tiny)
    along = np.clip(dot(-corners, edges) / square, 0, 1)
    nearest = corners + along[:, None] * edges
    return np.hypot(nearest[:, 0], nearest[:, 1]).min()


def sense_overlaps(tid: int, launch: Any, model: Any, state: Any, pairs: Any, overlaps: Any) -> None:
    """Take a world's pairs of sensors out of the candidates, and list those of them that overlap, in order."""
    w = tid + launch.world_offset
    if state.flags[w]:
        return
    first = pairs.start[w]
    used = slice(first, first + pairs.count[w])
    found, others = [], []
    for a, b in zip(pairs.shape_a[used].tolist(), pairs.shape_b[used].tolist()):
        if ShapeRole.SENSOR not in (model.shape_role[a], model.shape_role[b]):
            others.append((a, b))
            continue
        origin = state.position[model.shape_body[a]]
        cores = (core_of(shape, origin, model, state) for shape in (a, b))
        if distance(*cores) <= model.shape_radius[a] + model.shape_radius[b]:
            found.append((a, b))
    kept = np.array(others, np.int32).reshape(-1, 2)
    pairs.count[w] = len(kept)
    pairs.shape_a[first : first + len(kept)], pairs.shape_b[first : first + len(kept)] = kept.T
    write(overlaps, "", w, first, found)


def note_overlaps(tid: int, launch: Any, state: Any, pairs: Any, overlaps: Any) -> None:
    """List what has begun and ended since the step before; nothing does in a world that has stopped or sleeps."""
    w = tid + launch.world_offset
    if passes(w, state, overlaps):
        overlaps.begun_count[w] = overlaps.ended_count[w] = 0
        return
    compare(overlaps, w, pairs.start[w])
