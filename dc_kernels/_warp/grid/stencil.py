"""What a point reaches on a grid and with which weights: C++ text that the native snippets of ``transfer`` are made of.

A radial stencil (poly6, spiky, Gaussian, cubic spline, Wendland C2) weighs the nodes within h. Weights are computed in
vectors of LANES columns, row by row, in a window of whole vectors that is slid into the row where it would leave it:
its nodes beyond h get weight 0, so no column is tested. A separable stencil (bilinear, cubic B-spline) has up to 4 x 4
nodes and fills the same window. Lengths are in spacings; q2 = r^2 / h^2; shape(q2) is W without its constant.
"""

from dc_kernels._warp.sph.smoothing import radial_functions
from dc_kernels.solve.rows import LANES
from dc_kernels.sph.smoothing import STENCILS, constant

ROWS = 16  # of a window that is kept in registers and the first-level cache


def _radial_cases(dtype: str) -> list[str]:
    """A case of the switch for each kernel: its shape w, 0 beyond q2 = 1, its slope f = w' / q, and its constant."""
    cases = []
    for name, (shape, slope, *_) in radial_functions(dtype).items():
        # at q2 = 1 all but the Gaussian are 0 by themselves
        end = "far <= 1 ? inside(V(__builtin_elementwise_min(far, zero + 1))) : zero"
        if name != "gaussian":
            end = "inside(V(__builtin_elementwise_min(far, zero + 1)))"
        functions = ", ".join(
            f"[&](const V far) -> V {{ auto inside = [&](const V q2) -> V {{ {body} }}; return {end}; }}"
            for body in (shape, slope)
        )
        cases.append(f"case {STENCILS[name]}: radial({functions}, (S){constant(name, 2)!r}); break;")
    return cases


# Names that the snippets have before: image (4-D), spacing, h, world, grid_origin, point.
SETUP = f"""
#pragma clang fp contract(off)
typedef S_TYPE S;
typedef S V __attribute__((ext_vector_type({LANES}), aligned(sizeof(S))));
typedef int I __attribute__((ext_vector_type({LANES}), aligned(4)));
const int L = {LANES};
const int R = image.shape[2], K = image.shape[3];
const S inv = 1 / spacing, hs = h * inv, inv_h2 = 1 / (hs * hs);
const S ox = ((const S*)grid_origin.data)[2 * world], oy = ((const S*)grid_origin.data)[2 * world + 1];
const S* P = (const S*)point.data;
V iota;
for (int j = 0; j < L; ++j) iota[j] = (S)j;
const V zero = (S)0;
auto total = [](V v) {{
    const auto four = v.lo + v.hi;
    const auto two = four.lo + four.hi;
    return two.x + two.y;
}};
auto clip = [](S v, S lo, S hi) {{ return v < lo ? lo : (v > hi ? hi : v); }};

// the window of a point: rows r0..r1, nv vectors of columns from column a
S x, y;
int r0, r1, a, nv;
bool one;  // a single vector, all of it in the row, and few rows
auto slide = [&](int c0, int c1) {{
    a = c0;
    nv = (c1 - c0) / L + 1;
    if (a + nv * L > K) a = K > nv * L ? K - nv * L : 0;
    one = nv == 1 && a + L <= K && r1 - r0 < {ROWS};
}};
// L points at a time: their coordinates, then in spacings, NaN and inf kept
S xs[L] = {{0}}, ys[L] = {{0}};
auto to_grid = [&]() {{
    *(V*)xs = (*(const V*)xs - ox) * inv;
    *(V*)ys = (*(const V*)ys - oy) * inv;
}};
auto is_finite = [](S u, S v) {{ return u - u == 0 && v - v == 0; }};
// a grid narrower than the window: what lies beyond it has no weight and is not touched
auto within = [&](V w, int v) {{
    const int n = K - (a + v * L);
    if (n < L) for (int j = 0; j < L; ++j) if (j >= n) w[j] = 0;
    return w;
}};
auto load = [&](const S* p, int v) -> V {{
    const int n = K - (a + v * L);
    if (n >= L) return *(const V*)p;
    V w = zero;
    for (int j = 0; j < L; ++j) if (j < n) w[j] = p[j];
    return w;
}};
auto store = [&](S* p, int v, V w) {{
    const int n = K - (a + v * L);
    if (n >= L) {{ *(V*)p = w; return; }}
    for (int j = 0; j < L; ++j) if (j < n) p[j] = w[j];
}};
auto finite = [&](int i) {{
    x = (P[2 * (size_t)i] - ox) * inv;
    y = (P[2 * (size_t)i + 1] - oy) * inv;
    return is_finite(x, y);
}};
auto nearest_node = [&](S u, int nodes) {{ return (int)(clip(u, 0, nodes - 1) + (S)0.5); }};
auto outside = [&](S u, S v) {{ return u < 0 || v < 0 || u > (S)(K - 1) || v > (S)(R - 1); }};
const S steps[{ROWS}] = {{{", ".join(map(str, range(ROWS)))}}};
// a sum of weights below it is no weight at all
const S tiny = sizeof(S) == 4 ? (S)1e-37 : (S)1e-300;
"""

