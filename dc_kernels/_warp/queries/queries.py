"""A tree of boxes of shapes, and queries that go through it, in native code for the CPU.

A node has LANES children, whose boxes are tested at once (Wald, Benthin and Boulos 2008), and its place follows from
its number: shapes are sorted along a Morton curve and taken LANES by LANES, so a tree holds no pointers and is made
anew for less than it costs to mend one. A shape that is cast, or that overlaps, is a point against the Minkowski sum
of the other shape and its own turned around: both are polygons of at most MAX_VERTICES corners with a radius, and so is
the sum, whose answers have closed forms.
"""

from functools import cache
from typing import Any

import numpy as np
import warp as wp

from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.groups import group_types, struct_type
from dc_kernels._warp.native import native_code
from dc_kernels.collide.fields import BOXES
from dc_kernels.model.enums import ShapeType
from dc_kernels.model.shapes import MAX_VERTICES
from dc_kernels.queries.fields import CHUNK, HIT, LANES, PROBE, QUERY, TREE

N_CHUNK = wp.constant(CHUNK)


def code(dtype: str, *names: str) -> str:
    """The native code of headers in ``native/queries`` for a scalar type."""
    limits = np.finfo(dtype)
    macros = {
        "LANES": LANES,
        "SEGMENT": int(ShapeType.SEGMENT),
        "MAX_CORNERS": 2 * MAX_VERTICES + 2,
        "MAX_LEVELS": 12,
        "ROUNDING": f"(REAL){8 * float(limits.eps)}",
        "FLAT": f"(REAL){1e3 * float(limits.eps)}",
        "MOST": f"(REAL){float(limits.max)}",
    }
    return native_code("prelude.h", *(f"queries/{name}.h" for name in ("prelude", *names)), dtype=dtype, **macros)


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """``build_tree``, one thread a world; ``cast_shapes``, ``find_overlaps``, ``find_closest``, one CHUNK queries."""
    t = group_types(dtype)
    module = kernel_module("queries", dtype)
    Tree, Probe, Query, Hit = (
        struct_type(name, dtype, table)
        for name, table in (("tree", TREE), ("probe", PROBE), ("query", QUERY), ("hit", HIT))
    )
    Boxes = struct_type("boxes", dtype, BOXES)
    longs, integers = wp.array(dtype=wp.int64), wp.array(dtype=wp.int32)

    @wp.func_native(code(dtype, "build"))
    def build(
        world_offset: wp.int32,
        worlds: wp.int32,
        model: t.Model,
        boxes: Boxes,
        scratch: longs,
        tree: Tree,
    ): ...

    @wp.kernel(module=module, enable_backward=False)
    def build_tree(
        world_offset: int,
        model: t.Model,
        boxes: Boxes,
        # Scratch: two numbers a shape.
        scratch: longs,
        # Out:
        tree: Tree,
    ):
        """Sort the shapes of worlds by place and put boxes around LANES at a time, level by level."""
        build(wp.tid() + world_offset, 1, model, boxes, scratch, tree)

    @wp.func_native(code(dtype, "asked", "cast"))
    def cast(
        query_offset: wp.int32,
        queries: wp.int32,
        model: t.Model,
        tree: Tree,
        probe: Probe,
        query: Query,
        hit: Hit,
    ): ...

    @wp.kernel(module=module, enable_backward=False)
    def cast_shapes(
        world_offset: int,
        queries: int,
        model: t.Model,
        tree: Tree,
        probe: Probe,
        query: Query,
        # Out:
        hit: Hit,
    ):
        """Find what the probe of each query meets first along its translation; of equals the shape of least index."""
        first = (wp.tid() + world_offset) * N_CHUNK
        cast(first, wp.min(N_CHUNK, queries - first), model, tree, probe, query, hit)

    @wp.func_native(code(dtype, "asked", "overlap"))
    def overlap(
        query_offset: wp.int32,
        queries: wp.int32,
        model: t.Model,
        tree: Tree,
        probe: Probe,
        query: Query,
        list_start: longs,
        list_count: longs,
        index: integers,
    ): ...

    @wp.kernel(module=module, enable_backward=False)
    def find_overlaps(
        world_offset: int,
        queries: int,
        model: t.Model,
        tree: Tree,
        probe: Probe,
        query: Query,
        list_start: longs,
        # Out:
        list_count: longs,
        index: integers,
    ):
        """Count the shapes that the probe of each query overlaps or touches, and store them where there is room."""
        first = (wp.tid() + world_offset) * N_CHUNK
        overlap(first, wp.min(N_CHUNK, queries - first), model, tree, probe, query, list_start, list_count, index)

    @wp.func_native(code(dtype, "asked", "closest"))
    def closest(
        query_offset: wp.int32,
        queries: wp.int32,
        model: t.Model,
        tree: Tree,
        probe: Probe,
        query: Query,
        hit: Hit,
    ): ...

    @wp.kernel(module=module, enable_backward=False)
    def find_closest(
        world_offset: int,
        queries: int,
        model: t.Model,
        tree: Tree,
        probe: Probe,
        query: Query,
        # Out:
        hit: Hit,
    ):
        """Find the shape of least signed distance from each point, none beyond ``query.most``."""
        first = (wp.tid() + world_offset) * N_CHUNK
        closest(first, wp.min(N_CHUNK, queries - first), model, tree, probe, query, hit)

    return {
        "build_tree": build_tree,
        "cast_shapes": cast_shapes,
        "find_overlaps": find_overlaps,
        "find_closest": find_closest,
    }
