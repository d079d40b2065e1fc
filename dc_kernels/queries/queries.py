"""Ray casts, shape casts, overlaps and closest points, in all worlds at once."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from dc_kernels.collide.shapes import ShapeBoxes, Shapes, whole_group
from dc_kernels.model.arrays import to_numpy
from dc_kernels.model.checks import check_values, numeric
from dc_kernels.model.dtypes import numpy_spec
from dc_kernels.model.fields import MODEL
from dc_kernels.model.shapes import MAX_VERTICES, convex_polygon, points
from dc_kernels.neighbors.search import Neighbors
from dc_kernels.queries.fields import CHUNK, HIT, LANES, PROBE, QUERY, TREE
from dc_kernels.runtime.backends import bind, host_threads, kernel_file, make_kernels, on_numpy
from dc_kernels.runtime.capture import refuse_recording
from dc_kernels.runtime.inputs import check_count, check_index, check_not_negative
from dc_kernels.runtime.interop import InPlace

READ = ("shape_start", "shape_body", "shape_type", "shape_radius", "shape_category", "vertex_start", "vertices")
SLICE = 2**18  # queries between which an interrupt arrives: some tenths of a second
POINT = np.zeros((1, 2))
BOX = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
MAX_FOUND = 2**31 - 1
SHORT = 1e-5  # of its size: a side as short as float32 tells


@dataclass(frozen=True)
class Hits:
    """The first hits of rays or moving shapes, one element for each."""

    shape: np.ndarray
    """Shapes, numbered over all worlds, (n,) int32; -1 without a hit."""
    fraction: np.ndarray
    """Fraction of the translation up to the hit, (n,) [1]: 0 for an overlap from the start, 1 without a hit."""
    point: np.ndarray
    """Points of the hits, (n, 2) [m]; for an overlap from the start the origin, without a hit the end of the path."""
    normal: np.ndarray
    """Outward unit normals of the hit shapes, (n, 2); zero without a hit, or for an overlap from the start."""


@dataclass(frozen=True)
class Closest:
    """The closest shapes, one element for each point."""

    shape: np.ndarray
    """Shapes, numbered over all worlds, (n,) int32; -1 if none is near enough."""
    distance: np.ndarray
    """Signed distances of the surfaces, negative for a point inside, (n,) [m]; ``max_distance`` if there is none."""
    point: np.ndarray
    """Closest points of the surfaces, (n, 2) [m]; the point itself if there is none."""
    normal: np.ndarray
    """Unit normals of the surfaces there, (n, 2); zero if there is none."""


class Queries(InPlace):
    """Casts rays and moving shapes, and finds overlaps and closest points, among the shapes of all worlds.

        queries = dc.Queries(sim)
        hits = queries.cast_rays([(0.0, 5.0), (1.0, 5.0)], (0.0, -10.0))
        sim.run(10, 0.01)
        queries.update()  # reads the present positions of the bodies

    Each world has a tree of boxes (see ``_warp/queries/queries.py``); the results are those of testing all shapes, up
    to rounding, and among equally near shapes the one with the lowest index.
    Segments of chains are hit from both sides. Do not call it while another thread steps the simulation.
    """

    def __init__(
        self,
        shapes: Any,
        position: Any = None,
        angle: Any = None,
        *,
        threads: int = 1,
        backend: str | None = None,
    ) -> None:
        """Make the tree.

        Args:
            shapes: a ``Simulation`` on the CPU; or a model, or arrays by name (see ``collide.shapes.Shapes``).
            position: centres of mass of the bodies, (bodies, 2), kept and read by ``update`` [m]; None: those of
                the simulation.
            angle: orientations of the bodies, (bodies,), kept and read by ``update`` [rad]; None: as ``position``.
            threads: number of threads that share worlds and queries; the results do not depend on it.
            backend: "warp", or "numpy" for the oracle, which tests each shape; None: that of the model.

        Raises:
            ValueError, TypeError: an argument is invalid; the error names argument, index and limit.
        """
        self._sim = shapes if hasattr(shapes, "state") else None
        self.shapes = Shapes(getattr(shapes, "model", shapes), backend)
        if self._sim is not None:
            if position is not None or angle is not None:
                raise ValueError("position and angle are those of the simulation; leave them out")
        elif position is None or angle is None:
            name = "position" if position is None else "angle"
            raise ValueError(f"{name} is missing; give that of the bodies, or a Simulation")
        self._given, self._position, self._angle = shapes, position, angle
        self.backend, self.dtype = self.shapes.backend, self.shapes.dtype
        kernel_file(self.backend, "queries.queries")  # says which backends have them
        self.threads = host_threads(self.backend, check_count("threads", threads))
        self._allocate()
        self.update()

    def _allocate(self) -> None:
        """Allocate the tree for the present number of shapes."""
        model = self._given
        if self._sim is not None:
            model, state = self._sim.model, self._sim.state
            self._position, self._angle = state.position, state.angle
            self._version = model.version
            self.shapes = Shapes(model, self.backend)
        self._boxes = ShapeBoxes(model, self._position, self._angle, threads=self.threads, backend=self.backend)
        arrays = self.shapes.arrays
        nodes = node_starts(np.diff(arrays["shape_start"]))
        shapes_count, bodies = len(arrays["shape_type"]), self.shapes.bodies
        sizes = {
            "world+1": len(nodes),
            "number": int(nodes[-1]) * 4 * LANES,
            "child": int(nodes[-1]) * LANES,
            "body": bodies,
        }
        self._tree = _allocate(TREE, sizes, self.dtype)
        self._tree["node_start"][:] = nodes
        self._scratch = np.zeros(2 * shapes_count, np.int64)
        self._model = {name: arrays.get(name, np.full(shapes_count, 2**32 - 1, np.uint32)) for name in READ}

    @property
    def lengths(self) -> Mapping[str, int]:
        """Return the numbers of its elements, by noun."""
        return {"shape": len(self._model["shape_type"]), "world": self.shapes.worlds}

    def update(self) -> None:
        """Read the present positions of the bodies, which queries use until the next update."""
        refuse_recording("Queries.update", "it works on the host, too")
        if self._sim is not None and self._sim.model.version != self._version:
            self._allocate()
        self._tree["place"][:] = to_numpy(self._position)
        angle = to_numpy(self._angle)
        np.stack([np.cos(angle), np.sin(angle)], axis=1, out=self._tree["rotation"])
        self._boxes()
        boxes = {name: to_numpy(getattr(self._boxes, name)) for name in ("lower", "upper")}
        if self._sim is not None and self._sim.given_ids is not None:  # empty slots are met by no query
            empty = self._sim.given_ids.numpy("shape_id") < 0
            boxes["lower"][empty] = self._tree["place"][self._model["shape_body"][empty]] = np.nan
        self._launch("build_tree", self.shapes.worlds, boxes=boxes, scratch=self._scratch, tree=self._tree)

    def cast_rays(
        self, origin: Any, translation: Any, *, world: Any = None, mask: Any = None, skip_body: Any = None
    ) -> Hits:
        """Return the first hits of rays from an origin along a translation.

        Args:
            origin: origin of each ray, (n, 2) [m].
            translation: vector from the origin to the end of each ray, (n, 2), or one for all, (2,) [m].
            world: world of each ray, (n,), or one for all; None: the only world.
            mask: a shape is hit only if its category has a bit in common with this, (n,), or one for all; None: all.
            skip_body: body, numbered over all worlds, whose shapes are ignored, (n,), or one for all; -1: none.

        Raises:
            ValueError, TypeError: an argument is invalid; the error names argument, index and limit.
        """
        return self._cast(POINT, 0.0, translation, self._asked("origin", origin, world, mask, skip_body))

    def cast_shape(
        self,
        position: Any,
        translation: Any,
        *,
        angle: Any = None,
        vertices: Any = None,
        radius: float = 0.0,
        world: Any = None,
        mask: Any = None,
        skip_body: Any = None,
    ) -> Hits:
        """Return the first hits of a convex shape that moves along a translation without rotating.

        Args:
            position: start positions, (n, 2) [m].
            translation: displacements, (n, 2), or one for all, (2,) [m].
            angle: orientation of the shape, (n,), or one for all; None: 0 [rad].
            vertices: vertices of the shape, relative to its position, (1 to 8, 2): a convex polygon, or the two ends
                of a capsule; None: the centre of a disc [m].
            radius: radius of the rounding, or of the disc [m].
            world, mask, skip_body: as for ``cast_rays``.

        Raises:
            ValueError, TypeError: an argument is invalid; the error names argument, index and limit.
        """
        corners, radius = _probe(vertices, radius)
        query = self._asked("position", position, world, mask, skip_body, angle)
        return self._cast(corners, radius, translation, query)

    def overlap_points(self, points: Any, *, world: Any = None, mask: Any = None, skip_body: Any = None) -> Neighbors:
        """Return the shapes that contain points: ``index[start[i]:start[i + 1]]`` for point i, ascending.

        Args:
            points: (n, 2) [m].
            world, mask, skip_body: as for ``cast_rays``.

        Raises:
            ValueError, TypeError: an argument is invalid; the error names argument, index and limit.
            OverflowError: there are more than 2^31 - 1 results.
        """
        return self._overlaps(POINT, 0.0, self._asked("points", points, world, mask, skip_body))

    def overlap_boxes(
        self, lower: Any, upper: Any, *, world: Any = None, mask: Any = None, skip_body: Any = None
    ) -> Neighbors:
        """Return the shapes that overlap or touch axis-aligned boxes, as ``overlap_points`` does.

        Args:
            lower, upper: corners, (n, 2) [m].
            world, mask, skip_body: as for ``cast_rays``.

        Raises:
            ValueError, TypeError: an argument is invalid; the error names argument, index and limit.
            OverflowError: there are more than 2^31 - 1 results.
        """
        query = self._asked("lower", lower, world, mask, skip_body)
        low = query["place"]
        high = self._within("upper", check_values("upper", upper, low.shape, self.dtype))
        bad = np.argwhere(high < low)
        if len(bad):
            i, k = (int(n) for n in bad[0])
            raise ValueError(f"upper[{i}, {k}] is {high[i, k]}; it must be >= lower[{i}, {k}] = {low[i, k]}")
        half = high / 2 - low / 2
        return self._overlaps(BOX, 0.0, {**query, "place": low + half, "scale": half})

    def overlap_shape(
        self,
        position: Any,
        *,
        angle: Any = None,
        vertices: Any = None,
        radius: float = 0.0,
        world: Any = None,
        mask: Any = None,
        skip_body: Any = None,
    ) -> Neighbors:
        """Return the shapes that a convex shape overlaps or touches at each position, as ``overlap_points`` does.

        Args:
            position, angle, vertices, radius, world, mask, skip_body: as for ``cast_shape``.

        Raises:
            ValueError, TypeError: an argument is invalid; the error names argument, index and limit.
            OverflowError: there are more than 2^31 - 1 results.
        """
        corners, radius = _probe(vertices, radius)
        query = self._asked("position", position, world, mask, skip_body, angle)
        return self._overlaps(corners, radius, query)

    def closest_points(
        self,
        points: Any,
        *,
        max_distance: Any = None,
        world: Any = None,
        mask: Any = None,
        skip_body: Any = None,
    ) -> Closest:
        """Return the closest shape of each point, by the signed distance of its surface.

        Args:
            points: (n, 2) [m].
            max_distance: largest distance of a result, (n,), or one for all; None: unlimited [m].
            world, mask, skip_body: as for ``cast_rays``.

        Raises:
            ValueError, TypeError: an argument is invalid; the error names argument, index and limit.
        """
        query = self._asked("points", points, world, mask, skip_body)
        largest = float(np.sqrt(np.finfo(self.dtype).max)) / 4
        most = self._each("max_distance", largest if max_distance is None else max_distance, len(query["place"]))
        bad = np.flatnonzero((most < 0) | (most > largest))
        if len(bad):
            i = int(bad[0])
            raise ValueError(f"max_distance[{i}] is {most[i]}; it must lie in [0, {largest:g}]")
        hit = self._answer("find_closest", POINT, 0.0, {**query, "most": most})
        return Closest(hit["shape"], hit["fraction"], hit["point"], hit["normal"])

    def _asked(
        self, name: str, place: Any, world: Any, mask: Any, skip_body: Any, angle: Any = None
    ) -> dict[str, np.ndarray]:
        """What all queries have: where, which world, what counts; and how what is asked with is turned."""
        refuse_recording("a query", "its answers are arrays of their own")
        place = numeric(name, place, "numbers of shape (n, 2)", inner=(2,))
        if place.ndim != 2 or place.shape[1] != 2:
            raise ValueError(f"{name} has shape {place.shape}; it must be (n, 2)")
        place = self._within(name, check_values(name, place, place.shape, self.dtype))
        n, query = len(place), {"place": place}
        if world is not None:
            query["world"] = check_index("world", self._each("world", world, n, np.int32), self.shapes.worlds)
        elif self.shapes.worlds != 1:
            raise ValueError(f"world is missing; there are {self.shapes.worlds}")
        if mask is not None:
            query["mask"] = self._each("mask", mask, n, np.uint32)
        if skip_body is not None:
            query["skip"] = self._each("skip_body", skip_body, n, np.int32)
            check_index("skip_body", np.where(query["skip"] == -1, 0, query["skip"]), max(self.shapes.bodies, 1))
        if angle is not None:
            angles = self._each("angle", angle, n)
            query["rotation"] = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        return query

    def _within(self, name: str, vectors: np.ndarray) -> np.ndarray:
        """Vectors, (n, 2), whose squares the dtype holds."""
        most = float(np.sqrt(np.finfo(self.dtype).max)) / 16
        bad = np.argwhere(np.abs(vectors) > most)
        if len(bad):
            i, k = (int(n) for n in bad[0])
            raise ValueError(f"{name}[{i}, {k}] is {vectors[i, k]}; it must be within {most:g} of zero [m]")
        return vectors

    def _each(self, name: str, values: Any, n: int, dtype: Any = None, inner: tuple[int, ...] = ()) -> np.ndarray:
        """A value for each query, of one for each or of one for all."""
        dtype = self.dtype if dtype is None else np.dtype(dtype)
        given = numeric(name, values, f"numbers of shape {(n, *inner)} or {inner}", "buif", inner)
        if given.shape == inner:
            return np.ascontiguousarray(np.broadcast_to(check_values(name, given, inner, dtype), (n, *inner)))
        return check_values(name, given, (n, *inner), dtype)

    def _cast(self, corners: np.ndarray, radius: float, translation: Any, query: dict[str, np.ndarray]) -> Hits:
        translations = self._each("translation", translation, len(query["place"]), inner=(2,))
        query["translation"] = self._within("translation", translations)
        return Hits(**self._answer("cast_shapes", corners, radius, query))

    def _answer(self, name: str, corners: np.ndarray, radius: float, query: dict[str, np.ndarray]) -> dict[str, Any]:
        """Arrays of hits."""
        hit = _allocate(HIT, {"query": len(query["place"])}, self.dtype)
        self._ask(name, corners, radius, query, hit=hit)
        return hit

    def _overlaps(self, corners: np.ndarray, radius: float, query: dict[str, np.ndarray]) -> Neighbors:
        """Lists of shapes: counted first, then stored."""
        n = len(query["place"])
        count, start = np.zeros(n, np.int64), np.zeros(n + 1, np.int64)
        index = np.zeros(0, np.int32)
        self._ask("find_overlaps", corners, radius, query, list_start=start, list_count=count, index=index)
        np.cumsum(count, out=start[1:])
        if start[-1] > MAX_FOUND:
            raise OverflowError(f"{start[-1]} shapes overlap in all; there must be at most {MAX_FOUND}")
        index = np.empty(int(start[-1]), np.int32)
        if len(index):
            self._ask("find_overlaps", corners, radius, query, list_start=start, list_count=count, index=index)
        shapes = max(len(self._model["shape_type"]), 1)
        order = np.repeat(np.arange(n, dtype=np.int64) * shapes, count) + index
        order.sort()  # in the tree's order until here
        return Neighbors(start, (order % shapes).astype(np.int32))

    def _ask(self, name: str, corners: np.ndarray, radius: float, query: dict[str, np.ndarray], **values: Any) -> None:
        """Launch a kernel of queries, some at a time."""
        n = len(query["place"])
        for first in range(0, n, SLICE):
            part = slice(first, first + SLICE)
            given = {key: array[part] for key, array in query.items()}
            count = len(given["place"])
            out = {
                key: {field: array[part] for field, array in value.items()}
                if key == "hit"
                else value[part]
                if key in ("list_start", "list_count")
                else value
                for key, value in values.items()
            }
            probe = {"corner": corners.astype(self.dtype), "radius": radius}
            chunks = -(-count // CHUNK)
            self._launch(name, chunks, queries=count, tree=self._tree, probe=probe, query=given, **out)

    def _launch(self, name: str, count: int, **values: Any) -> None:
        """Launch a kernel with so many threads."""
        if not count:
            return
        dtype, values = self.dtype, {"model": self._model, **values}
        tables = {"model": MODEL, "tree": TREE, "probe": PROBE, "query": QUERY, "hit": HIT}
        if on_numpy(self.backend):
            kernel = make_kernels(self.backend, "queries.queries", dtype.name)[name]
            groups = {
                key: whole_group(key, dtype, tables[key], value, self.backend)
                for key, value in values.items()
                if key in tables
            }
            boxes = {"boxes": None} if "boxes" in values else {}
            bind(kernel, count, {**values, **groups, **boxes, "world_offset": 0}, "cpu")()
            return
        empty = _nothing(dtype)
        query = {"query": {**empty, **values["query"]}} if "query" in values else {}
        _calls(self.backend, dtype.name, name)({**values, **query}, count, self.threads)


def node_starts(shapes: np.ndarray) -> np.ndarray:
    """First node of each world's tree, and the number of nodes, (W + 1,), for so many shapes in each.

    Args:
        shapes: of each world, (W,).
    """
    left, nodes = shapes.astype(np.int64), np.zeros(len(shapes), np.int64)
    while True:
        left = -(-left // LANES)
        nodes += left
        if (left <= 1).all():
            break
        left[left <= 1] = 0
    return np.concatenate([[0], np.cumsum(nodes)]).astype(np.int32)


def _probe(vertices: Any, radius: Any) -> tuple[np.ndarray, float]:
    """Corners, counter-clockwise, and radius of a shape that is asked with."""
    radius = check_not_negative("radius", radius)
    if vertices is None:
        return POINT, radius
    corners = points(vertices, "vertices", 1, MAX_VERTICES)
    if len(corners) > 2:
        return convex_polygon(corners), radius
    if np.ptp(corners, axis=0).max() <= SHORT * max(radius, np.abs(corners).max()):
        corners = corners.mean(axis=0, keepdims=True)  # a capsule so short is a disc
    return corners, radius


def _allocate(table: Mapping[str, Any], sizes: Mapping[str, int], dtype: np.dtype) -> dict[str, np.ndarray]:
    """Arrays of zeros of the fields of a table that have these axes."""
    found = {}
    for name, field in table.items():
        scalar, inner = numpy_spec(field, dtype)
        found[name] = np.zeros((*(sizes[axis] for axis in field.axes), *inner), scalar)
    return found


@functools.cache
def _nothing(dtype: np.dtype) -> dict[str, np.ndarray]:
    """Fields of queries that say nothing."""
    return _allocate(QUERY, {"query": 0}, dtype)


@functools.cache
def _calls(backend: str, dtype: str, name: str) -> Any:
    from dc_kernels.runtime.launches import Calls

    return Calls(make_kernels(backend, "queries.queries", dtype)[name])