_RADIAL = """
auto radial = [&](auto shape, auto slope, S constant) {
    // windows of L points in lanes: one by one their dependent steps took a fifth of a splat
    int starts[L], vectors[L], lows[L], highs[L];
    S away_x[L], away_y[L];
    V columns;
    S to_column, to_row;  // from the point to the first column and row of its window
    auto prepare = [&]() {
        to_grid();
        V u = *(const V*)xs, v = *(const V*)ys;
        const auto valid = (u - u == 0) & (v - v == 0);
        auto bound = [&](V w, S nodes) {
            w = valid ? w : zero - hs - 2;
            return __builtin_elementwise_min(__builtin_elementwise_max(w, zero - hs - 2), zero + nodes + hs + 1);
        };
        u = bound(u, K);
        v = bound(v, R);
        auto first = [&](V w) {
            return __builtin_elementwise_max(__builtin_convertvector(__builtin_elementwise_ceil(w - hs), I), (I)0);
        };
        auto last = [&](V w, int nodes) {
            const I end = __builtin_convertvector(__builtin_elementwise_floor(w + hs), I);
            return __builtin_elementwise_min(end, (I)(nodes - 1));
        };
        const I c0 = first(u), c1 = last(u, K), low = first(v), high = last(v, R);
        const I count = (c1 - c0 + L) / L;  // 0 or less where there is no column
        const I right = __builtin_elementwise_max(K - count * L, (I)0);
        const I start = __builtin_elementwise_min(c0, right);
        *(I*)starts = start;
        *(I*)vectors = count;
        *(I*)lows = low;
        *(I*)highs = high;
        *(V*)away_x = __builtin_convertvector(start, V) - u;
        *(V*)away_y = __builtin_convertvector(low, V) - v;
    };
    auto offset = [&](int v) { return iota + (to_column + (S)(v * L)); };
    auto place = [&](int j) {
        r0 = lows[j];
        r1 = highs[j];
        nv = vectors[j];
        if (nv < 1 || r1 < r0) return false;
        a = starts[j];
        one = nv == 1 && a + L <= K && r1 - r0 < ROW_LIMIT;
        to_column = away_x[j];
        to_row = away_y[j];
        columns = offset(0);
        columns = columns * columns * inv_h2;
        return true;
    };
    auto first_weight = [&](int r) {
        const S dy = to_row + steps[r - r0];
        return shape(columns + dy * dy * inv_h2);
    };
    auto weight = [&](int r, int v) {
        const V dx = offset(v);
        const S dy = to_row + (S)(r - r0);
        return within(shape(dx * dx * inv_h2 + dy * dy * inv_h2), v);
    };
    auto gradient = [&](int r, int v, V& gx, V& gy) {
        const V dx = offset(v);
        const S dy = to_row + (S)(r - r0);
        const V s = within(slope(dx * dx * inv_h2 + dy * dy * inv_h2), v) * -inv_h2;
        gx = s * dx;
        gy = s * dy;
    };
    run(prepare, place, first_weight, weight, gradient, normalize == 0 ? constant / (h * h) : (S)0, false);
};
"""

