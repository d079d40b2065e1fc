"""SIMD lanes: LANES rows of one colour solved side by side on a CPU, by native functions.

A block holds LANES rows column by column (``rows.COLUMNS``), so a column is one vector load. The bodies' velocities are
16-byte vec4 (32 in float64), loaded whole and transposed in registers. Rows of a colour share no dynamic body, and a
fixed body is written back unchanged, so lanes never disturb each other; empty lanes have zero columns and point at the
padding body.

The arithmetic is that of ``row``, operation by operation and without contraction, so both give the same bits; a test
compares them. Two blocks are solved side by side (``take_blocks.h``): on one core at 2.5 GHz with AVX-512 a contact and
sweep take 4.6-8.7 ns for general rows and 3.8-8.1 ns for discs (``bench sweep``); one block after the other took a
fifth more. Tried and left: 16 lanes gain under 5 % and pad small worlds more; rows sorted by place gain
nothing in worlds that fit the cache.
"""

from functools import cache
from types import SimpleNamespace
from typing import Any

import warp as wp

from dc_kernels._warp.groups import group_types
from dc_kernels._warp.native import SCALARS, in_parts, native_code
from dc_kernels._warp.solve.ranges import RANGES
from dc_kernels.model.fields import UNBOUNDED
from dc_kernels.runtime.sequences import SEATS
from dc_kernels.solve.iteration import ALIKE, ASTRAY, FAR, MOVING, SCARCE
from dc_kernels.solve.rows import COLUMNS, JOINTED, LANES, OWN, SERIAL_COLOR, SOFT_NUMBERS, SURFACED, TOUCH


def row_macros(variant: str) -> dict[str, Any]:
    """What ``native/solve/row.h`` asks for: the variant, its number of columns, and the place of each in a block."""
    columns = COLUMNS[variant]
    places = {f"AT_{name}": i * LANES for i, name in enumerate(columns)}
    for name in ("lo", "hi", "roll"):
        places.setdefault(f"AT_{name}", 0)  # named, and never read, where rows have no such column
    kinds = {"DISCS": variant == "discs", "JOINTS": variant in JOINTED}
    kinds |= {"OWN": variant in OWN, "SURFACES": variant in SURFACED}
    return {"LANES": LANES, "COLUMNS": len(columns), **kinds, **places}


