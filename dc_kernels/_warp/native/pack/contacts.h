// Rows of the contacts of world w, SIDE of a colour side by side; the sum of the squared impulses that would
// stop each of them alone [(N s)^2], every LANES-th added up first. Empty lanes of a colour's last block are zero and
// point at the padding body. What a row holds is said in solve/constraints/contact.py. Parameters: config, model,
// state, motion, contacts, rows, w, padding_body, team. Macros: those of solve/row.h, BAUMGARTE, OPEN, COLORS. Stands
// behind runtime/ranges.h, predicted.h, solve/bodies.h and side.h, and surface.h where SURFACES is 1.
auto inverse_or_zero = [=](Number x) { return pick(x > 0, (Real)1 / x, zero); };
const Real* const normals = (const Real*)contacts.normal.data;
const Real* const arms_a = (const Real*)contacts.arm_a.data;
const Real* const arms_b = (const Real*)contacts.arm_b.data;
const Real* const velocity_before = (const Real*)state.velocity.data;
const Real* const spin_before = state.angular_velocity.data;
const Real* const inv_inertia = model.inv_inertia.data;
#if SURFACES
const bool changed_speeds = rows.surface_speed.shape[0] > 0;  // by a user, contact by contact
#endif
#if OWN
const Real* const stiff_inertia = rows.stiff_inertia.data;
#endif
const Real* const gaps = contacts.gap.data;
const Real* const frictions = contacts.friction.data;
const Real* const restitutions = contacts.restitution.data;
const int* const bodies_a = contacts.body_a.data;
const int* const bodies_b = contacts.body_b.data;
Real* const square = rows.square.data;
const Real step = motion.step_dt.data[w], per_step = (Real)1 / step, size = model.length_scale.data[w];
const Real slop = config.slop * size, limit = config.max_correction * size;
const Real factor = config.position_factor;
const bool baumgarte = config.position_correction == BAUMGARTE;
const auto gravity = model.gravity.data[w];
const Real pull = wp::sqrt(gravity[0] * gravity[0] + gravity[1] * gravity[1]);
const Real hardly = config.restitution_threshold * wp::sqrt(pull * size);

