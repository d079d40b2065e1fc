"""The rows of contacts: J = [-n, -r_A x n, n, r_B x n] along the normal of each and, with t for n, its tangent.

These are equations 2.21 and 2.22 of Wu (2018), and the effective mass, 1 / (J M^-1 J^T), is 2.24 and 2.25.
"""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.groups import group_types
from dc_kernels._warp.solve.constraints.rolling import KEY_BITS
from dc_kernels._warp.solve.lanes import row_macros
from dc_kernels._warp.solve.ranges import ranges_code
from dc_kernels.model.config import POSITION_CORRECTIONS
from dc_kernels.solve.rows import COLORS, SURFACED

OPEN = 1e6  # a row that lets this many times the gap close within the step never acts


@cache
def contact_rows(dtype: str, variant: str) -> Any:
    """The function that makes the rows of a world's contacts, in native code.

    Bias velocity: a gap may close within the step (gap / dt), but one below the slop counts as closed: the
    round-off of resting gaps would change the problem in each step and cost the warm start a tenth of its gain.
    A contact that hits within the step faster than the threshold, which is 0 where e is 1, leaves with -e times the
    speed that it had before the step's forces: bounces then mirror semi-implicit Euler, and an elastic ball returns
    to its height to round-off for ever. A gap of a bouncing pair that stays open is left alone: what another impact
    pushes across it bounces in the next step. A closed separating contact of such a pair may be left approaching
    with e times its speed at most (Moreau 1988), without which several impacts at once can gain energy.
    """
    t = group_types(dtype)
    macros = {
        **row_macros(variant),
        "COLORS": COLORS,
        "BAUMGARTE": POSITION_CORRECTIONS["baumgarte"],
        "OPEN": OPEN,
        **KEY_BITS,
    }
    surface = ["pack/surface.h"] if variant in SURFACED else []
    headers = ("predicted.h", "solve/bodies.h", "side.h", *surface, "pack/contacts.h")

    @wp.func_native(ranges_code(dtype, *headers, **macros))
    def make_contact_rows(
        w: wp.int32,
        padding_body: wp.int32,
        config: t.Config,
        model: t.Model,
        state: t.State,
        motion: t.Motion,
        contacts: t.Contacts,
        rows: t.Rows,
        team: wp.uint64,
    ) -> t.real: ...

    return make_contact_rows
