// The contacts i0 .. i1 of a world with the bodies b0 .. b1, as its owner gives them: arms from points, where there are
// some, colours that are kept, and how many contacts are out of range. In one loop of native code: Warp would load
// pointers and strides anew for each value.
// Parameters: contacts, point, kept, position, inv_inertia, discs, i0, i1, b0, b1.
// Macros: REAL, UNIT, ARM.
const bool points = point.shape[0] > 0;
if (kept.shape[0] > 0) {
    for (int i = i0; i < i1; ++i) contacts.color.data[i] = kept.data[i];
} else {
    for (int i = i0; i < i1; ++i) contacts.color.data[i] = -1;
}
const auto* const x = position.data;
int bad = 0;
for (int i = i0; i < i1; ++i) {
    const int a = contacts.body_a.data[i], b = contacts.body_b.data[i];
    if (a == b || a < b0 || a >= b1 || b < b0 || b >= b1) {
        ++bad;
        continue;
    }
    if (points) {
        contacts.arm_a.data[i] = wp::sub(point.data[i], x[a]);
        contacts.arm_b.data[i] = wp::sub(point.data[i], x[b]);
    }
    const auto n = contacts.normal.data[i], p = contacts.arm_a.data[i], q = contacts.arm_b.data[i];
    const REAL mu = contacts.friction.data[i], e = contacts.restitution.data[i];
    // 0 x is 0 for a finite x, NaN for inf and NaN
    const REAL finite = (REAL)0 * p[0] + (REAL)0 * p[1] + (REAL)0 * q[0] + (REAL)0 * q[1] +
                        (REAL)0 * contacts.gap.data[i] + (REAL)0 * mu;
    const REAL off = n[0] * n[0] + n[1] * n[1] - (REAL)1;
    const bool good = (finite == 0) & (off >= -(REAL)UNIT) & (off <= (REAL)UNIT) & (mu >= 0) & (e >= 0) & (e <= 1);
    bad += !good;
    if (discs) {
        const REAL bend_a = p[0] * n[1] - p[1] * n[0], bend_b = q[0] * n[1] - q[1] * n[0];
        const REAL most = (REAL)ARM * (REAL)ARM;
        bad += inv_inertia.data[a] > 0 && bend_a * bend_a > most * (p[0] * p[0] + p[1] * p[1]);
        bad += inv_inertia.data[b] > 0 && bend_b * bend_b > most * (q[0] * q[0] + q[1] * q[1]);
    }
}
return bad;
