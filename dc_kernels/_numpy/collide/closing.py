"""Where two shapes will meet: their manifold at the time at which the motion of the step closes the gap.

Of the axes that part two shapes the motion closes one after the other, and they meet along the one that it closes last
(conservative advancement, Mirtich 1996); two corners are nearest where the line of motion passes.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels._numpy.collide.manifold import Hull, Manifold, disc_disc, hull_disc, hull_hull, length
from dc_kernels._numpy.common import Array, dot

FAST = 0.1  # way in a step over the distance of two discs, below which an arc is its tangent to 0.5 %
HORIZON = 1.25  # steps to look ahead: what forces accelerate closes before its velocity says


def disc_disc_moving(pa: Array, ra: Any, pb: Array, rb: Any, w: Array, dt: Any, slop: Any, epsilon: float) -> Manifold:
    """Two discs, of which B moves by w; where they pass each other the gap is what w may close of it."""
    m = disc_disc(pa, ra, pb, rb, epsilon)
    (point, gap, feature), d = m.points[0], pb - pa
    closing, radii = -dot(m.normal, w) * dt, ra + rb
    if slop < gap < closing and length(w) * dt > FAST * radii:
        if length(d - w * (dot(d, w) / dot(w, w))) >= radii:
            m.points = [(point, max(length(d + w * dt) - radii + closing, gap), feature)]
    return m


def closing_time(gaps: Array, speeds: Array, overlap: Any, horizon: Any) -> Any:
    """When the last of those axes is closed that the motion closes within the horizon; 0 without any."""
    closed = (gaps >= -overlap) & (speeds < 0) & (gaps + overlap <= -speeds * horizon)
    return ((gaps[closed] + overlap) / -speeds[closed]).max(initial=0.0)


def corner_time(time: Any, d: Array, w: Array, radius: Any, within: Any, touching: bool, horizon: Any) -> Any:
    """When two corners, ``d`` apart at ``time``, are at ``radius`` from each other, or nearest if never."""
    squared = dot(w, w)
    nearest = -dot(d, w) / squared
    at = d + w * nearest
    if radius > 0 and dot(at, at) < radius * radius:
        nearest -= np.sqrt((radius * radius - dot(at, at)) / squared)
    when = max(time + nearest, time * 0)
    near = touching or length(d + w * (horizon - time)) <= within  # at the horizon: it slides over the corner
    return when if near else min(when, horizon)


def hull_disc_moving(
    hull: Hull, p: Array, r: Any, w: Array, *, dt: Any, slack: Any, overlap: Any, epsilon: float
) -> Manifold:
    """Hull against a disc at p that moves by w; the point is the disc's, so that the normal passes its centre."""
    m = hull_disc(hull, p, r, epsilon)
    if not m.points or dot(w, w) * dt * dt <= slack * slack:
        return m
    radii, horizon = hull.radius + r, HORIZON * dt
    gaps = dot(hull.normals, p - hull.vertices) - radii
    time = closing_time(gaps, dot(hull.normals, w), overlap, horizon)
    m.beside = m.corner or int((gaps >= -overlap).sum()) > 1
    if time == 0 and not m.corner:
        return m
    later = hull_disc(hull, p + w * time, r, epsilon)
    if later.corner:
        apart = later.normal * (later.distance + radii)
        time = corner_time(time, apart, w, radii - overlap, radii + overlap, m.distance <= overlap, horizon)
        later = hull_disc(hull, p + w * time, r, epsilon)
    if not later.points or (later.normal == m.normal).all():
        return m
    gap = later.distance - dot(later.normal, w) * time
    if gap < -overlap - slack:
        return m
    return Manifold(later.normal, [(p - later.normal * (r + 0.5 * gap), gap, later.points[0][2])], beside=True)


def hull_hull_moving(
    a: Hull, b: Hull, w: Array, share: Any, *, dt: Any, reach: Any, slack: Any, overlap: Any, epsilon: float
) -> Manifold:
    """Two hulls in the frame of A, of which B moves by w and does ``share`` of it [1]."""
    m = hull_hull(a, b, reach, slack, overlap, epsilon)
    if not m.points or not m.beside or dot(w, w) * dt * dt <= slack * slack:
        return m
    radii, horizon = a.radius + b.radius, HORIZON * dt
    of_a = dot(a.normals[:, None], b.vertices[None] - a.vertices[:, None]).min(axis=1) - radii
    of_b = dot(b.normals[:, None], a.vertices[None] - b.vertices[:, None]).min(axis=1) - radii
    gaps, speeds = np.concatenate([of_a, of_b]), np.concatenate([dot(a.normals, w), -dot(b.normals, w)])
    time = closing_time(gaps, speeds, overlap, horizon)
    if time == 0 and not m.corner:
        return m
    later = hull_hull(a, b.moved(w * time), np.inf, slack, overlap, epsilon)
    if later.corner:
        apart = later.normal * (later.distance + radii)
        time = corner_time(time, apart, w, radii - overlap, radii + overlap, m.distance <= overlap, horizon)
        later = hull_hull(a, b.moved(w * time), np.inf, slack, overlap, epsilon)
    shift = dot(later.normal, w) * time
    if not later.points or later.least_gap - shift < -overlap - slack:
        return m
    back = (w * time - later.normal * shift) * share + later.normal * (0.5 * shift)
    points = [(point - back, gap - shift, feature) for point, gap, feature in later.points]
    return Manifold(later.normal, points, beside=True)
