"""The rows of a caller's own Jacobians: J = [J_A, J_B], of any numbers, with bounds of its impulse and softness.

Each makes J_A V_A + J_B V_B + bias + softness impulse = 0 for the velocities V = (x, y, spin), or stays at a bound.
"""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.groups import group_types
from dc_kernels._warp.native import native_code
from dc_kernels._warp.solve.lanes import row_macros
from dc_kernels.model.enums import JointKind
from dc_kernels.solve.joints import PAIRED
from dc_kernels.solve.rows import COLORS


@cache
def jacobian_rows(dtype: str, variant: str) -> Any:
    """The function that makes the rows of a world's own Jacobians and puts them into the lanes of their colours.

    It is native code: written by Warp, a row would take twice as long.
    """
    t = group_types(dtype)

    @wp.func_native(
        native_code("pack/jacobian.h", "pack/jacobians.h", dtype=dtype, COLORS=COLORS, **row_macros(variant))
    )
    def make_jacobian_rows(
        w: wp.int32, jacobi: wp.int32, scale: t.real, model: t.Model, motion: t.Motion, rows: t.Rows
    ) -> t.real: ...

    return make_jacobian_rows


@cache
def moved_rows(dtype: str, variant: str) -> Any:
    """The function that puts rows of a world's joints into their lanes anew, in the midst of a solve by substeps."""
    t = group_types(dtype)
    kinds = {kind.name: int(kind) for kind in map(JointKind, PAIRED)}

    @wp.func_native(native_code("pack/jacobian.h", "solve/renew.h", dtype=dtype, **kinds, **row_macros(variant)))
    def move_rows(w: wp.int32, renew: wp.int32, model: t.Model, joints: t.Joints, motion: t.Motion, rows: t.Rows): ...

    return move_rows
