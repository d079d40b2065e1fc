"""Where two shapes will meet: their manifold at the time at which the motion of the step closes the gap.

Of the axes that part two shapes the motion closes one after the other, and they meet along the one that it closes last
(conservative advancement, Mirtich 1996); two corners are nearest where the line of motion passes. What moves without
turning misses what lies beside the strip that it sweeps (van den Bergen 2004).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels._numpy.collide.manifold import Hull, Manifold, disc_disc, hull_disc, hull_hull, length
from dc_kernels._numpy.common import Array, dot

FAST = 0.1  # way in a step over the distance of two discs, below which an arc is its tangent to 0.5 %
HORIZON = 1.25  # steps to look ahead: what forces accelerate closes before its velocity says


def disc_disc_moving(
    pa: Array, ra: Any, pb: Array, rb: Any, w: Array, *, dt: Any, slop: Any, fast: Any, epsilon: float
) -> Manifold:
    """Two discs, of which B moves by w; where they pass each other the gap is what w may close of it.

    Where the way is more than ``fast`` times the radii, they meet along the line of their centres at the time at which
    they touch.
    """
    m = disc_disc(pa, ra, pb, rb, epsilon)
    (point, gap, feature), d = m.points[0], pb - pa
    closing, radii = -dot(m.normal, w) * dt, ra + rb
    if slop < gap < closing and length(w) * dt > FAST * radii:
        squared = dot(w, w)
        when = dot(d, w) / squared
        miss = dot(d - w * when, d - w * when)
        hits, swift = miss < radii * radii, length(w) * dt > fast * radii
        time = -when - np.sqrt((radii * radii - miss) / squared) if hits else dt
        if hits and swift and time < dt:
            m.moved = w * time
            m.normal = (d + m.moved) / radii
            m.points = [(pa + m.normal * ra, -dot(m.normal, m.moved), feature)]
        elif swift or not hits:
            m.points = [(point, max(length(d + w * dt) - radii + closing, gap), feature)]
    return m


def hull_hull_beside(a: Hull, b: Hull, m: Manifold, w: Array) -> Manifold:
    """The manifold of two hulls in the frame of A; where B's way misses A, the plane along it that parts them."""
    along = w / length(w)
    across = np.array([-along[1], along[0]], w.dtype)
    of_a, of_b = dot(a.vertices, across), dot(b.vertices, across)
    i, j, gap = int(np.argmax(of_a)), int(np.argmin(of_b)), of_b.min() - of_a.max()
    if of_a.min() - of_b.max() > gap:
        i, j, gap, across = int(np.argmin(of_a)), int(np.argmax(of_b)), of_a.min() - of_b.max(), -across
    gap = gap - a.radius - b.radius
    if gap < 0:
        return m
    point = a.vertices[i] + across * (a.radius + 0.5 * gap)
    moved = along * dot(along, a.vertices[i] - b.vertices[j])
    return Manifold(across, [(point, gap, i << 8 | j)], corner=True, beside=True, moved=moved)


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
    a: Hull,
    b: Hull,
    w: Array,
    share: Any,
    *,
    swift: bool,
    dt: Any,
    reach: Any,
    slack: Any,
    overlap: Any,
    epsilon: float,
) -> Manifold:
    """Two hulls in the frame of A, of which B moves by w and does ``share`` of it [1].

    Where they are ``swift`` and apart, they miss each other beside the strip that B sweeps.
    """
    m = hull_hull(a, b, reach, slack, overlap, epsilon)
    if not m.points:
        return m
    swift = swift and m.least_gap > overlap
    if m.beside or swift:
        m = hull_hull_closing(a, b, m, w, share, dt=dt, slack=slack, overlap=overlap, epsilon=epsilon)
    if swift and -dot(m.normal, w) * dt > m.least_gap + slack:
        return hull_hull_beside(a, b, m, w)
    return m


def hull_hull_closing(
    a: Hull, b: Hull, m: Manifold, w: Array, share: Any, *, dt: Any, slack: Any, overlap: Any, epsilon: float
) -> Manifold:
    """Two hulls along the axis that w closes last; ``m`` is their manifold of now."""
    if dot(w, w) * dt * dt <= slack * slack:
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
