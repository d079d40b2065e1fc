"""Pairs of boxes that overlap, by a sorted cell list, and the boxes of shapes: native code that the kernels share.

A box lies in the cell of its centre, on the level whose cells are just larger than it (cells double from level to
level), so that sizes may differ by any ratio. Boxes look at the cells around them on each level that has some. Only
the pairs of shapes that have left their box are found anew: their boxes are sorted into cells, all boxes look for them
there, and what is found is merged into the pairs that stay.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from dc_kernels._warp.groups import group_types
from dc_kernels._warp.native import native_code
from dc_kernels._warp.solve.ranges import RANGES
from dc_kernels.model.enums import BodyType, Flag, ShapeType

DISC, SEGMENT = int(ShapeType.DISC), int(ShapeType.SEGMENT)
DYNAMIC, STATIC = int(BodyType.DYNAMIC), int(BodyType.STATIC)
PAIR_OVERFLOW = wp.constant(int(Flag.PAIR_OVERFLOW))
MAX_LEVEL = 62
LARGE_LEVEL = 3  # shapes on this level and above, if they are few, are tested one by one:
MAX_LARGE = 16  # a pile's three walls cost a rebuild a quarter of its time as cells
LANES = 8  # boxes tested at once
FILTER_BITS = 2**14  # cells that a mend looks at first
FEW = 32  # pairs that are sorted by insertion
ROUNDINGS = 16  # units in the last place of a coordinate that a box's centre may be off by in the cells, and more


def code(dtype: str, *names: str, **macros: object) -> str:
    """The native code of headers in ``native/collide`` for boxes."""
    files = (f"collide/{name}.h" for name in names)
    return native_code("collide/quad.h", *files, dtype=dtype, DISC=DISC, SEGMENT=SEGMENT, **macros)


def shared_code(dtype: str, *names: str) -> str:
    """The native code of headers in ``native/collide`` for boxes, where threads share the loops of a world."""
    loops = ("collide/quad.h", "runtime/team.h", "runtime/ranges.h")
    files = (f"collide/{name}.h" for name in names)
    return native_code(*loops, *files, dtype=dtype, DISC=DISC, SEGMENT=SEGMENT, **RANGES)


@cache
def pair_functions(dtype: str) -> SimpleNamespace:
    """``renew_pairs``, which finds the pairs of boxes that have changed, whatever they are the boxes of."""
    t = group_types(dtype)
    integers = wp.array(dtype=wp.int32)
    rounding = ROUNDINGS * {"float32": 2.0**-24, "float64": 2.0**-53}[dtype]
    levels = {"MAX_LEVEL": MAX_LEVEL, "LARGE_LEVEL": LARGE_LEVEL, "MAX_LARGE": MAX_LARGE, "ROUNDING": rounding}
    levels |= {"LANES": LANES, "FILTER_BITS": FILTER_BITS}

    @wp.func_native(code(dtype, "find_pairs", DYNAMIC=DYNAMIC, STATIC=STATIC, **levels))
    def find_pairs(w: wp.int32, left: wp.int32, model: t.Model, pairs: t.Pairs) -> wp.int32: ...

    @wp.func_native(native_code("collide/sort_pairs.h", dtype=dtype, FEW=FEW))
    def sort_pairs(
        w: wp.int32,
        found: wp.int32,
        before: wp.int32,
        model: t.Model,
        pairs: t.Pairs,
        near_a: integers,
        near_b: integers,
        more_a: integers,
        more_b: integers,
    ) -> wp.int32: ...

    @wp.func
    def renew_pairs(
        w: int,
        left: int,
        model: t.Model,
        state: t.State,
        pairs: t.Pairs,
        near_a: integers,
        near_b: integers,
        near_count: integers,
        more_a: integers,
        more_b: integers,
    ):
        """Find the pairs of the ``left`` shapes in ``pairs.left`` anew; where these are all, all of a world's pairs.

        The others in ``near_a`` and ``near_b`` stay; ``more_a`` and ``more_b`` are scratch of that size.
        """
        pairs.rebuilds[w] = pairs.rebuilds[w] + 1
        before = int(0)
        if left < model.shape_start[w + 1] - model.shape_start[w]:
            before = near_count[w]
        found = find_pairs(w, left, model, pairs)
        n = sort_pairs(w, found, before, model, pairs, near_a, near_b, more_a, more_b)
        pairs.needed[w] = n
        pairs.valid[w] = 1
        if n > pairs.start[w + 1] - pairs.start[w]:
            state.flags[w] = state.flags[w] | PAIR_OVERFLOW
            pairs.valid[w] = 0
            n = int(0)
        near_count[w] = n

    return SimpleNamespace(renew_pairs=renew_pairs)
