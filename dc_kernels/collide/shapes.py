"""Shapes for the stages, from a model or from given arrays, and their bounding boxes."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Any

import numpy as np

from dc_kernels.collide.fields import BOXES
from dc_kernels.model.arrays import Model, to_numpy
from dc_kernels.model.dtypes import numpy_spec
from dc_kernels.model.enums import BodyType, ShapeType
from dc_kernels.model.fields import LAUNCH, MODEL, STATE
from dc_kernels.model.shapes import MAX_VERTICES, edge_normals
from dc_kernels.model.validate.geometry import check_geometry
from dc_kernels.runtime.backends import bind, check_backend, host_threads, kernel_file, make_kernels
from dc_kernels.runtime.inputs import (
    check_array,
    check_count,
    check_index,
    check_layout,
    check_not_negative,
    check_start,
)
from dc_kernels.runtime.interop import InPlace
from dc_kernels.runtime.threads import run_shards, shard_worlds

NEEDED = ("shape_type", "shape_radius", "vertex_start", "vertices")
COUNTS = {ShapeType.DISC: (1, 1), ShapeType.POLYGON: (2, MAX_VERTICES), ShapeType.SEGMENT: (4, 4)}


class Shapes:
    """The arrays of shapes by the names of ``model.fields.MODEL``, checked; given arrays are used in place.

    Attributes:
        arrays: numpy arrays by name.
        dtype: float32 or float64.
        worlds, bodies: numbers of worlds and bodies.
        backend: backend of the stage, by default that of the model.
    """

    def __init__(self, shapes: Any, backend: str | None) -> None:
        """Check the shapes.

        Args:
            shapes: a model of ``ModelBuilder.finalize``, on the CPU; or arrays by name: shape_type, shape_radius,
                vertex_start and vertices, and optionally other fields. By default each shape is its own dynamic body,
                all are in one world, without friction and restitution.
            backend: name of a backend; None: that of the model, or "warp".

        Raises:
            ValueError: an array is invalid; the error names array, index and limit.
            TypeError: ``shapes`` has another type.
        """
        if isinstance(shapes, Model):
            if shapes.device != "cpu":
                raise ValueError(f"shapes is on {shapes.device}; it must be on the CPU")
            self.arrays = {name: to_numpy(shapes.array(name)) for name in MODEL}
            self.dtype = shapes.dtype
            self.backend = check_backend(shapes.backend if backend is None else backend)
        elif isinstance(shapes, Mapping):
            self.backend = check_backend("warp" if backend is None else backend)
            self.arrays = _checked(shapes)
            self.dtype = self.arrays["vertices"].dtype
        else:
            raise TypeError(f"shapes is a {type(shapes).__name__}; it must be a Model or arrays by name")
        self._kept = shapes
        self.worlds = len(self.arrays["shape_start"]) - 1
        self.bodies = len(self.arrays["body_type"])

    def group(self) -> Any:
        """Return the arrays as a kernel argument."""
        return whole_group("model", self.dtype, MODEL, self.arrays, self.backend)

    def state(self, position: Any, angle: Any, **arrays: np.ndarray) -> Any:
        """Return positions (bodies, 2) [m], angles (bodies,) [rad] and other arrays as a kernel argument.

        Raises:
            ValueError: a value is not finite; the error names array and index.
        """
        position = check_array("position", position, (self.bodies, 2), self.dtype)
        angle = check_array("angle", angle, (self.bodies,), self.dtype)
        rest = {
            "velocity": np.zeros((self.bodies, 2), self.dtype),
            "angular_velocity": np.zeros(self.bodies, self.dtype),
        }
        given = {"position": position, "angle": angle, **rest, **arrays}
        return whole_group("state", self.dtype, STATE, given, self.backend)


class ShapeBoxes(InPlace):
    """Computes bounding boxes of moving shapes for a broadphase: ``dc.Broadphase(boxes.lower, boxes.upper)``.

    Attributes:
        lower, upper: corners, (n,) vectors of the dtype of the shapes [m].
    """

    def __init__(
        self,
        shapes: Any,
        position: Any,
        angle: Any,
        *,
        margin: float = 0.0,
        threads: int = 1,
        backend: str | None = None,
    ) -> None:
        """Check the arguments and allocate all memory.

        Args:
            shapes: a model, or arrays by name (see ``Shapes``).
            position: centres of mass of the bodies, (bodies, 2); kept, and read at each call [m].
            angle: orientations of the bodies, (bodies,); kept, and read at each call [rad].
            margin: enlargement of the boxes on each side, >= 0 [m].
            threads: number of threads that share the worlds.
            backend: "warp", "taichi", or "numpy" for the oracle; None: that of the model.

        Raises:
            ValueError, TypeError: an argument is invalid; the error names argument, index and limit.
        """
        self.shapes = Shapes(shapes, backend)
        self.backend, self.dtype = backend, dtype = self.shapes.backend, self.shapes.dtype
        self._kept = (position, angle)
        self.threads = check_count("threads", threads)
        corners = {name: np.zeros((len(self.shapes.arrays["shape_type"]), 2), dtype) for name in ("lower", "upper")}
        groups = kernel_file(backend, "groups")
        boxes = {**corners, "margin": check_not_negative("margin", margin), "filters": np.zeros(1, np.int64)}
        values = {
            "model": self.shapes.group(),
            "state": self.shapes.state(position, angle),
            "boxes": groups.group("boxes", dtype.name, BOXES, boxes),
            "threads": self.threads,
        }
        self.lower, self.upper = values["boxes"].lower, values["boxes"].upper
        kernel = make_kernels(backend, "collide.broadphase", dtype.name, factory="box_kernels")["bound_shapes"]
        shards = shard_worlds(self.shapes.worlds, host_threads(backend, self.threads))
        launch = [(w, n, {"world_offset": w}) for w, n in shards]
        self._shards = [
            bind(kernel, n, {**values, "launch": groups.group("launch", dtype.name, LAUNCH, first)}, "cpu")
            for w, n, first in launch
        ]

    @property
    def lengths(self) -> Mapping[str, int]:
        """Return the numbers of its elements, by noun."""
        return {"shape": len(self.shapes.arrays["shape_type"]), "world": self.shapes.worlds}

    def __call__(self) -> None:
        """Compute the boxes for the present positions and angles; the broadphase reports boxes that are not finite."""
        run_shards(self._shards, self.threads)


def whole_group(name: str, dtype: np.dtype, table: Mapping[str, Any], values: Mapping[str, Any], backend: str) -> Any:
    """Return a group as a kernel argument, with empty arrays for the fields without a value."""
    empty = {}
    for key, field in table.items():
        scalar, inner = numpy_spec(field, dtype)
        if key not in values and scalar.names is None:
            empty[key] = np.zeros((*(0 for _ in field.axes), *inner), scalar)
    return kernel_file(backend, "groups").group(name, dtype.name, table, {**empty, **values})


def _checked(given: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Return all arrays of MODEL that the stages read, from the given ones."""
    for name in given:
        if name not in MODEL:
            raise ValueError(f"shapes has {name!r}, which is no field of a model (model.fields.MODEL)")
    for name in NEEDED:
        if name not in given:
            raise ValueError(f"shapes has no {name}; it needs {', '.join(NEEDED)}")
    vertices = check_array("vertices", given["vertices"], (None, 2))
    real = vertices.dtype
    integers = np.dtype(np.int32)
    sizes = {"vertex": len(vertices), "shape": len(check_layout("shape_type", given["shape_type"], (None,), integers))}
    if "body_type" in given:
        sizes["body"] = len(check_layout("body_type", given["body_type"], (None,), integers))
    arrays: dict[str, np.ndarray] = {}
    for name, array in given.items():
        field = MODEL[name]
        scalar, inner = numpy_spec(field, real)
        base, _, more = field.per.partition("+")
        count = sizes[base] + int(more or 0) if base in sizes else None
        check = check_array if scalar.kind == "f" else check_layout
        arrays[name] = check(name, array, (count, *inner), scalar)
    n = sizes["shape"]
    _check_vertices(arrays, n)
    for name, low in (("shape_radius", 0.0), ("shape_friction", 0.0), ("shape_restitution", 0.0)):
        if name in arrays:
            check_array(name, arrays[name], (n,), real, low=low)
    arrays.setdefault("shape_body", np.arange(n, dtype=np.int32))
    if "body_type" not in arrays:
        bodies = int(arrays["shape_body"].max(initial=-1)) + 1
        arrays["body_type"] = np.full(bodies, BodyType.DYNAMIC, np.int32)
    bodies = len(arrays["body_type"])
    check_index("shape_body", arrays["shape_body"], bodies)
    check_index("body_type", arrays["body_type"], len(BodyType))
    for name, count in (("shape_start", n), ("body_start", bodies)):
        if name in arrays:
            check_start(name, arrays[name], count, "shapes" if name == "shape_start" else "bodies")
        else:
            arrays[name] = np.array([0, count], np.int32)
    if len(arrays["shape_start"]) != len(arrays["body_start"]):
        worlds = len(arrays["body_start"]) - 1
        raise ValueError(f"shape_start has {len(arrays['shape_start']) - 1} worlds, body_start has {worlds}")
    for name, value in (("shape_friction", 0.0), ("shape_restitution", 0.0)):
        arrays.setdefault(name, np.full(n, value, real))
    _derive(arrays, n)
    check_geometry(arrays, "shapes.")
    return arrays


