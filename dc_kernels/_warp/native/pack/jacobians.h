// Rows of a caller's own Jacobians and of joints, world w's, into the lanes of their colours. One whose impulse can
// only be 0 has no row, and a negative slot. Returns scale plus the squared impulses that would stop each of them alone
// [(N s)^2], row after row. Parameters: w, jacobi, scale, model, motion, rows. Macros: those of solve/row.h, COLORS.
// Stands behind jacobian.h.
const int* const color = rows.row_color.data;
const int* const first = rows.color_block.data + (size_t)w * (COLORS + 1);
int* const filled = rows.color_fill.data + (size_t)w * COLORS;
int *const slot = rows.row_slot.data, *const ends = rows.body.data, *const body_rows = rows.body_rows.data;
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
    scale += make_jacobian(k, block, lane, true);
}
return scale;
