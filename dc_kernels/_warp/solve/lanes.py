"""SIMD lanes: LANES rows of one colour solved side by side, as native snippets for the CPU.

A block holds LANES rows column by column (``rows.COLUMNS``), so a column is one vector load. The bodies'
velocities are 16-byte vec4 (32 in float64), loaded whole and transposed in registers. Rows of a colour share
no dynamic body, and a fixed body is written back unchanged, so lanes never disturb each other; empty lanes
have zero columns and point at the padding body.

The arithmetic is that of ``row.row_functions``, operation by operation and without contraction, so both give
the same bits; a test compares them. On one core with AVX-512 a contact and sweep take 3.3-5 ns for general rows
and 2.7-4.2 ns for discs (``bench sweep``). Tried and left: 16 lanes gain under 5 % and pad small worlds more;
sweeping two worlds at once gains 3-7 %, for throughput and not latency is the limit; rows sorted by place gain
nothing in worlds that fit the cache.
"""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import scalar_types
from dc_kernels.solve.rows import LANES

_LANE_ORDER = {
    "low": lambda b: (b, LANES + b, b + 1, LANES + b + 1),
    "high": lambda b: (b + 2, LANES + b + 2, b + 3, LANES + b + 3),
    "low pair": lambda b: (b, b + 1, LANES + b, LANES + b + 1),
    "high pair": lambda b: (b + 2, b + 3, LANES + b + 2, LANES + b + 3),
}


def _shuffle(first: str, second: str, order: str) -> str:
    lanes = [lane for group in range(0, LANES, 4) for lane in _LANE_ORDER[order](group)]
    return f"__builtin_shufflevector({first}, {second}, {', '.join(map(str, lanes))})"


def _transpose(inputs: list[str], outputs: list[str], temp: str) -> str:
    """4 x 4 transposes inside groups of four lanes (its own inverse)."""
    a, b, c, d = inputs
    lines = [
        f"V {temp}0 = {_shuffle(a, b, 'low')}, {temp}1 = {_shuffle(c, d, 'low')};",
        f"V {temp}2 = {_shuffle(a, b, 'high')}, {temp}3 = {_shuffle(c, d, 'high')};",
        f"V {outputs[0]} = {_shuffle(temp + '0', temp + '1', 'low pair')};",
        f"V {outputs[1]} = {_shuffle(temp + '0', temp + '1', 'high pair')};",
        f"V {outputs[2]} = {_shuffle(temp + '2', temp + '3', 'low pair')};",
        f"V {outputs[3]} = {_shuffle(temp + '2', temp + '3', 'high pair')};",
    ]
    return "\n".join(lines)


def _load_bodies(side: str) -> str:
    """Vectors {side}x, {side}y, {side}w, {side}m from the vec4 of LANES = 8 bodies."""
    lines = [f"const Q {side}q{i} = *(const Q*)(body + 4 * (size_t)i{side}[{i}]);" for i in range(LANES)]
    all_lanes = ", ".join(map(str, range(LANES)))
    lines += [
        f"const V {side}p{i} = __builtin_shufflevector({side}q{i}, {side}q{i + 4}, {all_lanes});" for i in range(4)
    ]
    lines.append(_transpose([f"{side}p{i}" for i in range(4)], [f"{side}{c}" for c in "xywm"], f"{side}t"))
    return "\n".join(lines)


