// The columns of a row of its caller's own Jacobians, or of a joint: what it holds is said in
// solve/constraints/jacobian.py. Parameters: model, motion, rows. Macros: those of solve/row.h.
#if !defined(__CUDA_ARCH__)
#pragma clang fp contract(off)
#endif
typedef REAL Real;
const int *const bodies_a = rows.row_body_a.data, *const bodies_b = rows.row_body_b.data;
const Real* const jacobians_a = (const Real*)rows.row_jacobian_a.data;
const Real* const jacobians_b = (const Real*)rows.row_jacobian_b.data;
const Real *const biases = rows.row_bias.data, *const gaps = rows.row_gap.data, *const helds = rows.row_held.data;
const Real *const lowers = rows.row_lower.data, *const uppers = rows.row_upper.data;
const Real* const softnesses = rows.row_softness.data;
const Real *const inv_inertia = model.inv_inertia.data, *const stiff_inertia = rows.stiff_inertia.data;
const Real* const predicted = (const Real*)motion.predicted.data;
Real* const columns = rows.column.data;
// Writes row k to a lane, or what changes of it as its bodies move; the squared impulse that would stop it alone
// [(N s)^2].
auto make_jacobian = [=](int k, size_t block, size_t lane, bool anew) {
    const int a = bodies_a[k], b = bodies_b[k];
    const Real *const ja = jacobians_a + 3 * (size_t)k, *const jb = jacobians_b + 3 * (size_t)k;
    const Real *const va = predicted + 4 * (size_t)a, *const vb = predicted + 4 * (size_t)b;
    Real* const to = columns + block * COLUMNS * LANES + lane;
    const Real iA = anew ? inv_inertia[a] / (1 + inv_inertia[a] * stiff_inertia[a]) : to[AT_iA];
    const Real iB = anew ? inv_inertia[b] / (1 + inv_inertia[b] * stiff_inertia[b]) : to[AT_iB];
    const Real of_a = va[3] * (ja[0] * ja[0] + ja[1] * ja[1]) + iA * ja[2] * ja[2];
    const Real of_b = vb[3] * (jb[0] * jb[0] + jb[1] * jb[1]) + iB * jb[2] * jb[2];
    const Real speed =
        (ja[0] * va[0] + ja[1] * va[1] + ja[2] * va[2]) + (jb[0] * vb[0] + jb[1] * vb[1] + jb[2] * vb[2]);
    const Real whole = of_a + of_b + softnesses[k];
    const Real mass = of_a + of_b > 0 && whole > 0 ? 1 / whole : 0;
    const Real stop = mass * (speed + biases[k]);
    to[AT_nx] = jb[0];
    to[AT_ny] = jb[1];
    to[AT_ax] = -ja[0];  // at A it counts the other way, as a contact's normal does
    to[AT_ay] = -ja[1];
    to[AT_rAn] = -ja[2];
    to[AT_rBn] = jb[2];
    to[AT_en] = mass;
    to[AT_bias] = biases[k];
    to[AT_gap] = gaps[k];
    to[AT_lo] = lowers[k];
    to[AT_hi] = uppers[k];
    to[AT_soft] = softnesses[k];
    if (anew) {
        to[AT_rAt] = to[AT_rBt] = to[AT_et] = to[AT_mu] = 0;
        to[AT_iA] = iA;
        to[AT_iB] = iB;
        to[AT_held] = helds[k];
#if SURFACES
        to[AT_slip] = to[AT_roll] = 0;
#endif
    }
    return stop * stop;
};