_SEPARABLE = """
auto separable = [&](auto axis) {
    S wy[4], sy[4];
    V wx, sx;
    auto prepare = to_grid;
    auto place = [&](int j) {
        S w[4] = {0, 0, 0, 0}, s[4] = {0, 0, 0, 0};
        int c0, n;
        x = xs[j];
        y = ys[j];
        if (!is_finite(x, y)) return false;
        axis(y, R, r0, n, wy, sy);
        r1 = r0 + n - 1;
        axis(x, K, c0, n, w, s);
        slide(c0, c0 + n - 1);
        wx = zero;
        sx = zero;
        for (int k = 0; k < n; ++k) { wx[c0 - a + k] = w[k]; sx[c0 - a + k] = s[k]; }
        return true;
    };
    auto first_weight = [&](int r) { return wx * wy[r - r0]; };
    auto weight = [&](int r, int v) { return wx * wy[r - r0]; };
    auto gradient = [&](int r, int v, V& gx, V& gy) {
        gx = sx * wy[r - r0];
        gy = wx * sy[r - r0];
    };
    run(prepare, place, first_weight, weight, gradient, (S)1, true);
};
// an axis of n nodes at coordinate u: first node, number of nodes, weights and their derivatives
auto linear = [&](S u, int nodes, int& first, int& n, S* w, S* s) {
    const bool out = u < 0 || u > nodes - 1;
    u = clip(u, 0, nodes - 1);
    first = (int)u;
    if (first > nodes - 2) first = nodes - 2;
    const S t = u - first;
    n = 2;
    w[0] = 1 - t; w[1] = t;
    s[0] = out ? 0 : -1; s[1] = out ? 0 : 1;
};
auto spline = [&](S u, int nodes, int& first, int& n, S* w, S* s) {
    const bool out = u < 0 || u > nodes - 1;
    u = clip(u, 0, nodes - 1);
    int i = (int)u;
    if (i > nodes - 2) i = nodes - 2;
    const S t = u - i, c = 1 - t, sixth = (S)(1.0 / 6);
    const S ww[4] = {c * c * c * sixth, (3 * t * t * t - 6 * t * t + 4) * sixth,
                     (3 * c * c * c - 6 * c * c + 4) * sixth, t * t * t * sixth};
    const S ss[4] = {c * c * (S)-0.5, (S)1.5 * t * t - 2 * t, 2 * c - (S)1.5 * c * c, t * t * (S)0.5};
    n = nodes < 4 ? nodes : 4;
    first = i - 1;
    if (first > nodes - n) first = nodes - n;
    if (first < 0) first = 0;
    for (int k = 0; k < 4; ++k) { w[k] = 0; s[k] = 0; }
    for (int k = 0; k < 4; ++k) {
        // a ghost node is the linear extrapolation of the two nodes beside it
        const int node = i - 1 + k, ghost = node < 0 ? 1 : (node > nodes - 1 ? -1 : 0);
        const int at = node + ghost - first;
        const S d = out ? 0 : ss[k];
        if (ghost == 0) { w[at] += ww[k]; s[at] += d; }
        else { w[at] += 2 * ww[k]; s[at] += 2 * d; w[at + ghost] -= ww[k]; s[at + ghost] -= d; }
    }
};
"""


def each_point(body: str) -> str:
    """``run`` with a body for each point j of at most LANES at a time: number i = at[j], coordinates xs[j], ys[j]."""
    return f"""
for (int k = begin; k < end; k += L) {{
    const int together = end - k < L ? end - k : L;
    int at[L];
    for (int j = 0; j < together; ++j) {{
        at[j] = item(k + j);
        xs[j] = P[2 * (size_t)at[j]];
        ys[j] = P[2 * (size_t)at[j] + 1];
    }}
    prepare();
    for (int j = 0; j < together; ++j) {{
{body}
    }}
}}
"""


def snippet(dtype: str, before: str, run: str, after: str = "", bilinear: str | None = None) -> str:
    """A native snippet that runs ``run`` with the weights of the stencil whose code is in ``stencil``.

    Args:
        dtype: "float32" or "float64".
        before: statements ahead of the loop.
        run: the body of ``run(prepare, place, ..., separable)``, of ``each_point``: prepare() takes the coordinates of
            LANES points from xs and ys and leaves them in spacings; place(j) finds the window of point j, or says that
            it has no nodes; weight(r, v) gives LANES weights, first_weight(r) the same where ``one`` vector holds the
            window; gradient(r, v, gx, gy) their derivatives by the point's place in spacings; constant is what weights
            are multiplied with, 0 where they are to be divided by their sum.
        after: statements behind it.
        bilinear: statements instead of ``run`` for the bilinear stencil.
    """
    cases = _radial_cases(dtype)
    cases.append(f"case {STENCILS['bilinear']}: {{ {bilinear or 'separable(linear);'} }} break;")
    cases.append(f"case {STENCILS['bspline']}: separable(spline); break;")
    choice = "\n".join(cases)
    text = f"""
#if !defined(__CUDA_ARCH__)
{SETUP}
{before}
auto run = [&](auto prepare, auto place, auto first_weight, auto weight, auto gradient, S constant, bool separable) {{
{run}
}};
{_RADIAL}
{_SEPARABLE}
switch (stencil) {{
{choice}
}}
{after}
#endif
"""
    return text.replace("ROW_LIMIT", str(ROWS)).replace("S_TYPE", {"float32": "float", "float64": "double"}[dtype])
