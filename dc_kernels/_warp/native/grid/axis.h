// Weights of the nodes of one axis, by the coordinate of a point in spacings: bilinear, and cubic B-spline.
#if !defined(__CUDA_ARCH__)
auto clip = [](Real v, Real low, Real high) { return v < low ? low : (v > high ? high : v); };
// an axis of n nodes at coordinate u: first node, number of nodes, weights and their derivatives
auto linear = [&](Real u, int nodes, int& begin, int& n, Real* w, Real* s) {
    const bool out = u < 0 || u > nodes - 1;
    u = clip(u, 0, nodes - 1);
    begin = (int)u;
    if (begin > nodes - 2) begin = nodes - 2;
    const Real t = u - begin;
    n = 2;
    w[0] = 1 - t;
    w[1] = t;
    s[0] = out ? 0 : -1;
    s[1] = out ? 0 : 1;
};
auto spline = [&](Real u, int nodes, int& begin, int& n, Real* w, Real* s) {
    const bool out = u < 0 || u > nodes - 1;
    u = clip(u, 0, nodes - 1);
    int i = (int)u;
    if (i > nodes - 2) i = nodes - 2;
    const Real t = u - i, c = 1 - t, sixth = (Real)(1.0 / 6);
    const Real ww[4] = {c * c * c * sixth, (3 * t * t * t - 6 * t * t + 4) * sixth,
                        (3 * c * c * c - 6 * c * c + 4) * sixth, t * t * t * sixth};
    const Real ss[4] = {c * c * (Real)-0.5, (Real)1.5 * t * t - 2 * t, 2 * c - (Real)1.5 * c * c, t * t * (Real)0.5};
    n = nodes < 4 ? nodes : 4;
    begin = i - 1;
    if (begin > nodes - n) begin = nodes - n;
    if (begin < 0) begin = 0;
    for (int k = 0; k < 4; ++k) {
        w[k] = 0;
        s[k] = 0;
    }
    for (int k = 0; k < 4; ++k) {
        // a ghost node is the linear extrapolation of the two nodes beside it
        const int node = i - 1 + k, ghost = node < 0 ? 1 : (node > nodes - 1 ? -1 : 0);
        const int at = node + ghost - begin;
        const Real d = out ? 0 : ss[k];
        if (ghost == 0) {
            w[at] += ww[k];
            s[at] += d;
        } else {
            w[at] += 2 * ww[k];
            s[at] += 2 * d;
            w[at + ghost] -= ww[k];
            s[at + ghost] -= d;
        }
    }
};
#endif
