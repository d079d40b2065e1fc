// Impulses moved on along their change, x <- clamp(x + alpha change); change is then what they moved by. Where FOLLOW
// is 1 these are the blocks of some colours, and the velocities of the lanes' bodies follow; else the blocks first ..
// last. Parameters: columns, row_body, bodies, impulse, change, ends, colors, or first, last, alpha. Stands behind
// prelude.h, bodies.h, row.h, take_blocks.h.
#if defined(__CUDA_ARCH__)
#if !FOLLOW
for (int b = first; b < last; ++b) {
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
        yt = yt < limit ? yt : limit;
        yt = -limit > yt ? -limit : yt;
        impulse.data[n] = yn;
        impulse.data[t] = yt;
        change.data[n] = yn - xn;
        change.data[t] = yt - xt;
    }
}
#endif
#else
auto move = [&](const Real* column, size_t at, Vector& ln, Vector& lt, Vector& dn, Vector& dt) {
    const Vector ln0 = load(impulse.data + at), lt0 = load(impulse.data + at + LANES);
    ln = larger(ln0 + alpha * load(change.data + at), JOINTS ? load(column + AT_lo) : zero);
#if OWN
    ln = smaller(ln, load(column + AT_hi));
#endif
    lt = clamp(lt0 + alpha * load(change.data + at + LANES), load(column + AT_mu) * ln);
    dn = ln - ln0;
    dt = lt - lt0;
};
auto keep = [&](size_t at, Vector ln, Vector lt, Vector dn, Vector dt) {
    store(impulse.data + at, ln);
    store(impulse.data + at + LANES, lt);
    store(change.data + at, dn);
    store(change.data + at + LANES, dt);
};
#if FOLLOW
take_blocks(ends, colors, [&](auto& some) {
    EACH_BLOCK move(of.column, of.at, of.ln, of.lt, of.dn, of.dt);
    EACH_BLOCK apply_both(of.row, of.A, of.B, of.dn, of.dt);
    EACH_BLOCK keep(of.at, of.ln, of.lt, of.dn, of.dt);
});
#else
for (int b = first; b < last; ++b) {
    const size_t at = (size_t)b * 2 * LANES;
    Vector ln, lt, dn, dt;
    move(columns.data + (size_t)b * COLUMNS * LANES, at, ln, lt, dn, dt);
    keep(at, ln, lt, dn, dt);
}
#endif
#endif
