// The contacts i0 .. i1 of a world with the bodies b0 .. b1, as its owner gives them: arms from points, where there are
// some, colours that are kept, and whether a contact is out of range: not 0 then. LANES contacts side by side, and what
// is left of them one by one.
// Parameters: contacts, point, kept, position, inv_inertia, discs, i0, i1, b0, b1.
// Macros: REAL, LANES, UNIT, ARM. Stands behind prelude.h.
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
const bool points = point.shape[0] > 0;
const Real* const at = (const Real*)point.data;
const Real* const center = (const Real*)position.data;
Real* const p = (Real*)contacts.arm_a.data;
Real* const q = (Real*)contacts.arm_b.data;
const Real* const normal = (const Real*)contacts.normal.data;
const Real* const gap = contacts.gap.data;
const Real* const friction = contacts.friction.data;
const Real* const restitution = contacts.restitution.data;
const Real least = -(Real)UNIT, most = (Real)UNIT, bend = (Real)ARM * (Real)ARM;
int i = i0;
#if !defined(__CUDA_ARCH__)
typedef Real Pair __attribute__((ext_vector_type(2), aligned(4)));
// the points at four places, one after the other
auto pairs = [&](const Real* from, const int* k) {
    auto pair = [&](int n) { return *(const Pair*)(from + 2 * (size_t)k[n]); };
    auto two = [&](int n) { return __builtin_shufflevector(pair(n), pair(n + 1), 0, 1, 2, 3); };
    return __builtin_shufflevector(two(0), two(2), 0, 1, 2, 3, 4, 5, 6, 7);
};
auto first_of = [&](Vector u, Vector v) { return __builtin_shufflevector(u, v, 0, 2, 4, 6, 8, 10, 12, 14); };
auto second_of = [&](Vector u, Vector v) { return __builtin_shufflevector(u, v, 1, 3, 5, 7, 9, 11, 13, 15); };
auto good = zero == zero;
for (; i + LANES <= i1; i += LANES) {
    Vector finite = (Real)0 * load(gap + i) + (Real)0 * load(friction + i);
    const Vector n0 = load(normal + 2 * i), n1 = load(normal + 2 * i + LANES);
    const Vector nx = first_of(n0, n1), ny = second_of(n0, n1), off = nx * nx + ny * ny - (Real)1;
    auto take = [&](const int* body, Real* arm) {
        Vector r0, r1;
        if (points) {
            r0 = load(at + 2 * i) - pairs(center, body + i);
            r1 = load(at + 2 * i + LANES) - pairs(center, body + i + LANES / 2);
            store(arm + 2 * i, r0);
            store(arm + 2 * i + LANES, r1);
        } else {
            r0 = load(arm + 2 * i);
            r1 = load(arm + 2 * i + LANES);
        }
        // 0 x is 0 for a finite x, NaN for inf and NaN
        finite += (Real)0 * r0 + (Real)0 * r1;
        const Vector x = first_of(r0, r1), y = second_of(r0, r1), beside = x * ny - y * nx;
        const auto bent = beside * beside > bend * (x * x + y * y);
        // the arm of a body that nothing turns may be any, as that of the ground is
        for (int k = 0; discs && __builtin_reduce_or(bent) != 0 && k < LANES; ++k)
            bad |= bent[k] != 0 && inv_inertia.data[body[i + k]] > 0;
    };
    take(a, p);
    take(b, q);
    const Vector mu = load(friction + i), e = load(restitution + i);
    good &= (finite == zero) & (off >= least) & (off <= most) & (mu >= zero) & (e >= zero) & (e <= (Real)1);
}
bad |= __builtin_reduce_and(good) == 0;
#endif
auto is_bent = [&](int c, const int* body, const Real* arm) {
    const Real beside = arm[2 * c] * normal[2 * c + 1] - arm[2 * c + 1] * normal[2 * c];
    const bool bent = beside * beside > bend * (arm[2 * c] * arm[2 * c] + arm[2 * c + 1] * arm[2 * c + 1]);
    return bent && inv_inertia.data[body[c]] > 0;
};
for (; i < i1; ++i) {
    for (int k = 2 * i; points && k < 2 * i + 2; ++k) {
        p[k] = at[k] - center[2 * a[i] + k - 2 * i];
        q[k] = at[k] - center[2 * b[i] + k - 2 * i];
    }
    Real finite = (Real)0 * gap[i] + (Real)0 * friction[i];
    for (int k = 2 * i; k < 2 * i + 2; ++k) finite += (Real)0 * p[k] + (Real)0 * q[k];
    const Real off = normal[2 * i] * normal[2 * i] + normal[2 * i + 1] * normal[2 * i + 1] - (Real)1;
    const Real mu = friction[i], e = restitution[i];
    bad |= !((finite == 0) & (off >= least) & (off <= most) & (mu >= 0) & (e >= 0) & (e <= 1));
    bad |= discs && (is_bent(i, a, p) || is_bent(i, b, q));
}
return bad;
