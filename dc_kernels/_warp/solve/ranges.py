"""Sums and combinations over the impulses of a world, in native code.

Sums are taken in LANES parts whose order is fixed, so that they have the same bits on every CPU, and for any number of
threads: a range of more than ``SUMMED`` numbers is cut into pieces, whose sums are added in order.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from dc_kernels._warp.common import scalar_types
from dc_kernels._warp.native import native_code
from dc_kernels.runtime.sequences import SEATS
from dc_kernels.solve.iteration import MOST_SUMS, SUMMED
from dc_kernels.solve.rows import COLORS, LANES

RANGES = {"LANES": LANES, "COLORS": COLORS, "SEATS": SEATS, "SUMMED": SUMMED, "MOST_SUMS": MOST_SUMS}
"""Macros of ``runtime/team.h`` and ``runtime/ranges.h``."""


def ranges_code(dtype: str, *names: str, **macros: object) -> str:
    """The body of a native function of headers that stand behind ``runtime/ranges.h``."""
    headers = ("prelude.h", "runtime/team.h", "runtime/ranges.h", *names)
    return native_code(*headers, dtype=dtype, **{**RANGES, **macros})


@cache
def range_functions(dtype: str) -> SimpleNamespace:
    """What accelerations do to impulses ``x`` and their ``change``; ``at``: where a world's part of a history begins.

    ``squares`` is the sum of squares, ``along`` the product of a change with the move before; ``conjugate`` makes a
    step of nonlinear CG, ``onward`` and ``onward_bodies`` one of momentum; ``products``, ``remember`` and ``combine``
    are the parts of Anderson's update; ``beyond`` is what bodies were given, ``fastest`` their largest speed; ``copy``
    and ``copy_bodies`` keep numbers for later, ``restore`` goes back to the predicted velocities. ``first_color`` is
    where the world's colours begin in ``colors``, the first block of each. Each is described at the top of its header.
    """
    t = scalar_types(dtype)
    real, vec4 = t.real, t.vec4
    vec8 = wp.types.vector(8, real)

    def code(name: str) -> str:
        return ranges_code(dtype, f"solve/{name}.h")

    @wp.func_native(code("squares"))
    def squares(
        x: wp.array(dtype=real),
        colors: wp.array(dtype=wp.int32),
        first_color: wp.int32,
        team: wp.uint64,
    ) -> real: ...

    @wp.func_native(code("beyond"))
    def beyond(
        bodies: wp.array(dtype=vec4),
        predicted: wp.array(dtype=vec4),
        b0: wp.int32,
        b1: wp.int32,
        fall: real,
        team: wp.uint64,
    ) -> real: ...

    @wp.func_native(code("fastest"))
    def fastest(bodies: wp.array(dtype=vec4), b0: wp.int32, b1: wp.int32, team: wp.uint64) -> real: ...

    @wp.func_native(code("conjugate"))
    def conjugate(
        x: wp.array(dtype=real),
        change: wp.array(dtype=real),
        direction: wp.array(dtype=real),
        beta: real,
        colors: wp.array(dtype=wp.int32),
        first_color: wp.int32,
        team: wp.uint64,
    ): ...

    @wp.func_native(code("along"))
    def along(
        change: wp.array(dtype=real),
        x: wp.array(dtype=real),
        before: wp.array(dtype=real),
        at: wp.int32,
        colors: wp.array(dtype=wp.int32),
        first_color: wp.int32,
        team: wp.uint64,
    ) -> real: ...

    @wp.func_native(code("onward"))
    def onward(
        x: wp.array(dtype=real),
        before: wp.array(dtype=real),
        at: wp.int32,
        beta: real,
        colors: wp.array(dtype=wp.int32),
        first_color: wp.int32,
        team: wp.uint64,
    ): ...

    @wp.func_native(code("onward_bodies"))
    def onward_bodies(
        bodies: wp.array(dtype=vec4),
        before: wp.array(dtype=real),
        at: wp.int32,
        b0: wp.int32,
        b1: wp.int32,
        beta: real,
        team: wp.uint64,
    ): ...

    @wp.func_native(code("products"))
    def products(
        x: wp.array(dtype=real),
        change: wp.array(dtype=real),
        history: wp.array(dtype=real),
        at: wp.int32,
        kept: wp.int32,
        colors: wp.array(dtype=wp.int32),
        first_color: wp.int32,
        team: wp.uint64,
    ) -> vec8: ...

    @wp.func_native(code("combine"))
    def combine(
        x: wp.array(dtype=real),
        change: wp.array(dtype=real),
        history: wp.array(dtype=real),
        at: wp.int32,
        kept: wp.int32,
        a: real,
        b: real,
        colors: wp.array(dtype=wp.int32),
        first_color: wp.int32,
        team: wp.uint64,
    ): ...

    @wp.func_native(code("remember"))
    def remember(
        x: wp.array(dtype=real),
        change: wp.array(dtype=real),
        history: wp.array(dtype=real),
        at: wp.int32,
        colors: wp.array(dtype=wp.int32),
        first_color: wp.int32,
        team: wp.uint64,
    ): ...

    @wp.func_native(code("copy"))
    def copy(
        source: wp.array(dtype=real),
        source_at: wp.int32,
        target: wp.array(dtype=real),
        target_at: wp.int32,
        colors: wp.array(dtype=wp.int32),
        first_color: wp.int32,
        team: wp.uint64,
    ): ...

    @wp.func_native(code("copy_bodies"))
    def copy_bodies(
        bodies: wp.array(dtype=vec4),
        history: wp.array(dtype=real),
        at: wp.int32,
        b0: wp.int32,
        b1: wp.int32,
        team: wp.uint64,
    ): ...

    @wp.func_native(code("restore"))
    def restore(
        predicted: wp.array(dtype=vec4), solved: wp.array(dtype=vec4), b0: wp.int32, b1: wp.int32, team: wp.uint64
    ): ...

    return SimpleNamespace(
        restore=restore,
        squares=squares,
        beyond=beyond,
        fastest=fastest,
        conjugate=conjugate,
        along=along,
        onward=onward,
        onward_bodies=onward_bodies,
        products=products,
        combine=combine,
        remember=remember,
        copy=copy,
        copy_bodies=copy_bodies,
    )
