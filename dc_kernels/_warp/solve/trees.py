"""The direct solve of joints whose bodies form trees, beside the sweeps: exact whatever the masses, in linear time.

Sweeps alone converge badly where a light chain carries a heavy load. Contacts, limits, motors, rods, and joints that
close a loop, stay with the sweeps: each sweep is followed by a solve of all trees for the velocities that it has left,
which together is a Gauss-Seidel iteration over blocks.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from dc_kernels._warp.groups import group_types
from dc_kernels._warp.native import native_code
from dc_kernels._warp.solve.lanes import row_macros
from dc_kernels.solve.joints import TREE_JOINT, TREE_MOVES


@cache
def tree_functions(dtype: str, variant: str) -> SimpleNamespace:
    """``factor`` and ``solve`` a tree; how many of its rows ``lack`` more than ``still`` of their speed.

    ``bodies`` are velocities, or with ``places`` 1 displacements, of which a ``share`` of what is off, up to ``limit``,
    is removed.
    """
    t = group_types(dtype)
    macros = {**row_macros(variant), "JOINT": TREE_JOINT, "MOVES": TREE_MOVES}

    @wp.func_native(native_code("solve/tree.h", "solve/tree_factor.h", dtype=dtype, **macros))
    def factor(tree: wp.int32, places: wp.int32, bodies: wp.array(dtype=t.vec4), rows: t.Rows): ...

    @wp.func_native(native_code("solve/tree.h", "solve/tree_solve.h", dtype=dtype, **macros))
    def solve(
        tree: wp.int32,
        places: wp.int32,
        share: t.real,
        limit: t.real,
        bodies: wp.array(dtype=t.vec4),
        rows: t.Rows,
    ): ...

    @wp.func_native(native_code("solve/tree_lack.h", dtype=dtype, **row_macros(variant)))
    def lack(tree: wp.int32, still: t.real, enough: wp.int32, rows: t.Rows) -> wp.int32: ...

    return SimpleNamespace(factor=factor, solve=solve, lack=lack)