// Columns of the rows of SIDE contacts, and their bodies. It holds copies: what another thread is given by its address
// would be read anew after each store.
auto fill = [=](const int* c, Real* to, int* between) {
    int a[SIDE], b[SIDE];
    for (int i = 0; i < SIDE; ++i) {
        between[i] = a[i] = bodies_a[c[i]];
        between[LANES + i] = b[i] = bodies_b[c[i]];
    }
    Number nx, ny, ax, ay, bx, by;
    pairs_at(normals, c, nx, ny);
    pairs_at(arms_a, c, ax, ay);
    pairs_at(arms_b, c, bx, by);
    const Bodies A = load_bodies(a), B = load_bodies(b);
    Number iA = values_at(inv_inertia, a), iB = values_at(inv_inertia, b);
#if OWN
    iA = iA / ((Real)1 + iA * values_at(stiff_inertia, a));
    iB = iB / ((Real)1 + iB * values_at(stiff_inertia, b));
#endif
    const Number rAt = ax * -nx - ay * ny, rBt = bx * -nx - by * ny;
#if DISCS
    const Number en = inverse_or_zero(A.m + B.m);
#else
    const Number rAn = ax * ny - ay * nx, rBn = bx * ny - by * nx;
    const Number en = inverse_or_zero(A.m + B.m + iA * rAn * rAn + iB * rBn * rBn);
#endif
    const Number et = inverse_or_zero(A.m + B.m + iA * rAt * rAt + iB * rBt * rBt);
    auto along_normal = [&](Number x, Number y, Number wA, Number wB) {
#if DISCS
        return nx * x + ny * y;
#else
        return (nx * x + ny * y) + (rBn * wB - rAn * wA);
#endif
    };
    const Number x = B.x - A.x, y = B.y - A.y;
    const Number un = along_normal(x, y, A.w, B.w), ut = (ny * x + -nx * y) + (rBt * B.w - rAt * A.w);
    const Number gap = values_at(gaps, c), e = values_at(restitutions, c);
    Number bias = pick(gap > slop, gap * per_step, zero), counted = zero + (Real)1;
    if (baumgarte) bias = pick(gap < -slop, larger(factor * (gap + slop), zero - limit) * per_step, bias);
    if (any(e > 0)) {
        Number vAx, vAy, vBx, vBy;
        pairs_at(velocity_before, a, vAx, vAy);
        pairs_at(velocity_before, b, vBx, vBy);
        const Number wA = values_at(spin_before, a), wB = values_at(spin_before, b);
        const Number before = along_normal(vBx - vAx, vBy - vAy, wA, wB), after = e * before;
        const Number threshold = pick(e < 1, zero + hardly, zero);
        const Number bounce = pick(before < -threshold, smaller(bias, after), bias);
        const Number closed = pick(before > 0, larger(bias, after), bounce);
        const auto open = (gap > slop) & (gap + un * step >= 0) & (e > 0);
        bias = pick(open, (Real)OPEN * gap * per_step, pick(e > 0, closed, bias));
        counted = pick(open, zero, counted);
    }
    store(to + AT_nx, nx);
    store(to + AT_ny, ny);
#if DISCS
    store(to + AT_dA, -rAt);
    store(to + AT_dB, rBt);
    store(to + AT_kA, -(iA * rAt));
    store(to + AT_kB, iB * rBt);
#else
    store(to + AT_rAn, rAn);
    store(to + AT_rBn, rBn);
    store(to + AT_rAt, rAt);
    store(to + AT_rBt, rBt);
    store(to + AT_iA, iA);
    store(to + AT_iB, iB);
#endif
    store(to + AT_en, en);
    store(to + AT_et, et);
    store(to + AT_bias, bias);
    store(to + AT_mu, values_at(frictions, c));
    store(to + AT_gap, gap + slop);
#if JOINTS
    store(to + AT_lo, zero);
#endif
#if OWN
    store(to + AT_hi, zero + (Real)INFINITY);
    store(to + AT_ax, nx);
    store(to + AT_ay, ny);
    store(to + AT_soft, zero);
    store(to + AT_held, zero + (Real)1);
#endif
    Real alone[SIDE];
#if SURFACES
    const int order[] = {0, 1, 2, 3, 4, 5, 6, 7};
    Real slips[SIDE];
    for (int i = 0; i < SIDE; ++i) slips[i] = changed_speeds ? -rows.surface_speed.data[c[i]] : slip_of(c[i]);
    const Number slip = values_at(slips, order), along = ut + slip;
    store(to + AT_slip, slip);
    store(to + AT_roll, zero);
#else
    const Number along = ut;
#endif
    store(alone, counted * ((en * (un + bias)) * (en * (un + bias)) + (en * along) * (en * along)));
    for (int i = 0; i < SIDE; ++i) square[c[i]] = alone[i];
};