@cache
def lane_functions(dtype: str, variant: str) -> SimpleNamespace:
    """What is done to the blocks of a world's colours, or to the blocks b0 .. b1, one function a header.

    ``at`` is the world's first colour in ``colors``, the first block of each; the last colour, the serial one, is left
    out. ``team`` is the address of threads that share the blocks of a colour, or 0. ``extrapolate`` moves impulses on,
    and the velocities with them; ``move_on`` does so for the impulses alone, also on a GPU and where rows of a block
    share bodies. They take arrays rather than groups: a struct of 20 arrays passed by value would cost a small world's
    sweep 4 %.
    """
    t = group_types(dtype)
    real, vec4 = t.real, t.vec4
    macros = row_macros(variant)

    def code(*names: str, **more: object) -> str:
        return native_code("prelude.h", *(f"solve/{name}.h" for name in names), dtype=dtype, **macros, **more)

    def by_color(name: str, *arrays: str, **more: object) -> str:
        taken = native_code("runtime/team.h", "runtime/by_color.h", dtype=dtype, SEATS=SEATS, SERIAL=SERIAL_COLOR)
        return in_parts(
            code("bodies", "row", "take_blocks", name, **more),
            "double",
            taken,
            ("columns", "row_body", "bodies", *arrays),
            given="const int* ends, int colors",
        )

    @wp.func_native(by_color("sweep", "impulse", "change"))
    def sweep(
        columns: wp.array(dtype=real),
        row_body: wp.array(dtype=wp.int32),
        bodies: wp.array(dtype=vec4),
        impulse: wp.array(dtype=real),
        change: wp.array(dtype=real),
        colors: wp.array(dtype=wp.int32),
        at: wp.int32,
        omega: real,
        team: wp.uint64,
    ) -> real: ...

    @wp.func_native(by_color("soft", "displacement", "impulse", "before", TOUCH=TOUCH, UNBOUNDED=UNBOUNDED))
    def sweep_soft(
        columns: wp.array(dtype=real),
        row_body: wp.array(dtype=wp.int32),
        bodies: wp.array(dtype=vec4),
        displacement: wp.array(dtype=vec4),
        impulse: wp.array(dtype=real),
        before: wp.array(dtype=real),
        colors: wp.array(dtype=wp.int32),
        at: wp.int32,
        soft: wp.types.vector(SOFT_NUMBERS, real),
        team: wp.uint64,
    ) -> real: ...

    @wp.func_native(by_color("apply", "delta"))
    def apply(
        columns: wp.array(dtype=real),
        row_body: wp.array(dtype=wp.int32),
        bodies: wp.array(dtype=vec4),
        delta: wp.array(dtype=real),
        colors: wp.array(dtype=wp.int32),
        at: wp.int32,
        team: wp.uint64,
    ) -> real: ...

    @wp.func_native(by_color("push"))
    def push(
        columns: wp.array(dtype=real),
        row_body: wp.array(dtype=wp.int32),
        bodies: wp.array(dtype=vec4),
        colors: wp.array(dtype=wp.int32),
        at: wp.int32,
        factor: real,
        limit: real,
        team: wp.uint64,
    ) -> real: ...

    @wp.func_native(by_color("extrapolate", "impulse", "change", FOLLOW=True))
    def extrapolate(
        columns: wp.array(dtype=real),
        row_body: wp.array(dtype=wp.int32),
        bodies: wp.array(dtype=vec4),
        impulse: wp.array(dtype=real),
        change: wp.array(dtype=real),
        colors: wp.array(dtype=wp.int32),
        at: wp.int32,
        alpha: real,
        team: wp.uint64,
    ) -> real: ...

    @wp.func_native(code("bodies", "row", "extrapolate", FOLLOW=False))
    def move_on(
        columns: wp.array(dtype=real),
        row_body: wp.array(dtype=wp.int32),
        bodies: wp.array(dtype=vec4),
        impulse: wp.array(dtype=real),
        change: wp.array(dtype=real),
        first: wp.int32,
        last: wp.int32,
        alpha: real,
    ): ...

    @wp.func_native(code("lacking", UNBOUNDED=UNBOUNDED))
    def lacking(
        columns: wp.array(dtype=real),
        change: wp.array(dtype=real),
        b0: wp.int32,
        b1: wp.int32,
        still: real,
        enough: wp.int32,
    ) -> wp.int32: ...

    summed = native_code(
        "runtime/team.h", "runtime/ranges.h", "runtime/sum_blocks.h", dtype=dtype, SERIAL=SERIAL_COLOR, **RANGES
    )

    counted = native_code(
        "runtime/team.h", "runtime/ranges.h", "runtime/count_rows.h", dtype=dtype, ASTRAY=ASTRAY, **RANGES
    )
    moved = in_parts(
        code("bodies", "moving", ASTRAY=ASTRAY, ALIKE=ALIKE, FAR=FAR, MOVING=MOVING, SCARCE=SCARCE),
        "int",
        counted,
        ("columns", "row_body", "bodies", "predicted", "change"),
    )

    @wp.func_native(moved)
    def moving(
        columns: wp.array(dtype=real),
        row_body: wp.array(dtype=wp.int32),
        bodies: wp.array(dtype=vec4),
        predicted: wp.array(dtype=vec4),
        change: wp.array(dtype=real),
        span: t.Span,
        shares: vec4,
        colors: wp.array(dtype=wp.int32),
        at: wp.int32,
    ) -> wp.int32: ...

    mapped = in_parts(
        code("bodies", "row", "natural_map"),
        SCALARS[dtype],
        summed,
        ("columns", "row_body", "bodies", "impulse"),
        given=f"int first, int last, {SCALARS[dtype]} sum",
    )

    @wp.func_native(mapped)
    def natural_map(
        columns: wp.array(dtype=real),
        row_body: wp.array(dtype=wp.int32),
        bodies: wp.array(dtype=vec4),
        impulse: wp.array(dtype=real),
        colors: wp.array(dtype=wp.int32),
        at: wp.int32,
        team: wp.uint64,
    ) -> real: ...

    @wp.func_native(native_code("solve/bound.h", dtype=dtype, **macros))
    def bound(
        columns: wp.array(dtype=real),
        limit_slot: wp.array(dtype=wp.int32),
        impulse: wp.array(dtype=real),
        b0: wp.int32,
        b1: wp.int32,
    ): ...

    return SimpleNamespace(
        sweep=sweep,
        sweep_soft=sweep_soft,
        apply=apply,
        push=push,
        extrapolate=extrapolate,
        move_on=move_on,
        natural_map=natural_map,
        moving=moving,
        lacking=lacking,
        bound=bound,
    )


@wp.func_native("""
#if defined(__CUDA_ARCH__)
return 0;
#else
return 1;
#endif
""")
def has_lanes() -> wp.int32: ...
