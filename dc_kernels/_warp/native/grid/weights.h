// The stencils. each_stencil(run) calls run(prepare, place, first_weight, weight, gradient, constant, separable) with
// the functions of the stencil of `stencil`: prepare() is for each_point; place(j) finds the window of
// point j, or says that it has no nodes; weight(r, v) gives LANES weights, first_weight(r) those where `one` vector
// holds the window; gradient(r, v, gx, gy) their derivatives by the point's place in spacings; weights are multiplied
// with constant, or divided by their sum where it is 0. Macros: the codes POLY6 ... BSPLINE, POLY6_CONSTANT ...
#if !defined(__CUDA_ARCH__)
auto radial = [&](auto run, auto shape, auto slope, Real constant) {
    // windows of LANES points in lanes: one by one their dependent steps took a fifth of a splat
    int starts[LANES], counts[LANES], lows[LANES], highs[LANES];
    Real away_x[LANES], away_y[LANES];
    Vector column_q2;
    Real to_column, to_row;  // from the point to the first column and row of its window
    auto prepare = [&]() {
        to_grid();
        Vector u = *(const Vector*)xs, v = *(const Vector*)ys;
        const auto valid = (u - u == 0) & (v - v == 0);
        auto bound = [&](Vector w, Real nodes) {
            w = valid ? w : zero - hs - 2;
            return __builtin_elementwise_min(__builtin_elementwise_max(w, zero - hs - 2), zero + nodes + hs + 1);
        };
        u = bound(u, columns);
        v = bound(v, rows);
        auto first_of = [&](Vector w) {
            const Integers begin = __builtin_convertvector(__builtin_elementwise_ceil(w - hs), Integers);
            return __builtin_elementwise_max(begin, (Integers)0);
        };
        auto last_of = [&](Vector w, int nodes) {
            const Integers end = __builtin_convertvector(__builtin_elementwise_floor(w + hs), Integers);
            return __builtin_elementwise_min(end, (Integers)(nodes - 1));
        };
        const Integers c0 = first_of(u), c1 = last_of(u, columns), low = first_of(v), high = last_of(v, rows);
        const Integers count = (c1 - c0 + LANES) / LANES;  // 0 or less where there is no column
        const Integers right = __builtin_elementwise_max(columns - count * LANES, (Integers)0);
        const Integers start = __builtin_elementwise_min(c0, right);
        *(Integers*)starts = start;
        *(Integers*)counts = count;
        *(Integers*)lows = low;
        *(Integers*)highs = high;
        *(Vector*)away_x = __builtin_convertvector(start, Vector) - u;
        *(Vector*)away_y = __builtin_convertvector(low, Vector) - v;
    };
    auto offset = [&](int v) { return iota + (to_column + (Real)(v * LANES)); };
    auto place = [&](int j) {
        r0 = lows[j];
        r1 = highs[j];
        vectors = counts[j];
        if (vectors < 1 || r1 < r0) return false;
        first = starts[j];
        one = vectors == 1 && first + LANES <= columns && r1 - r0 < WINDOW_ROWS;
        to_column = away_x[j];
        to_row = away_y[j];
        column_q2 = offset(0);
        column_q2 = column_q2 * column_q2 * inv_h2;
        return true;
    };
    auto first_weight = [&](int r) {
        const Real dy = to_row + steps[r - r0];
        return shape(column_q2 + dy * dy * inv_h2);
    };
    auto weight = [&](int r, int v) {
        const Vector dx = offset(v);
        const Real dy = to_row + (Real)(r - r0);
        return within(shape(dx * dx * inv_h2 + dy * dy * inv_h2), v);
    };
    auto gradient = [&](int r, int v, Vector& gx, Vector& gy) {
        const Vector dx = offset(v);
        const Real dy = to_row + (Real)(r - r0);
        const Vector s = within(slope(dx * dx * inv_h2 + dy * dy * inv_h2), v) * -inv_h2;
        gx = s * dx;
        gy = s * dy;
    };
    run(prepare, place, first_weight, weight, gradient,
        stencil.normalize == 0 ? constant / (stencil.h * stencil.h) : (Real)0, false);
};

// 4 x 4 nodes at most, whose weights are products of those of two axes
auto separable = [&](auto run, auto axis) {
    Real wy[4], sy[4];
    Vector wx, sx;
    auto prepare = to_grid;
    auto place = [&](int j) {
        Real w[4] = {0, 0, 0, 0}, s[4] = {0, 0, 0, 0};
        int c0, n;
        x = xs[j];
        y = ys[j];
        if (!is_finite(x, y)) return false;
        axis(y, rows, r0, n, wy, sy);
        r1 = r0 + n - 1;
        axis(x, columns, c0, n, w, s);
        slide(c0, c0 + n - 1);
        wx = zero;
        sx = zero;
        for (int k = 0; k < n; ++k) {
            wx[c0 - first + k] = w[k];
            sx[c0 - first + k] = s[k];
        }
        return true;
    };
    auto first_weight = [&](int r) { return wx * wy[r - r0]; };
    auto weight = [&](int r, int v) { return wx * wy[r - r0]; };
    auto gradient = [&](int r, int v, Vector& gx, Vector& gy) {
        gx = sx * wy[r - r0];
        gy = wx * sy[r - r0];
    };
    run(prepare, place, first_weight, weight, gradient, (Real)1, true);
};
// radial functions beyond q = 1: all but the Gaussian are 0 at 1 by themselves
auto held = [&](auto function) {
    return [&zero, function](const Vector far) -> Vector { return function(__builtin_elementwise_min(far, zero + 1)); };
};
auto cut = [&](auto function) {
    return [&zero, function](const Vector far) -> Vector {
        return far <= 1 ? function(__builtin_elementwise_min(far, zero + 1)) : zero;
    };
};
auto each_stencil_but_linear = [&](auto run, auto run_linear) {
    switch (stencil.kernel) {
        case POLY6:
            radial(run, held(poly6_w), held(poly6_f), (Real)POLY6_CONSTANT);
            break;
        case SPIKY:
            radial(run, held(spiky_w), held(spiky_f), (Real)SPIKY_CONSTANT);
            break;
        case GAUSSIAN:
            radial(run, cut(gaussian_w), cut(gaussian_f), (Real)GAUSSIAN_CONSTANT);
            break;
        case CUBIC:
            radial(run, held(cubic_w), held(cubic_f), (Real)CUBIC_CONSTANT);
            break;
        case WENDLAND:
            radial(run, held(wendland_w), held(wendland_f), (Real)WENDLAND_CONSTANT);
            break;
        case BILINEAR:
            run_linear();
            break;
        case BSPLINE:
            separable(run, spline);
            break;
    }
};
auto each_stencil = [&](auto run) { each_stencil_but_linear(run, [&]() { separable(run, linear); }); };
#endif
