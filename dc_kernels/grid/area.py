"""What a body covers: points spread over its area, and the nodes of a grid that static shapes cover.

Both are worked out once, in float64 numpy, and used in every splat.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Literal, NamedTuple

import numpy as np

from dc_kernels.grid.grid import Grid
from dc_kernels.model.arrays import Model, State
from dc_kernels.model.enums import BodyType, ShapeType
from dc_kernels.model.shapes import edge_normals, mass_properties

ARC_STEP = math.pi / 64
"""Largest angle between two vertices of an arc as a polygon: chords lie up to 3.1e-4 of the radius inside [rad]."""
SECTORS = 4
"""Sectors of a disc's innermost ring; ring k has (2 k - 1) times as many, so that all cells have one area [1]."""
EDGES_AT_ONCE = 1_000_000
"""Edges of a polygon times corners of its lattice that are worked on at once: 8 MB an array [1]."""
NEAR = 0.5 * (1.0 + 1e-6)
"""How near to a shape a node counts as covered, with room for the round-off of float32 positions [spacing]."""


SHAPE_ARRAYS = ("shape_body", "shape_type", "shape_radius", "vertex_start", "vertices")
"""Arrays of a model that describe the outlines of its shapes."""


class AreaPoints(NamedTuple):
    """Points spread over bodies, sorted by body (see ``area_points``)."""

    start: np.ndarray  # first point of each world, (W + 1,) int32
    body: np.ndarray  # (n,) int32
    point: np.ndarray  # in the body's frame, relative to its centre of mass, (n, 2) [m], of the model's dtype
    weight: np.ndarray  # share of the body, sums to 1 over its points, (n,) [1], of the model's dtype


def center_points(model: Model) -> AreaPoints:
    """The centre of mass of each dynamic body as its only point."""
    return body_centers(model.numpy("body_type"), model.numpy("body_start"), model.dtype)


def body_centers(body_type: np.ndarray, body_start: np.ndarray, dtype: np.dtype) -> AreaPoints:
    """The centre of mass of each dynamic body as its only point.

    Args:
        body_type: of all bodies, (bodies,).
        body_start: first body of each world, (W + 1,).
        dtype: of the points.
    """
    body = np.flatnonzero(body_type == BodyType.DYNAMIC).astype(np.int32)
    return _pack(body_start, dtype, body, np.zeros((len(body), 2)), np.ones(len(body)))


def area_points(model: Model, spacing: float, bodies: Literal["dynamic", "moving", "all"] = "dynamic") -> AreaPoints:
    """Points that stand for the bodies' areas: a point for each cell, at its centroid, weighing its area.

    Discs are cut into rings and sectors of equal area, other shapes along a square lattice in the body's frame; cells
    are at most ``spacing`` wide. Of each shape, total area and first moment are exact to round-off. A cell's own
    second moment is lost: the radius of gyration squared about the centroid is too small, by at most spacing^2 / 6
    (as a convex piece of a square of side a has at most a^2 / 12 about each axis). Rounded corners and capsules are
    cut as polygons whose arcs keep within 3.1e-4 of the rounding radius, then corrected to the exact area and centroid.

    Weights are shares of the body's area, shapes that overlap counting twice, as they do in its mass; a body's mass
    and other sums over its points are those of the body. The model does not store densities: where the shapes of a
    body differ in density, weights follow the areas all the same, and their first moment is that of the areas, not 0.

    Args:
        model: the bodies.
        spacing: largest width of a cell, > 0 [m].
        bodies: "dynamic", "moving" (kinematic ones too) or "all". A body that moves and has no area is the point at its
            centre of mass; a static one without area (a chain) is left out.

    Raises:
        ValueError: for a spacing out of range, an unknown choice of bodies, or 2^31 points or more.
    """
    if not (0.0 < spacing < float("inf")):
        raise ValueError(f"spacing is {spacing!r}; it must be finite and > 0 [m]")
    least = {"dynamic": BodyType.DYNAMIC, "moving": BodyType.KINEMATIC, "all": BodyType.STATIC}
    if bodies not in least:
        raise ValueError(f"bodies is {bodies!r}; it must be one of {tuple(least)}")
    arrays = {name: model.numpy(name) for name in SHAPE_ARRAYS}
    kind, shape_body = model.numpy("body_type"), arrays["shape_body"]
    has_area = model.numpy("shape_type") != ShapeType.SEGMENT
    known: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}  # most scenes have few different shapes
    owner, found, weight = [], [], []
    count = 0
    for shape, vertices, radius in _hulls(arrays, (kind[shape_body] >= least[bodies]) & has_area):
        # cut in a frame that equal shapes at different places share
        corner = vertices[0].copy()
        key = (vertices - corner).tobytes() + np.float64(radius).tobytes()
        if key not in known:
            known[key] = shape_points(vertices - corner, radius, spacing)
        points, areas = known[key]
        count += len(points)
        if count >= 2**31:
            raise ValueError(f"spacing is {spacing!r}: the bodies have 2^31 points or more; it must be larger")
        owner.append(np.full(len(points), shape_body[shape]))
        found.append(points + corner)
        weight.append(areas)
    covered = np.concatenate([np.zeros(0, np.int64), *owner])
    points = np.concatenate([np.zeros((0, 2)), *found])
    areas = np.concatenate([np.zeros(0), *weight])
    total = np.bincount(covered, areas, model.body_count)
    areas = areas / total[covered]
    bare = np.flatnonzero((kind >= max(least[bodies], BodyType.KINEMATIC)) & (total == 0))
    body = np.concatenate([covered, bare])
    order = np.argsort(body, kind="stable")
    points = np.concatenate([points, np.zeros((len(bare), 2))])[order]
    return _pack(
        model.numpy("body_start"), model.dtype, body[order], points, np.concatenate([areas, np.ones(len(bare))])[order]
    )