const int i0 = contacts.contact_start.data[w], i1 = i0 + contacts.contact_count.data[w];
const int* const color = contacts.color.data;
int* const slot = rows.slot.data;
int* const ends = rows.body.data;
Real* const columns = rows.column.data;
const int* const first = rows.color_block.data + (size_t)w * (COLORS + 1);
int* const filled = rows.color_fill.data + (size_t)w * COLORS;
#if defined(__CUDA_ARCH__)
for (int c = i0; c < i1; ++c) {
    const int k = color[c], row = filled[k]++, block = first[k] + row / LANES, lane = row % LANES;
    const int at = block * 2 * LANES + lane;
    slot[c] = at;
    fill(&c, columns + (size_t)block * COLUMNS * LANES + lane, ends + at);
}
#else
// a block's contacts stand where its bodies A then do, those of CHUNK contacts before the rows of any: while the caches
// hold them, and without a branch that is guessed wrong once a block
const int CHUNK = 256;
auto fill_block = [=](int block) {
    int* const between = ends + (size_t)block * 2 * LANES;
    int c[LANES];
    for (int i = 0; i < LANES; ++i) c[i] = between[i];
    fill(c, columns + (size_t)block * COLUMNS * LANES, between);
};
// Places and rows of the contacts c0 .. c1, where `next` counts the rows of each colour that have a place before them;
// rows of blocks that are not full, and of the first `done` blocks of each colour, are left out.
auto place_and_fill = [=](int c0, int c1, int* next, int* done) {
    int used = 0;
    for (int begin = c0; begin < c1; begin += CHUNK) {
        const int end = begin + CHUNK < c1 ? begin + CHUNK : c1;
        for (int c = begin; c < end; ++c) {
            const int k = color[c];
            const unsigned row = next[k]++, at = (first[k] + row / LANES) * 2 * LANES + row % LANES;
            slot[c] = at;
            ends[at] = c;
            used = k > used ? k : used;
        }
        for (int k = 0; k <= used; ++k)
            for (; done[k] < next[k] / LANES; ++done[k]) fill_block(first[k] + done[k]);
    }
    return used;
};
int used = 0;
Team* const members = (Team*)team;
if (!members || members->counted == 0) {
    int done[COLORS] = {};
    used = place_and_fill(i0, i1, filled, done);
} else {
    // threads know the places of their own contacts, as pack/lay_out.h has counted the colours in all shares; rows are
    // made by who sweeps most of them, and has them in its caches then
    const int parts = members->counted;
    const auto* const count = members->count;
    auto begin_of = [=](int p) { return Share::begin(members, i0, i1, p, parts); };
    auto fill_share = [=](int p) {
        int next[COLORS] = {}, done[COLORS];  // blocks that the contacts of shares before are in
        for (int q = 0; q < p; ++q)
            for (int k = 0; k < COLORS; ++k) next[k] += count[q][k];
        for (int k = 0; k < COLORS; ++k) done[k] = (next[k] + LANES - 1) / LANES;
        place_and_fill(begin_of(p), begin_of(p + 1), next, done);
    };
    Phases phases;
    phases.first[0] = 0;
    phases.add(parts, parts, 1);
    take_phases(members, phases, [=](int from, int to) {
        for (int p = from; p < to; ++p) fill_share(p);
        return 0.0;
    });
    for (int p = 0; p < parts; ++p) {
        for (int k = 0; k < COLORS; ++k) {
            if (count[p][k] == 0) continue;
            const int begin = filled[k], inside = begin / LANES;
            filled[k] += count[p][k];
            used = k > used ? k : used;
            if (begin % LANES > 0 && filled[k] / LANES > inside) fill_block(first[k] + inside);
        }
    }
}
const Vector order = {0, 1, 2, 3, 4, 5, 6, 7};
for (int k = 0; k <= used; ++k) {
    const int lanes = filled[k] % LANES, block = first[k] + filled[k] / LANES;
    if (lanes == 0) continue;
    int* const between = ends + (size_t)block * 2 * LANES;
    int c[LANES];
    for (int i = 0; i < LANES; ++i) c[i] = between[i < lanes ? i : 0];
    const auto full = order < (Real)lanes;
    // by way of the stack: zeros stored between what stands there take masked stores (15 cycles each, Zen 3)
    Real all[COLUMNS * LANES];
    fill(c, all, between);
    Real* const column = columns + (size_t)block * COLUMNS * LANES;
    for (int n = 0; n < COLUMNS; ++n) store(column + n * LANES, pick(full, load(all + n * LANES), zero));
    for (int i = lanes; i < LANES; ++i) between[i] = between[LANES + i] = padding_body;
}
#endif
#if !defined(__CUDA_ARCH__)
if (members) {
    // contacts are sorted by body A, one that does not move in front or behind: so are the blocks of each colour
    const Real* const given = (const Real*)bodies.data;
    auto is_fixed = [=](int block) { return given[4 * (size_t)ends[(size_t)block * 2 * LANES] + 3] == 0; };
    for (int k = 0; k < COLORS; ++k) {
        int low = first[k], high = k <= used ? first[k] + (filled[k] + LANES - 1) / LANES : low;
        const bool fixed = low < high && is_fixed(low);
        while (low < high) {
            const int middle = (low + high) / 2;
            if (is_fixed(middle) == fixed)
                low = middle + 1;
            else
                high = middle;
        }
        members->split[k] = low - first[k];
    }
}
#endif
// every LANES-th, and then those sums: one after the other, each would wait for the one before
Real sum = 0, sums[LANES] = {};
int c = i0;
#if !defined(__CUDA_ARCH__)
Vector added = zero;
for (; c + LANES <= i1; c += LANES) added = added + load(square + c);
store(sums, added);
#endif
for (int lane = 0; c < i1; ++c, lane = (lane + 1) % LANES) sums[lane] += square[c];
for (int lane = 0; lane < LANES; ++lane) sum += sums[lane];
return sum;
