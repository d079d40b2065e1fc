"""The radial functions of ``dc_kernels.sph.smoothing`` as C++ text: a block of neighbours weighed in SIMD lanes.

Scalar ``wp.func`` versions, one neighbour after the other, took 7-15 ns a neighbour in the SPH sums where these take
2-3: gathering, weighing and adding are loops of their own here, and only gathering is not in lanes.
"""

from dc_kernels.solve.rows import LANES
from dc_kernels.sph.smoothing import COINCIDENT, GAUSSIAN_CUT, KERNELS

BLOCK = 64  # neighbours at a time, a multiple of LANES: their scratch stays in the L1 cache

# exp(x), x in [-GAUSSIAN_CUT^2 / 2, 0], as (Taylor polynomial of exp(x / 16))^16 of a degree that errs below round-off
_TAYLOR = {"float32": 9, "float64": 17}
_RATE = GAUSSIAN_CUT**2

# what a neighbour can be weighed by: w, f (the gradient is f e), d f + q^2 g, (d + 2) g + q^2 k, and f with g
TERMS = {"w": 0, "f": 1, "laplacian": 2, "laplacian_slope": 3, "hessian": 4}

# w, f, g, k of (1 - q)^3 for q > 0
_SPIKY = ("t * t * t", "-3 * t * t / p", "3 * t * (1 + q) / (p * p * p)", "3 * (q2 - 3) / (p * p * p * p * p)")


def radial_functions(dtype: str) -> dict[str, tuple[str, str, str, str]]:
    """By kernel: the bodies of w, f, g and k as functions of a vector q2 = q^2 <= 1; they name S, V and zero."""
    root = "const V q = __builtin_elementwise_sqrt(q2), t = 1 - q;"
    divisor = f"const V p = __builtin_elementwise_max(q, zero + (S){COINCIDENT});"
    away = f"q < (S){COINCIDENT} ? zero : "  # what is singular at the place of the query counts as 0
    flat = "const V s = 1 - q2;"
    degree = _TAYLOR[dtype]
    terms = " ".join(f"e = 1 + e * (x * (S)(1.0 / {n}));" for n in range(degree - 1, 0, -1))
    bell = (
        f"const V x = q2 * (S){-_RATE / 32}; V e = 1 + x * (S)(1.0 / {degree}); {terms} e *= e; e *= e; e *= e; e *= e;"
    )

    def cubic(inner: str, outer: str) -> str:
        return f"q <= (S)0.5 ? V({inner}) : V(2 * ({outer}))"

    w, f, g, k = _SPIKY
    return {
        "poly6": (
            f"{flat} return s * s * s;",
            f"{flat} return -6 * s * s;",
            f"{flat} return 24 * s;",
            "return zero - 48;",
        ),
        "spiky": (
            f"{root} return {w};",
            f"{root} {divisor} return {away}V({f});",
            f"{root} {divisor} return {away}V({g});",
            f"{root} {divisor} return {away}V({k});",
        ),
        "gaussian": (
            f"{bell} return e;",
            f"{bell} return e * (S){-_RATE};",
            f"{bell} return e * (S){_RATE**2};",
            f"{bell} return e * (S){-(_RATE**3)};",
        ),
        "cubic": (
            f"{root} return {cubic('6 * q2 * (q - 1) + 1', w)};",
            f"{root} {divisor} return {cubic('18 * q - 12', f)};",
            f"{root} {divisor} return {away}({cubic('18 / p', g)});",
            f"{root} {divisor} return {away}({cubic('-18 / (p * p * p)', k)});",
        ),
        "wendland": (
            f"{root} return (t * t) * (t * t) * (1 + 4 * q);",
            f"{root} return -20 * t * t * t;",
            f"{root} {divisor} return {away}V(60 * t * t / p);",
            f"{root} {divisor} return {away}V(-60 * t * (1 + q) / (p * p * p));",
        ),
    }


