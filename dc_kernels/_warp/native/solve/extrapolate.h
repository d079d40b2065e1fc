// Impulses of the blocks first .. last moved on along their change, x <- clamp(x + alpha change); change is then what
// they moved by, and where FOLLOW is 1 the velocities of the lanes' bodies follow it. Parameters: columns, row_body,
// bodies, impulse, change, first, last, alpha. Stands behind prelude.h, bodies.h and row.h.
for (int b = first; b < last; ++b) {
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
    const Vector dn = yn - xn, dt = yt - xt;
    store(d, dn);
    store(d + LANES, dt);
#if FOLLOW
    const int* const index = row_body.data + (size_t)b * 2 * LANES;
    Bodies A = load_bodies(index), B = load_bodies(index + LANES);
    const Row row = load_row(block);
    apply_normal(row, A, B, dn);
    apply_tangent(row, A, B, dt);
    store_bodies(index, A);
    store_bodies(index + LANES, B);
#endif
#endif
}
