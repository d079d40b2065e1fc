// A sweep of soft contacts and joints over the blocks first .. last of a colour; the largest impulse change [N s]. Each
// row has its bias from the gap after the displacements so far, to first order in them. Parameters: columns, row_body,
// bodies, displacement, impulse, before, first, last, soft: rate of the bias [1/s], share of the mass, share of the
// impulse that is given back, for contacts of two moving bodies, for those with a fixed one, and for joints; then
// substeps a second, the slop, the largest bias [m/s], and 1 where the sweep relaxes the rows. Macro TOUCH: share of
// the slop that an overlap must exceed to be soft.
#if defined(__CUDA_ARCH__)
return 0;  // a GPU solves row by row
#else
const Real per_step = soft[9], slop = soft[10], limit = soft[11];
const Real* const moved = (const Real*)displacement.data;
Vector most = zero;
for (int b = first; b < last; ++b) {
    const int* const index = row_body.data + (size_t)b * 2 * LANES;
    const Real* const block = columns.data + (size_t)b * COLUMNS * LANES;
    Bodies A = load_bodies(index), B = load_bodies(index + LANES);
    const Row row = load_row(block);
    const Bodies moved_a = load_from(moved, index), moved_b = load_from(moved, index + LANES);
    // gap plus slop, or what a joint is off by
    const Vector off = load(block + AT_gap) + normal_speed(row, moved_a, moved_b), gap = off - slop;
    const auto fixed = (A.m <= zero) | (B.m <= zero), hard = gap > (Real)-TOUCH * slop;
    Vector rate = fixed ? zero + soft[3] : zero + soft[0], mass = fixed ? zero + soft[4] : zero + soft[1];
    Vector give = fixed ? zero + soft[5] : zero + soft[2];
    Vector bias = hard ? larger(gap, zero) * per_step : larger(rate * smaller(off, zero), zero - limit);
    mass = hard ? zero + (Real)1 : mass;
    give = hard ? zero : give;
    Real* const x = impulse.data + (size_t)b * 2 * LANES;
    const Vector ln0 = load(x), lt0 = load(x + LANES);
#if OWN
    const auto joint = load(block + AT_et) <= zero;
    if (__builtin_reduce_or(joint)) {
        const Vector low = load(block + AT_lo), high = load(block + AT_hi), yield = load(block + AT_soft);
        // a spring meets in both sweeps what it was off by when the substep began
        Real* const start = before.data + (size_t)b * 2 * LANES;
        const Vector then = soft[12] > 0 ? load(start) : off;
        store(start, then);
        const auto held = load(block + AT_held) > zero;
        const auto rigid = (low < -(Real)UNBOUNDED) & (high > (Real)UNBOUNDED);
        const auto open = ~rigid & (low < zero ? off < zero : off > zero);  // within its range
        const auto drawn = held & ~open;
        const Vector own = load(block + AT_bias);
        Vector aim = yield > zero ? own * then + yield * ln0 : own;
        aim = held ? (open ? off * per_step : clamp((Real)soft[6] * off, zero + limit)) : aim;
        bias = joint ? aim : bias;
        mass = joint ? (drawn ? zero + soft[7] : zero + (Real)1) : mass;
        give = joint ? (drawn ? zero + soft[8] : zero) : give;
    }
#elif JOINTS
    const auto rod = load(block + AT_lo) < zero;
    bias = rod ? clamp((Real)soft[6] * off, zero + limit) : bias;
    mass = rod ? zero + soft[7] : mass;
    give = rod ? zero + soft[8] : give;
#endif
    const Vector vn = normal_speed(row, A, B);
    const Vector ln = within(block, ln0 - ((load(block + AT_en) * mass) * (vn + bias) + give * ln0));
    const Vector dn = ln - ln0;
    apply_normal(row, A, B, dn);
    const Vector vt = tangent_speed(row, A, B);
    const Vector lt = clamp(lt0 - load(block + AT_et) * vt, load(block + AT_mu) * ln);
    const Vector dt = lt - lt0;
    apply_tangent(row, A, B, dt);
    store(x, ln);
    store(x + LANES, lt);
    most = larger(most, larger(magnitude(dn), magnitude(dt)));
    store_bodies(index, A);
    store_bodies(index + LANES, B);
}
return largest(most);
#endif
