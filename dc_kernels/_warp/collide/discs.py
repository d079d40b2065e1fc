"""Contacts of pairs of discs, LANES of them side by side on a CPU: a scene of discs has hardly any others."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.collide.closing import FAST
from dc_kernels._warp.collide.manifold import EPSILON
from dc_kernels._warp.groups import group_types
from dc_kernels._warp.native import native_code
from dc_kernels.model.enums import ShapeType
from dc_kernels.model.fields import KEY_FEATURE_BITS, KEY_SHAPE_BITS
from dc_kernels.solve.rows import LANES


@cache
def disc_contacts(dtype: str) -> Any:
    """The function that adds the contacts of a run of pairs of centred discs, with the bits of ``disc_disc_moving``.

    It returns the first pair that is of other shapes, and the contacts found by then.
    """
    t = group_types(dtype)
    macros = {
        "LANES": LANES,
        "DISC": int(ShapeType.DISC),
        "SHIFT_A": KEY_SHAPE_BITS + KEY_FEATURE_BITS,
        "SHIFT_B": KEY_FEATURE_BITS,
        "FAST": FAST,
        "EPSILON": EPSILON[dtype],
    }
    headers = ("prelude.h", "predicted.h", "solve/bodies.h", "side.h", "collide/discs.h")

    @wp.func_native(native_code(*headers, dtype=dtype, **macros))
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

    return find_disc_contacts
