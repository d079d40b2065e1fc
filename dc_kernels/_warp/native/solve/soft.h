// A sweep of soft contacts and joints over the blocks of some colours; the largest impulse change [N s]. Each
// row has its bias from the gap after the displacements so far, to first order in them. Parameters: columns, row_body,
// bodies, displacement, impulse, before, ends, colors, soft: rate of the bias [1/s], share of the mass, share of the
// impulse that is given back, for contacts of two moving bodies, for those with a fixed one, and for joints; then
// substeps a second, the slop, the largest bias [m/s], and 1 where the sweep relaxes the rows. Macro TOUCH: share of
// the slop that an overlap must exceed to be soft.
#if defined(__CUDA_ARCH__)
return 0;  // a GPU solves row by row
#else
const Real per_step = soft[9], slop = soft[10], limit = soft[11];
const Real* const moved = (const Real*)displacement.data;
Vector most = zero;
take_blocks(ends, colors, [&](auto& some) {
    EACH_BLOCK {
        const int* const index = of.index;
        const Real* const block = of.column;
        const Bodies &A = of.A, &B = of.B;
        const Row& row = of.row;
        const Bodies moved_a = load_from(moved, index), moved_b = load_from(moved, index + LANES);
        // gap plus slop, or what a joint is off by
        const Vector off = load(block + AT_gap) + normal_speed(row, moved_a, moved_b), gap = off - slop;
        const auto fixed = (A.m <= zero) | (B.m <= zero), hard = gap > (Real)-TOUCH * slop;
        Vector rate = fixed ? zero + soft[3] : zero + soft[0], mass = fixed ? zero + soft[4] : zero + soft[1];
        Vector give = fixed ? zero + soft[5] : zero + soft[2];
        Vector bias = hard ? larger(gap, zero) * per_step : larger(rate * smaller(off, zero), zero - limit);
        mass = hard ? zero + (Real)1 : mass;
        give = hard ? zero : give;
        const Vector ln0 = load(impulse.data + of.at);
#if OWN
        const auto joint = load(block + AT_et) <= zero;
        if (__builtin_reduce_or(joint)) {
            const Vector low = load(block + AT_lo), high = load(block + AT_hi), yield = load(block + AT_soft);
            // a spring meets in both sweeps what it was off by when the substep began
            Real* const start = before.data + of.at;
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
        of.ln = within(block, ln0 - ((load(block + AT_en) * mass) * (vn + bias) + give * ln0));
        of.dn = of.ln - ln0;
    }
    EACH_BLOCK {
        const Vector lt0 = load(impulse.data + of.at + LANES);
        const Vector vt = tangent_speed_after(of.row, of.A, of.B, of.dn);
        of.lt = clamp(lt0 - load(of.column + AT_et) * vt, load(of.column + AT_mu) * of.ln);
        of.dt = of.lt - lt0;
    }
    EACH_BLOCK apply_both(of.row, of.A, of.B, of.dn, of.dt);
    EACH_BLOCK {
        store(impulse.data + of.at, of.ln);
        store(impulse.data + of.at + LANES, of.lt);
        most = larger(magnitude(of.dn), larger(magnitude(of.dt), most));
    }
});
return largest(most);
#endif
