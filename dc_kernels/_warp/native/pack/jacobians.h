// Rows of a caller's own Jacobians and of joints, world w's: what a row holds is said in solve/constraints/jacobian.py.
// One whose impulse can only be 0 has no row, and a negative slot. Returns scale plus the squared impulses that would
// stop each of them alone [(N s)^2], row after row. Parameters: w, jacobi, scale, model, motion, rows. Macros: those of
// solve/row.h, COLORS.
#if !defined(__CUDA_ARCH__)
#pragma clang fp contract(off)
#endif
typedef REAL Real;
const int *const bodies_a = rows.row_body_a.data, *const bodies_b = rows.row_body_b.data;
const int* const color = rows.row_color.data;
const Real* const jacobians_a = (const Real*)rows.row_jacobian_a.data;
const Real* const jacobians_b = (const Real*)rows.row_jacobian_b.data;
const Real *const biases = rows.row_bias.data, *const gaps = rows.row_gap.data, *const helds = rows.row_held.data;
const Real *const lowers = rows.row_lower.data, *const uppers = rows.row_upper.data;
const Real* const softnesses = rows.row_softness.data;
const Real *const inv_inertia = model.inv_inertia.data, *const stiff_inertia = rows.stiff_inertia.data;
const Real* const predicted = (const Real*)motion.predicted.data;
const int* const first = rows.color_block.data + (size_t)w * (COLORS + 1);
int* const filled = rows.color_fill.data + (size_t)w * COLORS;
int *const slot = rows.row_slot.data, *const ends = rows.body.data, *const body_rows = rows.body_rows.data;
Real* const columns = rows.column.data;
const int k1 = rows.row_start.data[w + 1];
for (int k = rows.row_start.data[w]; k < k1; ++k) {
    if (lowers[k] == 0 && uppers[k] == 0) {
        slot[k] = -1;
        continue;
    }
    const int a = bodies_a[k], b = bodies_b[k];
    const unsigned row = filled[color[k]]++, block = first[color[k]] + row / LANES, lane = row % LANES;
    const size_t at = (size_t)block * 2 * LANES + lane;
    slot[k] = (int)at;
    ends[at] = a;
    ends[at + LANES] = b;
    if (jacobi) {
        ++body_rows[a];
        ++body_rows[b];
    }
    const Real *const ja = jacobians_a + 3 * (size_t)k, *const jb = jacobians_b + 3 * (size_t)k;
    const Real *const va = predicted + 4 * (size_t)a, *const vb = predicted + 4 * (size_t)b;
    const Real iA = inv_inertia[a] / (1 + inv_inertia[a] * stiff_inertia[a]);
    const Real iB = inv_inertia[b] / (1 + inv_inertia[b] * stiff_inertia[b]);
    const Real of_a = va[3] * (ja[0] * ja[0] + ja[1] * ja[1]) + iA * ja[2] * ja[2];
    const Real of_b = vb[3] * (jb[0] * jb[0] + jb[1] * jb[1]) + iB * jb[2] * jb[2];
    const Real speed =
        (ja[0] * va[0] + ja[1] * va[1] + ja[2] * va[2]) + (jb[0] * vb[0] + jb[1] * vb[1] + jb[2] * vb[2]);
    const Real whole = of_a + of_b + softnesses[k];
    const Real mass = of_a + of_b > 0 && whole > 0 ? 1 / whole : 0;
    const Real stop = mass * (speed + biases[k]);
    Real* const to = columns + (size_t)block * COLUMNS * LANES + lane;
    to[AT_nx] = jb[0];
    to[AT_ny] = jb[1];
    to[AT_ax] = -ja[0];  // at A it counts the other way, as a contact's normal does
    to[AT_ay] = -ja[1];
    to[AT_rAn] = -ja[2];
    to[AT_rBn] = jb[2];
    to[AT_rAt] = to[AT_rBt] = to[AT_et] = to[AT_mu] = 0;
    to[AT_iA] = iA;
    to[AT_iB] = iB;
    to[AT_en] = mass;
    to[AT_bias] = biases[k];
    to[AT_gap] = gaps[k];
    to[AT_lo] = lowers[k];
    to[AT_hi] = uppers[k];
    to[AT_soft] = softnesses[k];
    to[AT_held] = helds[k];
#if SURFACES
    to[AT_slip] = to[AT_roll] = 0;
#endif
    scale += stop * stop;
}
return scale;