def _check_vertices(arrays: Mapping[str, np.ndarray], n: int) -> None:
    """Raise ValueError for a kind of shape that there is not, or one with too few or too many vertices."""
    kind, first = arrays["shape_type"], arrays["vertex_start"]
    check_index("shape_type", kind, len(ShapeType))
    if len(first) != n + 1:
        raise ValueError(f"vertex_start has shape {first.shape}; it must be ({n + 1},)")
    check_start("vertex_start", first, len(arrays["vertices"]), "vertices")
    low, high = np.array([COUNTS[ShapeType(k)] for k in range(len(ShapeType))])[kind].T if n else (np.zeros(0),) * 2
    count = np.diff(first)
    bad = np.flatnonzero((count < low) | (count > high))
    if len(bad):
        i = int(bad[0])
        name = ShapeType(int(kind[i])).name
        raise ValueError(f"shape {i}, a {name}, has {count[i]} vertices; it must have {low[i]} to {high[i]}")


def _derive(arrays: dict[str, np.ndarray], n: int) -> None:
    """Normals, centres, extents and length scales that are not given."""
    vertices, first, kind = arrays["vertices"], arrays["vertex_start"], arrays["shape_type"]
    normals, center, extent = np.zeros_like(vertices), np.zeros((n, 2), vertices.dtype), np.zeros(n, vertices.dtype)
    center = arrays.get("shape_center", center)
    for i in range(n):
        last = first[i] + 2 if kind[i] == ShapeType.SEGMENT else first[i + 1]
        core = vertices[first[i] : last].astype(np.float64)
        edges = np.hypot(*(np.roll(core, -1, axis=0) - core).T)
        if kind[i] != ShapeType.DISC:
            if not edges.all():
                raise ValueError(f"vertices[{first[i] + int(edges.argmin())}] of shape {i} repeats the one behind it")
            normals[first[i] : last] = edge_normals(core)
        if "shape_center" not in arrays:
            center[i] = core.mean(axis=0)
        extent[i] = np.hypot(*(core - center[i]).T).max() + arrays["shape_radius"][i]
    derived = {"vertex_normals": normals, "shape_center": center, "shape_extent": extent}
    for name, array in derived.items():
        arrays.setdefault(name, array)
    start = arrays["shape_start"]
    scale = [np.median(2.0 * extent[a:b]) if b > a else 1.0 for a, b in itertools.pairwise(start)]
    arrays.setdefault("length_scale", np.array(scale, vertices.dtype))
