"""Contacts of pairs of discs, LANES of them side by side on a CPU: a scene of discs has hardly any others.

Tried and left: lanes for discs that rest on the ground, as ``recycle/meet_discs.h`` has them, take as long as one by
one, some 70 ns a pair; in the loop of the pairs of discs they make that a tenth slower.
"""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.collide.closing import FAST
from dc_kernels._warp.collide.manifold import EPSILON
from dc_kernels._warp.groups import group_types
from dc_kernels._warp.native import native_code
from dc_kernels._warp.solve.ranges import ranges_code
from dc_kernels.model.enums import ShapeType
from dc_kernels.model.fields import KEY_FEATURE_BITS, KEY_SHAPE_BITS
from dc_kernels.solve.rows import LANES


@cache
def disc_contacts(dtype: str) -> tuple[Any, Any]:
    """What adds the contacts of a run of pairs of centred discs, with the bits of ``disc_disc_moving``.

    Two functions, of one thread and of a team's threads: each returns the first pair that is of other shapes, and the
    contacts found by then.
    """
    t = group_types(dtype)
    macros = {
        "DISC": int(ShapeType.DISC),
        "SHIFT_A": KEY_SHAPE_BITS + KEY_FEATURE_BITS,
        "SHIFT_B": KEY_FEATURE_BITS,
        "FAST": FAST,
        "EPSILON": EPSILON[dtype],
    }
    headers = ("predicted.h", "solve/bodies.h", "side.h", "collide/discs.h")

    alone = {**macros, "SHARED": False, "HOLDS": "&", "LANES": LANES}

    @wp.func_native(native_code("prelude.h", *headers, dtype=dtype, **alone))
    def find_disc_contacts(
        w: wp.int32,
        i0: wp.int32,
        i1: wp.int32,
        found: wp.int32,
        config: t.Config,
        model: t.Model,
        state: t.State,
        motion: t.Motion,
        pairs: t.Pairs,
        contacts: t.Contacts,
    ) -> wp.vec2i: ...

    @wp.func_native(ranges_code(dtype, *headers, **macros, SHARED=True, HOLDS="="))
    def share_disc_contacts(
        w: wp.int32,
        ends: wp.vec2i,
        found: wp.int32,
        config: t.Config,
        model: t.Model,
        state: t.State,
        motion: t.Motion,
        pairs: t.Pairs,
        contacts: t.Contacts,
        team: wp.uint64,
    ) -> wp.vec2i: ...

    return find_disc_contacts, share_disc_contacts
