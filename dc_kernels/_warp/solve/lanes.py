"""SIMD lanes: LANES rows of one colour solved side by side on a CPU, by native functions.

A block holds LANES rows column by column (``rows.COLUMNS``), so a column is one vector load. The bodies' velocities are
16-byte vec4 (32 in float64), loaded whole and transposed in registers. Rows of a colour share no dynamic body, and a
fixed body is written back unchanged, so lanes never disturb each other; empty lanes have zero columns and point at the
padding body.

The arithmetic is that of ``row``, operation by operation and without contraction, so both give the same bits; a test
compares them. On one core with AVX-512 a contact and sweep take 3.3-5 ns for general rows and 2.7-4.2 ns for discs
(``bench sweep``). Tried and left: 16 lanes gain under 5 % and pad small worlds more; sweeping two worlds at once gains
3-7 %, for throughput and not latency is the limit; rows sorted by place gain nothing in worlds that fit the cache.
"""

from functools import cache
from types import SimpleNamespace
from typing import Any

import warp as wp

from dc_kernels._warp.common import scalar_types
from dc_kernels._warp.native import native_code
from dc_kernels.solve.iteration import ASTRAY, FAR, MOVING
from dc_kernels.solve.rows import COLUMNS, JOINTED, LANES


def row_macros(variant: str) -> dict[str, Any]:
    """What ``native/solve/row.h`` asks for: the variant, its number of columns, and the place of each in a block."""
    columns = COLUMNS[variant]
    places = {f"AT_{name}": i * LANES for i, name in enumerate(columns)}
    for name in ("lo", "hi"):
        places.setdefault(f"AT_{name}", 0)  # named, and never read, where rows have no such column
    kinds = {"DISCS": variant == "discs", "JOINTS": variant in JOINTED, "OWN": variant == "rows"}
    return {"LANES": LANES, "COLUMNS": len(columns), **kinds, **places}


@cache
def lane_functions(dtype: str, variant: str) -> SimpleNamespace:
    """What is done to the blocks b0 .. b1 of a variant's rows, one function a header.

    ``extrapolate`` moves impulses on, and the velocities with them; ``move_on`` does so for the impulses alone, also on
    a GPU and where rows of a block share bodies.

    They take arrays rather than groups: a struct of 20 arrays passed by value would cost a small world's sweep 4 %.
    """
    t = scalar_types(dtype)
    real, vec4 = t.real, t.vec4
    macros = row_macros(variant)

    def code(*names: str, **more: object) -> str:
        return native_code("prelude.h", *(f"solve/{name}.h" for name in names), dtype=dtype, **macros, **more)

    @wp.func_native(code("bodies", "row", "sweep"))
    def sweep(
        columns: wp.array(dtype=real),
        row_body: wp.array(dtype=wp.int32),
        bodies: wp.array(dtype=vec4),
        impulse: wp.array(dtype=real),
        change: wp.array(dtype=real),
        b0: wp.int32,
        b1: wp.int32,
        omega: real,
    ) -> real: ...

    @wp.func_native(code("bodies", "row", "apply"))
    def apply(
        columns: wp.array(dtype=real),
        row_body: wp.array(dtype=wp.int32),
        bodies: wp.array(dtype=vec4),
        delta: wp.array(dtype=real),
        b0: wp.int32,
        b1: wp.int32,
    ): ...

    @wp.func_native(code("bodies", "row", "push"))
    def push(
        columns: wp.array(dtype=real),
        row_body: wp.array(dtype=wp.int32),
        bodies: wp.array(dtype=vec4),
        b0: wp.int32,
        b1: wp.int32,
        factor: real,
        limit: real,
    ) -> real: ...

    @wp.func_native(code("bodies", "row", "extrapolate", FOLLOW=True))
    def extrapolate(
        columns: wp.array(dtype=real),
        row_body: wp.array(dtype=wp.int32),
        bodies: wp.array(dtype=vec4),
        impulse: wp.array(dtype=real),
        change: wp.array(dtype=real),
        b0: wp.int32,
        b1: wp.int32,
        alpha: real,
    ): ...

    @wp.func_native(code("bodies", "row", "extrapolate", FOLLOW=False))
    def move_on(
        columns: wp.array(dtype=real),
        row_body: wp.array(dtype=wp.int32),
        bodies: wp.array(dtype=vec4),
        impulse: wp.array(dtype=real),
        change: wp.array(dtype=real),
        b0: wp.int32,
        b1: wp.int32,
        alpha: real,
    ): ...

    @wp.func_native(code("bodies", "moving", ASTRAY=ASTRAY, FAR=FAR, MOVING=MOVING))
    def moving(
        columns: wp.array(dtype=real),
        row_body: wp.array(dtype=wp.int32),
        bodies: wp.array(dtype=vec4),
        predicted: wp.array(dtype=vec4),
        change: wp.array(dtype=real),
        b0: wp.int32,
        b1: wp.int32,
        still: real,
        share: real,
        fall: real,
    ) -> wp.int32: ...

    @wp.func_native(code("bodies", "row", "natural_map"))
    def natural_map(
        columns: wp.array(dtype=real),
        row_body: wp.array(dtype=wp.int32),
        bodies: wp.array(dtype=vec4),
        impulse: wp.array(dtype=real),
        b0: wp.int32,
        b1: wp.int32,
    ) -> real: ...

    return SimpleNamespace(
        sweep=sweep,
        apply=apply,
        push=push,
        extrapolate=extrapolate,
        move_on=move_on,
        natural_map=natural_map,
        moving=moving,
    )


@wp.func_native("""
#if defined(__CUDA_ARCH__)
return 0;
#else
return 1;
#endif
""")
def has_lanes() -> wp.int32: ...
