// Impulses of the blocks b0 .. b1 moved on along their change, x <- clamp(x + alpha change); change is then what they
// moved by. Parameters: columns, impulse, change, b0, b1, alpha. Macros: JOINTS, OWN, COLUMNS, AT_mu, AT_lo, AT_hi.
for (int b = b0; b < b1; ++b) {
#if defined(__CUDA_ARCH__)
    for (int lane = 0; lane < LANES; ++lane) {
        const int n = b * 2 * LANES + lane, t = n + LANES;
        const Real* const block = columns.data + (size_t)b * COLUMNS * LANES + lane;
        const Real low = JOINTS ? block[AT_lo] : 0;
        const Real xn = impulse.data[n], xt = impulse.data[t];
        Real yn = xn + alpha * change.data[n];
        yn = yn > low ? yn : low;
        if (OWN) yn = yn < block[AT_hi] ? yn : block[AT_hi];
        const Real limit = block[AT_mu] * yn;
        Real yt = xt + alpha * change.data[t];
        yt = yt > -limit ? yt : -limit;
        yt = yt < limit ? yt : limit;
        impulse.data[n] = yn;
        impulse.data[t] = yt;
        change.data[n] = yn - xn;
        change.data[t] = yt - xt;
    }
#else
    const Real* const block = columns.data + (size_t)b * COLUMNS * LANES;
    Real* const x = impulse.data + (size_t)b * 2 * LANES;
    Real* const d = change.data + (size_t)b * 2 * LANES;
    const Vector low = JOINTS ? load(block + AT_lo) : zero;
    const Vector xn = load(x), xt = load(x + LANES);
    Vector yn = larger(xn + alpha * load(d), low);
#if OWN
    yn = smaller(yn, load(block + AT_hi));
#endif
    const Vector yt = clamp(xt + alpha * load(d + LANES), load(block + AT_mu) * yn);
    store(x, yn);
    store(x + LANES, yt);
    store(d, yn - xn);
    store(d + LANES, yt - xt);
#endif
}
