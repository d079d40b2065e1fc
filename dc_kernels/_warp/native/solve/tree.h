// The rigid rows and springs of joints whose bodies form trees, of the variant rows: joint by joint, a body's further
// from the root first. Parameters: w, bodies (their fourth number is the inverse mass), rows. Macros: those of
// solve/row.h. Everything here is in double, whatever the scalar: of a light link between heavy bodies little is left
// of large numbers. A joint has SIZE rows at most, its parent is the body nearer to the root, its child the other one,
// -1 if that is fixed.
#if !defined(__CUDA_ARCH__)
#pragma clang fp contract(off)
#endif
typedef REAL Real;
const int SIZE = 3, FACTORS = 18, MOVES = 12;
const Real* const columns = rows.column.data;
const int* const ends = rows.body.data;
Real* const velocity = (Real*)bodies.data;
const int* const slots = rows.row_slot.data;
const int t0 = rows.tree_start.data[w], t1 = rows.tree_start.data[w + 1];
struct Joint {
    int slot[3], size, parent, child;
    const Real* column[3];
    bool second[3];  // whether the parent is body B
};
auto joint_at = [&](int t) {
    Joint j;
    j.size = rows.tree_size.data[t];
    j.parent = rows.tree_parent.data[t];
    j.child = rows.tree_child.data[t];
    for (int i = 0; i < j.size; ++i) {
        const int slot = slots[rows.tree_row.data[t] + i], block = slot / (2 * LANES), lane = slot % (2 * LANES);
        j.slot[i] = slot;
        j.column[i] = columns + (size_t)block * COLUMNS * LANES + lane;
        j.second[i] = ends[slot] != j.parent;
    }
    return j;
};
// The Jacobian of a row at one of its bodies.
auto jacobian = [&](const Real* column, bool second, double* to) {
    if (second) {
        to[0] = column[AT_nx];
        to[1] = column[AT_ny];
        to[2] = column[AT_rBn];
        return;
    }
    to[0] = -(double)column[AT_ax];
    to[1] = -(double)column[AT_ay];
    to[2] = -(double)column[AT_rAn];
};
auto softness = [&](const Real* column) { return (double)column[AT_soft]; };
// Whether a row is solved: not if nothing can move along it, nor in the position phase where that leaves it alone.
auto counts = [&](const Real* column, bool places) { return column[AT_en] > 0 && !(places && column[AT_held] == 0); };
// Six numbers of a body's mobility (xx, yy, ww, xy, xw, yw), three of what it moves by, three of the impulse on it.
auto moves_of = [&](int body) { return rows.tree_moves.data + (size_t)body * MOVES; };
auto times = [&](const double* m, const double* v, double* to) {
    to[0] = m[0] * v[0] + m[3] * v[1] + m[4] * v[2];
    to[1] = m[3] * v[0] + m[1] * v[1] + m[5] * v[2];
    to[2] = m[4] * v[0] + m[5] * v[1] + m[2] * v[2];
};
auto dot = [&](const double* a, const double* b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; };