def _store_bodies(side: str) -> str:
    lines = [_transpose([f"{side}{c}" for c in "xywm"], [f"{side}o{i}" for i in range(4)], f"{side}u")]
    for i in range(LANES):
        vector, first = f"{side}o{i % 4}", 4 * (i // 4)
        part = ", ".join(str(first + k) for k in range(4))
        lines.append(f"*(Q*)(body + 4 * (size_t)i{side}[{i}]) = __builtin_shufflevector({vector}, {vector}, {part});")
    return "\n".join(lines)


_APPLY_NORMAL = {
    "discs": """
        V px = nx * dn, py = ny * dn;
        Ax -= Am * px; Ay -= Am * py; Bx += Bm * px; By += Bm * py;""",
    "general": """
        V px = nx * dn, py = ny * dn;
        Ax -= Am * px; Ay -= Am * py; Bx += Bm * px; By += Bm * py;
        Aw -= iA * (rAn * dn); Bw += iB * (rBn * dn);""",
}
_APPLY_TANGENT = {
    "discs": """
        V qx = ny * dt, qy = nx * dt;
        Ax -= Am * qx; Ay += Am * qy; Bx += Bm * qx; By -= Bm * qy;
        Aw += kA * dt; Bw += kB * dt;""",
    "general": """
        V qx = ny * dt, qy = nx * dt;
        Ax -= Am * qx; Ay += Am * qy; Bx += Bm * qx; By -= Bm * qy;
        Aw -= iA * (rAt * dt); Bw += iB * (rBt * dt);""",
}
_NORMAL_SPEED = {
    "discs": "V vn = nx * (Bx - Ax) + ny * (By - Ay);",
    "general": "V vn = (nx * (Bx - Ax) + ny * (By - Ay)) + (rBn * Bw - rAn * Aw);",
}
_TANGENT_SPEED = {
    "discs": "V vt = (ny * (Bx - Ax) - nx * (By - Ay)) + (dB * Bw + dA * Aw);",
    "general": "V vt = (ny * (Bx - Ax) - nx * (By - Ay)) + (rBt * Bw - rAt * Aw);",
}


def _snippet(dtype: str, columns: tuple[str, ...], used: set[str], body: str, before: str = "", after: str = "") -> str:
    """A loop over blocks b0..b1 with the used columns and both bodies loaded, and the bodies stored."""
    scalar = {"float32": "float", "float64": "double"}[dtype]
    loads = "\n".join(f"const V {c} = *(const V*)(R + {i * LANES});" for i, c in enumerate(columns) if c in used)
    return f"""
#if defined(__CUDA_ARCH__)
{"return 0;" if "return" in after else ""}
#else
#pragma clang fp contract(off)
typedef {scalar} S;
typedef S V __attribute__((ext_vector_type({LANES}), aligned({LANES // 2})));
typedef S Q __attribute__((ext_vector_type(4), aligned(4)));
S* body = (S*)bodies.data;
const V zero = (S)0;
{before}
for (int b = b0; b < b1; ++b) {{
    const int* iA = row_body.data + (size_t)b * {2 * LANES};
    const int* iB = iA + {LANES};
    const S* R = rows.data + (size_t)b * {len(columns) * LANES};
    {_load_bodies("A")}
    {_load_bodies("B")}
    {{
    {loads}
    {body}
    }}
    {_store_bodies("A")}
    {_store_bodies("B")}
}}
{after}
#endif
"""


def _largest(name: str) -> str:
    lanes = " ".join(f"if ({name}[{i}] > out) out = {name}[{i}];" for i in range(LANES))
    return f"S out = 0; {lanes} return out;"


@cache
def lane_functions(dtype: str, variant: str, columns: tuple[str, ...]) -> dict[str, Any]:
    """``sweep``, ``apply``, ``push`` and ``extrapolate`` over blocks b0..b1.

    ``extrapolate`` moves impulses on along their last change, x <- clamp(x + alpha change), and leaves in
    ``change`` what it moved them by.

    Args:
        dtype: "float32" or "float64".
        variant: "discs", "general" or "joints".
        columns: names of the columns of a row, in order.
    """
    t = scalar_types(dtype)
    real, vec4 = t.real, t.vec4
    kind = "discs" if variant == "discs" else "general"
    low = "lo" if variant == "joints" else "zero"
    # a disc's normal impulse has no tangential effect: its tangent need not wait for it (8 % of a small world's sweep)
    tangent_then_normal = _TANGENT_SPEED[kind] + _APPLY_NORMAL[kind]
    normal_then_tangent = _APPLY_NORMAL[kind] + _TANGENT_SPEED[kind]
    sweep_code = _snippet(
        dtype,
        columns,
        set(columns) - {"gap"},
        f"""
        S* L = row_impulse.data + (size_t)b * {2 * LANES};
        const V ln0 = *(const V*)L, lt0 = *(const V*)(L + {LANES});
        {_NORMAL_SPEED[kind]}
        const V ln = __builtin_elementwise_max(ln0 - (omega * en) * (vn + bias), {low});
        const V dn = ln - ln0;
        {tangent_then_normal if kind == "discs" else normal_then_tangent}
        const V limit = mu * ln;
        const V lt = __builtin_elementwise_min(__builtin_elementwise_max(lt0 - (omega * et) * vt, -limit), limit);
        const V dt = lt - lt0;
        {_APPLY_TANGENT[kind]}
        *(V*)L = ln; *(V*)(L + {LANES}) = lt;
        S* D = row_change.data + (size_t)b * {2 * LANES};
        *(V*)D = dn; *(V*)(D + {LANES}) = dt;
        most = __builtin_elementwise_max(
            most, __builtin_elementwise_max(__builtin_elementwise_abs(dn), __builtin_elementwise_abs(dt)));
        """,
        before="V most = zero;",
        after=_largest("most"),
    )
    apply_code = _snippet(
        dtype,
        columns,
        set(columns) - {"gap", "bias", "mu", "en", "et", "lo", "dA", "dB"},
        f"""
        const S* L = delta.data + (size_t)b * {2 * LANES};
        const V dn = *(const V*)L, dt = *(const V*)(L + {LANES});
        {_APPLY_NORMAL[kind]}
        {_APPLY_TANGENT[kind]}
        """,
    )
    push_code = _snippet(
        dtype,
        columns,
        {"nx", "ny", "rAn", "rBn", "iA", "iB", "en", "gap", "lo"} & set(columns),
        f"""
        {_NORMAL_SPEED[kind]}
        V step = __builtin_elementwise_max(factor * (vn + gap), zero - limit);
        {"step = __builtin_elementwise_min(step, zero + limit);" if low == "lo" else ""}
        const V dn = __builtin_elementwise_max(-(en * step), {low});
        {_APPLY_NORMAL[kind]}
        most = __builtin_elementwise_max(most, __builtin_elementwise_abs(dn));
        """,
        before="V most = zero;",
        after=_largest("most"),
    )
    mu_at, lo_at = columns.index("mu") * LANES, columns.index("lo") * LANES if low == "lo" else 0
    width = len(columns) * LANES
    move_code = f"""
#if defined(__CUDA_ARCH__)
for (int b = b0; b < b1; ++b) {{
    for (int l = 0; l < {LANES}; ++l) {{
        const int n = b * {2 * LANES} + l, t = n + {LANES};
        const auto mu = rows.data[b * {width} + {mu_at} + l];
        const auto low = {f"rows.data[b * {width} + {lo_at} + l]" if low == "lo" else "0"};
        const auto xn = row_impulse.data[n], xt = row_impulse.data[t];
        auto yn = xn + alpha * row_change.data[n];
        yn = yn > low ? yn : low;
        const auto limit = mu * yn;
        auto yt = xt + alpha * row_change.data[t];
        yt = yt > -limit ? yt : -limit;
        yt = yt < limit ? yt : limit;
        row_impulse.data[n] = yn; row_impulse.data[t] = yt;
        row_change.data[n] = yn - xn; row_change.data[t] = yt - xt;
    }}
}}
#else
#pragma clang fp contract(off)
typedef {"float" if dtype == "float32" else "double"} S;
typedef S V __attribute__((ext_vector_type({LANES}), aligned({LANES // 2})));
const V zero = (S)0;
for (int b = b0; b < b1; ++b) {{
    const S* R = rows.data + (size_t)b * {width};
    S* X = row_impulse.data + (size_t)b * {2 * LANES};
    S* D = row_change.data + (size_t)b * {2 * LANES};
    const V mu = *(const V*)(R + {mu_at});
    const V low = {f"*(const V*)(R + {lo_at})" if low == "lo" else "zero"};
    const V xn = *(const V*)X, xt = *(const V*)(X + {LANES});
    const V yn = __builtin_elementwise_max(xn + alpha * *(const V*)D, low);
    const V limit = mu * yn;
    const V yt = __builtin_elementwise_min(
        __builtin_elementwise_max(xt + alpha * *(const V*)(D + {LANES}), -limit), limit);
    *(V*)X = yn; *(V*)(X + {LANES}) = yt;
    *(V*)D = yn - xn; *(V*)(D + {LANES}) = yt - xt;
}}
#endif
"""

    @wp.func_native(move_code)
    def extrapolate(
        rows: wp.array(dtype=real),
        row_impulse: wp.array(dtype=real),
        row_change: wp.array(dtype=real),
        b0: wp.int32,
        b1: wp.int32,
        alpha: real,
    ): ...

    @wp.func_native(sweep_code)
    def sweep(
        rows: wp.array(dtype=real),
        row_body: wp.array(dtype=wp.int32),
        bodies: wp.array(dtype=vec4),
        row_impulse: wp.array(dtype=real),
        row_change: wp.array(dtype=real),
        b0: wp.int32,
        b1: wp.int32,
        omega: real,
    ) -> real: ...

    @wp.func_native(apply_code)
    def apply(
        rows: wp.array(dtype=real),
        row_body: wp.array(dtype=wp.int32),
        bodies: wp.array(dtype=vec4),
        delta: wp.array(dtype=real),
        b0: wp.int32,
        b1: wp.int32,
    ): ...

    @wp.func_native(push_code)
    def push(
        rows: wp.array(dtype=real),
        row_body: wp.array(dtype=wp.int32),
        bodies: wp.array(dtype=vec4),
        b0: wp.int32,
        b1: wp.int32,
        factor: real,
        limit: real,
    ) -> real: ...

    return {"sweep": sweep, "apply": apply, "push": push, "extrapolate": extrapolate}


def _sums(terms: tuple[str, ...], loads: str, end: str) -> str:
    """Sums over i0..i1, whose length is a multiple of 8, in eight parts each; ``loads`` names the values at i."""
    scalar = " ".join(f"t{k} += {term};" for k, term in enumerate(terms))
    total = "t{k} = ((s{k}[0] + s{k}[1]) + (s{k}[2] + s{k}[3])) + ((s{k}[4] + s{k}[5]) + (s{k}[6] + s{k}[7]));"
    parts = ", ".join(f"t{k} = 0" for k in range(len(terms)))
    return f"""
#if defined(__CUDA_ARCH__)
S_TYPE {parts};
typedef S_TYPE V;
for (int i = i0; i < i1; ++i) {{
    {loads}
    {scalar}
}}
#else
#pragma clang fp contract(off)
S_TYPE {parts};
typedef S_TYPE V __attribute__((ext_vector_type(8), aligned(4)));
V {", ".join(f"s{k} = (S_TYPE)0" for k in range(len(terms)))};
for (int i = i0; i < i1; i += 8) {{
    {loads}
    {" ".join(f"s{k} += {term};" for k, term in enumerate(terms))}
}}
{" ".join(total.format(k=k) for k in range(len(terms)))}
#endif
{end}
"""


_SQUARES = _sums(("d * d",), "const V d = *(const V*)(x.data + i);", "return t0;")
_ALONG = _sums(
    ("d * m",),
    "const V d = *(const V*)(change.data + i), m = *(const V*)(x.data + i) - *(const V*)(before.data + at + (i - i0));",
    "return t0;",
)
# f: steps, e: iterates, minus those remembered
_PRODUCTS = _sums(
    ("f1 * f1", "f1 * f2", "f2 * f2", "f1 * d", "f2 * d", "e1 * e1", "e1 * e2", "e2 * e2"),
    """
    const int stride = i1 - i0;
    const S_TYPE* H = history.data + at + (i - i0);
    const V d = *(const V*)(change.data + i), v = *(const V*)(x.data + i);
    const V e1 = v - *(const V*)H, f1 = d - *(const V*)(H + stride);
    V e2 = v - *(const V*)(H + 2 * stride), f2 = d - *(const V*)(H + 3 * stride);
    if (kept < 2) { e2 = (S_TYPE)0; f2 = (S_TYPE)0; }
    """,
    "S_TYPE* out = norms.data + sums;" + " ".join(f"out[{k}] = t{k};" for k in range(8)),
)
_REMEMBER = """
const int stride = i1 - i0;
for (int i = i0; i < i1; ++i) {
    S_TYPE* H = history.data + at + (i - i0);
    H[2 * stride] = H[0];
    H[3 * stride] = H[stride];
    H[0] = x.data[i];
    H[stride] = change.data[i];
}
"""
_COMBINE = """
#if !defined(__CUDA_ARCH__)
#pragma clang fp contract(off)
#endif
const int stride = i1 - i0;
for (int i = i0; i < i1; ++i) {
    S_TYPE* H = history.data + at + (i - i0);
    const S_TYPE v = x.data[i], d = change.data[i];
    S_TYPE move = a * (v - H[0]);
    if (kept > 1) move += b * (v - H[2 * stride]);
    H[2 * stride] = H[0];
    H[3 * stride] = H[stride];
    H[0] = v;
    H[stride] = d;
    change.data[i] = -move;
}
"""
_ONWARD = """
#if !defined(__CUDA_ARCH__)
#pragma clang fp contract(off)
#endif
for (int i = i0; i < i1; ++i) {
    const S_TYPE v = x.data[i];
    S_TYPE* b = before.data + at + (i - i0);
    x.data[i] = v + beta * (v - b[0]);
    b[0] = v;
}
"""
_ONWARD_BODIES = """
#if !defined(__CUDA_ARCH__)
#pragma clang fp contract(off)
#endif
S_TYPE* now = (S_TYPE*)bodies.data;
S_TYPE* last = before.data + at - 4 * b0;
for (int i = 4 * b0; i < 4 * b1; ++i) {
    const S_TYPE v = now[i];
    now[i] = v + beta * (v - last[i]);
    last[i] = v;
}
"""
_CONJUGATE = """
#if !defined(__CUDA_ARCH__)
#pragma clang fp contract(off)
#endif
for (int i = i0; i < i1; ++i) {
    const S_TYPE step = beta > 0 ? beta * direction.data[i] : (S_TYPE)0;  // it may hold NaN of the solve before
    direction.data[i] = step + change.data[i];
    x.data[i] += step;
    change.data[i] = step;
}
"""


@cache
def range_functions(dtype: str) -> dict[str, Any]:
    """Whole ranges of row impulses i0..i1 (a multiple of 8 long), and of bodies b0..b1.

    ``conjugate`` is a step of nonsmooth nonlinear CG (Silcowitz, Niebe, Erleben 2010): x moves on by beta times the
    direction, the direction becomes that step plus the last change, and ``change`` holds what x moved by. ``squares``
    and ``along``: sums of change^2 and change (x - before). ``onward``, ``onward_bodies``: x moves on by
    beta (x - before), and before, which begins at ``at``, is what x was. The history holds two iterates and their
    steps, the latest first: x1, change1, x2, change2, from ``at`` on; ``remember`` puts x and change in front.
    ``products`` writes the sums that least squares over the differences to them need; ``combine`` leaves the update in
    ``change``, and remembers.
    """
    t = scalar_types(dtype)
    real, vec4 = t.real, t.vec4
    name = {"float32": "float", "float64": "double"}[dtype]

    @wp.func_native(_SQUARES.replace("S_TYPE", name))
    def squares(x: wp.array(dtype=real), i0: wp.int32, i1: wp.int32) -> real: ...

    @wp.func_native(_CONJUGATE.replace("S_TYPE", name))
    def conjugate(
        x: wp.array(dtype=real),
        change: wp.array(dtype=real),
        direction: wp.array(dtype=real),
        i0: wp.int32,
        i1: wp.int32,
        beta: real,
    ): ...

    @wp.func_native(_ALONG.replace("S_TYPE", name))
    def along(
        change: wp.array(dtype=real),
        x: wp.array(dtype=real),
        before: wp.array(dtype=real),
        at: wp.int32,
        i0: wp.int32,
        i1: wp.int32,
    ) -> real: ...

    @wp.func_native(_ONWARD.replace("S_TYPE", name))
    def onward(
        x: wp.array(dtype=real), before: wp.array(dtype=real), at: wp.int32, i0: wp.int32, i1: wp.int32, beta: real
    ): ...

    @wp.func_native(_ONWARD_BODIES.replace("S_TYPE", name))
    def onward_bodies(
        bodies: wp.array(dtype=vec4), before: wp.array(dtype=real), at: wp.int32, b0: wp.int32, b1: wp.int32, beta: real
    ): ...

    @wp.func_native(_PRODUCTS.replace("S_TYPE", name))
    def products(
        x: wp.array(dtype=real),
        change: wp.array(dtype=real),
        history: wp.array(dtype=real),
        at: wp.int32,
        i0: wp.int32,
        i1: wp.int32,
        kept: wp.int32,
        norms: wp.array(dtype=real),
        sums: wp.int32,
    ): ...

    @wp.func_native(_COMBINE.replace("S_TYPE", name))
    def combine(
        x: wp.array(dtype=real),
        change: wp.array(dtype=real),
        history: wp.array(dtype=real),
        at: wp.int32,
        i0: wp.int32,
        i1: wp.int32,
        kept: wp.int32,
        a: real,
        b: real,
    ): ...

    @wp.func_native(_REMEMBER.replace("S_TYPE", name))
    def remember(
        x: wp.array(dtype=real),
        change: wp.array(dtype=real),
        history: wp.array(dtype=real),
        at: wp.int32,
        i0: wp.int32,
        i1: wp.int32,
    ): ...

    return {
        "squares": squares,
        "conjugate": conjugate,
        "along": along,
        "onward": onward,
        "onward_bodies": onward_bodies,
        "products": products,
        "combine": combine,
        "remember": remember,
    }


@wp.func_native("""
#if defined(__CUDA_ARCH__)
return 0;
#else
return 1;
#endif
""")
def has_lanes() -> wp.int32: ...
