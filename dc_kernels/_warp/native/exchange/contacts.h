// The contacts i0 .. i1 of a world with the bodies b0 .. b1, as its owner gives them: arms from points, where there are
// some, colours that are kept, and how many contacts are out of range. In loops of native code, each of which the
// compiler makes lanes of: Warp would load pointers and strides anew for each value.
// Parameters: contacts, point, kept, position, inv_inertia, discs, i0, i1, b0, b1.
// Macros: REAL, UNIT, ARM.
const int* const a = contacts.body_a.data;
const int* const b = contacts.body_b.data;
int bad = 0;
for (int i = i0; i < i1; ++i) bad += (a[i] == b[i]) | (a[i] < b0) | (a[i] >= b1) | (b[i] < b0) | (b[i] >= b1);
if (bad) return bad;
int* const color = contacts.color.data;
if (kept.shape[0] > 0) {
    for (int i = i0; i < i1; ++i) color[i] = kept.data[i];
} else {
    for (int i = i0; i < i1; ++i) color[i] = -1;
}
auto* const p = contacts.arm_a.data;
auto* const q = contacts.arm_b.data;
if (point.shape[0] > 0) {
    const auto* const x = position.data;
    for (int i = i0; i < i1; ++i) {
        const auto at = point.data[i];
        p[i] = wp::sub(at, x[a[i]]);
        q[i] = wp::sub(at, x[b[i]]);
    }
}
const auto* const normal = contacts.normal.data;
const REAL* const gap = contacts.gap.data;
const REAL* const friction = contacts.friction.data;
const REAL* const restitution = contacts.restitution.data;
for (int i = i0; i < i1; ++i) {
    const REAL mu = friction[i], e = restitution[i];
    // 0 x is 0 for a finite x, NaN for inf and NaN
    const REAL finite =
        (REAL)0 * p[i][0] + (REAL)0 * p[i][1] + (REAL)0 * q[i][0] + (REAL)0 * q[i][1] + (REAL)0 * gap[i] + (REAL)0 * mu;
    const REAL off = normal[i][0] * normal[i][0] + normal[i][1] * normal[i][1] - (REAL)1;
    const bool good = (finite == 0) & (off >= -(REAL)UNIT) & (off <= (REAL)UNIT) & (mu >= 0) & (e >= 0) & (e <= 1);
    bad += !good;
}
if (discs) {
    const REAL most = (REAL)ARM * (REAL)ARM;
    auto bent = [&](int i, const auto& arm) {
        const REAL bend = arm[0] * normal[i][1] - arm[1] * normal[i][0];
        return bend * bend > most * (arm[0] * arm[0] + arm[1] * arm[1]);
    };
    int some = 0;
    for (int i = i0; i < i1; ++i) some += bent(i, p[i]) | bent(i, q[i]);
    // the arm of a body that nothing turns may be any, as that of the ground is
    for (int i = i0; some && i < i1; ++i) {
        bad += inv_inertia.data[a[i]] > 0 && bent(i, p[i]);
        bad += inv_inertia.data[b[i]] > 0 && bent(i, q[i]);
    }
}
return bad;