def block_text(dtype: str) -> str:
    """C++ that defines ``gather`` and ``weigh`` for the neighbours of a query, up to BLOCK at a time.

    It needs the names ``point``, a contiguous Warp array (n, dim), and ``inv_h``. ``gather(x, list, n)`` takes a
    query's coordinates and n neighbours: it fills ``at`` (their indices, and the first one's up to a whole vector),
    ``e0``, ``e1``, ``e2`` (offset over h) and ``q2s``, and returns the number of vectors. ``weigh(kernel, term, n,
    vectors)`` then fills ``s0`` with a term of each neighbour (``s1`` too for "hessian"), and with 0 from n on.
    """
    cases = []
    for name, (w, f, g, k) in radial_functions(dtype).items():
        lambdas = ", ".join(f"[&](const V q2) -> V {{ {body} }}" for body in (w, f, g, k))
        cases.append(f"case {KERNELS[name]}: fill({lambdas}); break;")
    return f"""
#pragma clang fp contract(off)
typedef {"float" if dtype == "float32" else "double"} S;
typedef S V __attribute__((ext_vector_type({LANES}), aligned(sizeof(S))));
const V zero = (S)0;
const int dim = (int)point.shape[1];
const S* P = (const S*)point.data;
int at[{BLOCK}];
S e0[{BLOCK}], e1[{BLOCK}], e2[{BLOCK}], q2s[{BLOCK}], s0[{BLOCK}], s1[{BLOCK}];
for (int j = 0; j < {BLOCK}; ++j) e2[j] = 0;
auto total = [](V v) {{ return ((v[0] + v[1]) + (v[2] + v[3])) + ((v[4] + v[5]) + (v[6] + v[7])); }};
auto gather = [&](const S* x, const int* list, int n) {{
    const int vectors = (n + {LANES - 1}) / {LANES};
    for (int j = 0; j < n; ++j) at[j] = list[j];
    for (int j = n; j < {LANES} * vectors; ++j) at[j] = list[0];
    if (dim == 2) {{
        for (int j = 0; j < {LANES} * vectors; ++j) {{
            const S* p = P + 2 * (size_t)at[j];
            e0[j] = p[0]; e1[j] = p[1];
        }}
    }} else {{
        for (int j = 0; j < {LANES} * vectors; ++j) {{
            const S* p = P + 3 * (size_t)at[j];
            e0[j] = p[0]; e1[j] = p[1]; e2[j] = p[2];
        }}
    }}
    for (int j = 0; j < {LANES} * vectors; j += {LANES}) {{
        const V a = (x[0] - *(V*)(e0 + j)) * inv_h, b = (x[1] - *(V*)(e1 + j)) * inv_h;
        V r2 = a * a + b * b;
        *(V*)(e0 + j) = a; *(V*)(e1 + j) = b;
        if (dim == 3) {{
            const V c = (x[2] - *(V*)(e2 + j)) * inv_h;
            r2 += c * c;
            *(V*)(e2 + j) = c;
        }}
        // the list decides who is within reach; round-off must not
        *(V*)(q2s + j) = __builtin_elementwise_min(r2, zero + 1);
    }}
    return vectors;
}};
auto weigh = [&](int kernel, int term, int n, int vectors) {{
    auto fill = [&](auto w, auto f, auto g, auto k) {{
        auto each = [&](auto weight) {{
            for (int j = 0; j < {LANES} * vectors; j += {LANES}) *(V*)(s0 + j) = weight(*(V*)(q2s + j));
        }};
        switch (term) {{
            case {TERMS["w"]}: each([&](V q2) {{ return w(q2); }}); break;
            case {TERMS["f"]}: each([&](V q2) {{ return f(q2); }}); break;
            case {TERMS["laplacian"]}: each([&](V q2) {{ return (S)dim * f(q2) + q2 * g(q2); }}); break;
            case {TERMS["laplacian_slope"]}: each([&](V q2) {{ return (S)(dim + 2) * g(q2) + q2 * k(q2); }}); break;
            default:
                each([&](V q2) {{ return f(q2); }});
                for (int j = 0; j < {LANES} * vectors; j += {LANES}) *(V*)(s1 + j) = g(*(V*)(q2s + j));
                for (int j = n; j < {LANES} * vectors; ++j) s1[j] = 0;
        }}
    }};
    switch (kernel) {{ {" ".join(cases)} }}
    for (int j = n; j < {LANES} * vectors; ++j) s0[j] = 0;
}};
"""
