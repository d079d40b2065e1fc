// What a row's columns do to the velocities of its bodies. Macros: DISCS, JOINTS, OWN, SURFACES, COLUMNS, and AT_name
// for each column's place in a block.
#if !defined(__CUDA_ARCH__)
struct Row {
    Vector nx, ny;
    Vector ax, ay;  // of body A, whose row may be along another direction than B's; else nx, ny
#if DISCS
    Vector dA, dB, kA, kB;
#else
    Vector rAn, rBn, rAt, rBt, iA, iB;
#endif
#if SURFACES
    Vector slip;
#endif
};
auto load_row = [&](const Real* block) {
    Row row;
    row.nx = load(block + AT_nx);
    row.ny = load(block + AT_ny);
#if OWN
    row.ax = load(block + AT_ax);
    row.ay = load(block + AT_ay);
#else
    row.ax = row.nx;
    row.ay = row.ny;
#endif
#if DISCS
    row.dA = load(block + AT_dA);
    row.dB = load(block + AT_dB);
    row.kA = load(block + AT_kA);
    row.kB = load(block + AT_kB);
#else
    row.rAn = load(block + AT_rAn);
    row.rBn = load(block + AT_rBn);
    row.rAt = load(block + AT_rAt);
    row.rBt = load(block + AT_rBt);
    row.iA = load(block + AT_iA);
    row.iB = load(block + AT_iB);
#endif
#if SURFACES
    row.slip = load(block + AT_slip);
#endif
    return row;
};
auto normal_speed = [&](const Row& row, const Bodies& a, const Bodies& b) {
#if OWN
    Vector speed = (row.nx * b.x - row.ax * a.x) + (row.ny * b.y - row.ay * a.y);
#else
    Vector speed = row.nx * (b.x - a.x) + row.ny * (b.y - a.y);
#endif
#if !DISCS
    speed = speed + (row.rBn * b.w - row.rAn * a.w);
#endif
    return speed;
};
auto tangent_speed = [&](const Row& row, const Bodies& a, const Bodies& b) {
    const Vector speed = row.ny * (b.x - a.x) - row.nx * (b.y - a.y);
#if DISCS
    return speed + (row.dB * b.w + row.dA * a.w);
#elif SURFACES
    return speed + (row.rBt * b.w - row.rAt * a.w) + row.slip;
#else
    return speed + (row.rBt * b.w - row.rAt * a.w);
#endif
};
// What it is after a normal impulse, from what it was: nothing waits for the bodies' new velocities, which is 10 % of a
// small world's sweep. A disc's normal impulse has no tangential effect.
auto tangent_speed_after = [&](const Row& row, const Bodies& a, const Bodies& b, Vector normal) {
#if DISCS
    return tangent_speed(row, a, b);
#else
    const Vector mixed = row.iA * row.rAn * row.rAt + row.iB * row.rBn * row.rBt;  // along t by a unit along n [1/kg]
    return tangent_speed(row, a, b) + mixed * normal;
#endif
};
auto apply_normal = [&](const Row& row, Bodies& a, Bodies& b, Vector impulse) {
    a.x -= a.m * (row.ax * impulse);
    a.y -= a.m * (row.ay * impulse);
    b.x += b.m * (row.nx * impulse);
    b.y += b.m * (row.ny * impulse);
#if !DISCS
    a.w -= row.iA * (row.rAn * impulse);
    b.w += row.iB * (row.rBn * impulse);
#endif
};
// An impulse along the normal and one along the tangent: 8 operations fewer than one after the other, 4 % of a sweep.
auto apply_both = [&](const Row& row, Bodies& a, Bodies& b, Vector normal, Vector tangent) {
    const Vector qx = row.ny * tangent, qy = row.nx * tangent;
    a.x -= a.m * (row.ax * normal + qx);
    a.y -= a.m * (row.ay * normal - qy);
    b.x += b.m * (row.nx * normal + qx);
    b.y += b.m * (row.ny * normal - qy);
#if DISCS
    a.w += row.kA * tangent;
    b.w += row.kB * tangent;
#else
    a.w -= row.iA * (row.rAn * normal + row.rAt * tangent);
    b.w += row.iB * (row.rBn * normal + row.rBt * tangent);
#endif
};
// The least normal impulse: 0 of a contact, minus infinity of a joint.
auto least = [&](const Real* block) {
#if JOINTS
    return load(block + AT_lo);
#else
    return Vector((Real)0);
#endif
};
// Impulses along the normal within their bounds.
auto within = [&](const Real* block, Vector impulse) {
    const Vector bounded = larger(impulse, least(block));
#if OWN
    return smaller(bounded, load(block + AT_hi));
#else
    return bounded;
#endif
};
// What the normal speed is to be zero with: the bias, and what a soft row gives way by for its impulse.
auto bias = [&](const Real* block, Vector impulse) {
#if OWN
    return load(block + AT_bias) + load(block + AT_soft) * impulse;
#else
    return load(block + AT_bias);
#endif
};
#endif
