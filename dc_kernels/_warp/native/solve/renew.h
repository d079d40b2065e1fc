// Rows of the joints of world w as substeps take them. With `renew` they have been made anew, where the substep before
// has brought their bodies, and come into their lanes; a sweep adds to their gaps what the displacements of the whole
// step move, which is taken off here. Of each pair of rows that hold a joint the second is taken without what the first
// does of it, so that a sweep over both solves them as one block: it has a share of the first less, and the impulse
// along the first that much of the second's more. Parameters: w, renew, model, joints, motion, rows. Macros: those of
// solve/row.h, REVOLUTE, PRISMATIC, WELD. Stands behind pack/jacobian.h.
const Real* const moved = (const Real*)motion.displacement.data;
const int *const slot = rows.row_slot.data, *const row_start = joints.joint_row_start.data;
const int* const kinds = joints.joint_kind.data;
Real *const x = rows.impulse.data, *const shares = rows.before.data;
auto column_of = [=](int k) {
    const unsigned at = slot[k];
    return columns + (size_t)(at / (2 * LANES)) * COLUMNS * LANES + at % (2 * LANES);
};
if (rows.row_start.data[w] == rows.row_start.data[w + 1]) return;  // rods, if any, are packed as they are made
for (int j = model.joint_start.data[w]; j < model.joint_start.data[w + 1]; ++j) {
    const int k0 = row_start[j];
    const bool pair = kinds[j] == REVOLUTE || kinds[j] == PRISMATIC || kinds[j] == WELD;
    if (renew) {
        if (pair) x[slot[k0]] -= shares[slot[k0 + 1] + LANES] * x[slot[k0 + 1]];
        for (int k = k0; k < row_start[j + 1]; ++k) {
            if (slot[k] < 0) continue;
            const unsigned at = slot[k];
            make_jacobian(k, at / (2 * LANES), at % (2 * LANES), false);
            const Real *const ja = jacobians_a + 3 * (size_t)k, *const jb = jacobians_b + 3 * (size_t)k;
            const Real *const da = moved + 4 * (size_t)bodies_a[k], *const db = moved + 4 * (size_t)bodies_b[k];
            column_of(k)[AT_gap] -=
                (ja[0] * da[0] + ja[1] * da[1] + ja[2] * da[2]) + (jb[0] * db[0] + jb[1] * db[1] + jb[2] * db[2]);
        }
    }
    if (pair) {
        const Real* const one = column_of(k0);
        Real* const two = column_of(k0 + 1);
        const Real ma = predicted[4 * (size_t)bodies_a[k0] + 3], mb = predicted[4 * (size_t)bodies_b[k0] + 3];
        const Real of_a =
            ma * (one[AT_ax] * two[AT_ax] + one[AT_ay] * two[AT_ay]) + one[AT_iA] * one[AT_rAn] * two[AT_rAn];
        const Real of_b =
            mb * (one[AT_nx] * two[AT_nx] + one[AT_ny] * two[AT_ny]) + one[AT_iB] * one[AT_rBn] * two[AT_rBn];
        const Real share = (of_a + of_b) * one[AT_en];
        two[AT_ax] -= share * one[AT_ax];
        two[AT_ay] -= share * one[AT_ay];
        two[AT_rAn] -= share * one[AT_rAn];
        two[AT_nx] -= share * one[AT_nx];
        two[AT_ny] -= share * one[AT_ny];
        two[AT_rBn] -= share * one[AT_rBn];
        two[AT_gap] -= share * one[AT_gap];
        two[AT_bias] -= share * one[AT_bias];
        const Real own_a =
            ma * (two[AT_ax] * two[AT_ax] + two[AT_ay] * two[AT_ay]) + two[AT_iA] * two[AT_rAn] * two[AT_rAn];
        const Real own_b =
            mb * (two[AT_nx] * two[AT_nx] + two[AT_ny] * two[AT_ny]) + two[AT_iB] * two[AT_rBn] * two[AT_rBn];
        two[AT_en] = own_a + own_b > 0 ? 1 / (own_a + own_b) : 0;
        shares[slot[k0 + 1] + LANES] = share;
        x[slot[k0]] += share * x[slot[k0 + 1]];
    }
}