def shape_points(vertices: np.ndarray, radius: float, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Points of one convex shape and the areas they stand for: (n, 2) [m] and (n,) [m^2] (see ``area_points``).

    Args:
        vertices: (n, 2) [m], n = 1 is a disc, 2 a capsule, more a polygon, counter-clockwise.
        radius: by which the shape is rounded [m].
        spacing: largest width of a cell [m].
    """
    if len(vertices) == 1:
        points, areas = _cut_disc(radius, spacing)
        return vertices[0] + points, areas
    exact = mass_properties(vertices, radius)
    points, areas = _cut_polygon(_outline(vertices, radius), spacing)
    areas *= exact.area / areas.sum()
    return points + (exact.centroid - areas @ points / exact.area), areas


def wall_nodes(model: Model, state: State, grid: Grid) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The nodes inside a static shape or within half a spacing of one, by exact distances.

    The theses gave such nodes a mass of 100 kg. In their box they are the nodes of the border, without the open side.

    Args:
        model: its static bodies count.
        state: where they are.
        grid: relative to each world's origin, as positions are.

    Returns:
        World, row and column of each node: three arrays of int32, sorted in this order, each node once.
    """
    names = ("body_type", "shape_start", *SHAPE_ARRAYS)
    placed = {name: state.numpy(name) for name in ("position", "angle")}
    return covered_nodes({**{name: model.numpy(name) for name in names}, **placed}, grid)


def covered_nodes(arrays: Mapping[str, np.ndarray], grid: Grid) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The nodes of ``wall_nodes``, of arrays by the names that they have in model and state.

    Args:
        arrays: body_type, shape_start, those of ``SHAPE_ARRAYS``, position and angle.
        grid: relative to each world's origin, as positions are.
    """
    shape_body, shape_start = arrays["shape_body"], arrays["shape_start"]
    static = arrays["body_type"][shape_body] == BodyType.STATIC
    world_of = np.repeat(np.arange(len(shape_start) - 1), np.diff(shape_start))
    position, angles = arrays["position"].astype(float), arrays["angle"].astype(float)
    reach = NEAR * grid.spacing
    nodes = [np.zeros(0, np.int64)]
    for shape, vertices, radius in _hulls(arrays, static):
        body, w = shape_body[shape], world_of[shape]
        c, s = math.cos(angles[body]), math.sin(angles[body])
        hull = vertices @ np.array([[c, s], [-s, c]]) + position[body]
        margin = radius + reach
        sizes = np.array([grid.columns, grid.rows])  # a hull may lie farther off than integers reach
        low = np.clip(np.ceil((hull.min(axis=0) - margin - grid.origin) / grid.spacing), 0, sizes)
        high = np.clip(np.floor((hull.max(axis=0) + margin - grid.origin) / grid.spacing), -1, sizes - 1)
        column, row = np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(low, high)))
        places = grid.origin + grid.spacing * np.stack([column, row], axis=-1)
        near = hull_distance(places, hull) <= margin
        nodes.append((w * grid.rows + row[near].astype(np.int64)) * grid.columns + column[near].astype(np.int64))
    found = np.unique(np.concatenate(nodes))
    rest, column = np.divmod(found, grid.columns)
    world, row = np.divmod(rest, grid.rows)
    return world.astype(np.int32), row.astype(np.int32), column.astype(np.int32)


def hull_distance(points: np.ndarray, hull: np.ndarray) -> np.ndarray:
    """Distance of points (..., 2) to the convex hull of one or two points or a counter-clockwise polygon; 0 inside."""
    start = hull
    along = np.roll(hull, -1, axis=0) - start
    square = np.maximum((along * along).sum(axis=1), np.finfo(float).tiny)
    to = points[..., None, :] - start
    t = np.clip((to * along).sum(axis=-1) / square, 0.0, 1.0)
    away = to - t[..., None] * along
    distance = np.hypot(away[..., 0], away[..., 1]).min(axis=-1)
    if len(hull) > 2:
        left = along[:, 0] * to[..., 1] - along[:, 1] * to[..., 0] >= 0.0
        distance[left.all(axis=-1)] = 0.0
    return distance


def _pack(
    body_start: np.ndarray, dtype: np.dtype, body: np.ndarray, point: np.ndarray, weight: np.ndarray
) -> AreaPoints:
    start = np.searchsorted(body, body_start)
    return AreaPoints(start.astype(np.int32), body.astype(np.int32), point.astype(dtype), weight.astype(dtype))


def _hulls(arrays: Mapping[str, np.ndarray], chosen: np.ndarray) -> Iterator[tuple[int, np.ndarray, float]]:
    """Of the chosen shapes, index, hull in the body's frame in float64, and the radius that rounds it."""
    vertices, radius = arrays["vertices"].astype(float), arrays["shape_radius"].astype(float)
    first = arrays["vertex_start"][:-1]
    # behind the two vertices of a segment are the chain's neighbours
    count = np.where(arrays["shape_type"] == ShapeType.SEGMENT, 2, np.diff(arrays["vertex_start"]))
    for shape in np.flatnonzero(chosen).tolist():
        yield shape, vertices[first[shape] : first[shape] + count[shape]], float(radius[shape])


def _cut_disc(radius: float, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Cells of equal area, about as wide as long, with a second moment that has no direction."""
    rings = math.ceil(radius / spacing)
    points = []
    for k in range(1, rings + 1):
        sectors = SECTORS * (2 * k - 1)
        half = math.pi / sectors
        # centroid of a sector of a ring
        distance = 2.0 / 3.0 * (k**3 - (k - 1) ** 3) / (2 * k - 1) * math.sin(half) / half * radius / rings
        angle = (2.0 * np.arange(sectors) + 1.0) * half
        points.append(distance * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    cells = SECTORS * rings**2
    return np.concatenate(points), np.full(cells, math.pi * radius**2 / cells)


def _outline(vertices: np.ndarray, radius: float) -> np.ndarray:
    """A rounded hull as a polygon, counter-clockwise, its arcs by chords."""
    if radius == 0.0:
        return vertices
    normals = edge_normals(vertices)
    corners = []
    for vertex, before, after in zip(vertices, np.roll(normals, 1, axis=0), normals):
        turn = math.atan2(before[0] * after[1] - before[1] * after[0], before @ after) % (2.0 * math.pi)
        steps = math.ceil(turn / ARC_STEP)
        angle = math.atan2(before[1], before[0]) + turn * np.arange(steps + 1) / steps
        corners.append(vertex + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    return np.concatenate(corners)


def _cut_polygon(vertices: np.ndarray, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Centroids and areas of a convex polygon's pieces in the cells of a lattice fitted to its box."""
    low, size = vertices.min(axis=0), np.ptp(vertices, axis=0)
    cells = np.maximum(np.ceil(size / spacing - 1e-9), 1).astype(int)
    x, y = (side * np.arange(n + 1) / n for side, n in zip(size, cells))
    start = vertices - low
    edge = np.roll(start, -1, axis=0) - start
    blocks = math.ceil(len(edge) * len(x) * len(y) / EDGES_AT_ONCE)
    parts = zip(np.array_split(start, blocks), np.array_split(edge, blocks))
    below = sum(_moments_below(a, b, x, y) for a, b in parts)
    area, first_x, first_y = np.diff(np.diff(below, axis=1), axis=2).reshape(3, -1)
    kept = area > 1e-9 * area.sum()
    area = area[kept]
    return low + np.stack([first_x[kept], first_y[kept]], axis=1) / area[:, None], area


def _moments_below(start: np.ndarray, edge: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """What edges of a polygon add to area and first moments of its part left of x and below y: (3, nx, ny).

    By Green's theorem these are integrals along the edges: the area is that of -(x - X) dY over the stretch of each
    edge that is left of x and below y.

    Args:
        start: (edges, 2), where they begin, with coordinates >= 0 [m].
        edge: (edges, 2), to where they end [m].
        x: (nx,) [m].
        y: (ny,) [m].
    """
    start, edge = start[:, None, None], edge[:, None, None]
    x, y = x[None, :, None], y[None, None, :]
    t0, t1 = np.zeros((1, 1, 1)), np.ones((1, 1, 1))
    for ahead, slope in ((x - start[..., 0], edge[..., 0]), (y - start[..., 1], edge[..., 1])):
        with np.errstate(divide="ignore", invalid="ignore"):
            at = ahead / slope
        t0 = np.maximum(t0, np.where(slope < 0, at, np.where((slope == 0) & (ahead < 0), 1.0, 0.0)))
        t1 = np.minimum(t1, np.where(slope > 0, at, 1.0))
    length = np.maximum(t1 - t0, 0.0)
    total = np.zeros((3, x.shape[1], y.shape[2]))
    weight = -0.5 * length * edge[..., 1]
    for place in (0.5 - math.sqrt(1.0 / 12.0), 0.5 + math.sqrt(1.0 / 12.0)):
        # Gauss, two points: exact, as integrands are of second degree
        t = t0 + length * place
        px, py = start[..., 0] + t * edge[..., 0], start[..., 1] + t * edge[..., 1]
        flux = weight * (x - px)
        total += [flux.sum(axis=0), (flux * 0.5 * (x + px)).sum(axis=0), (flux * py).sum(axis=0)]
    return total
