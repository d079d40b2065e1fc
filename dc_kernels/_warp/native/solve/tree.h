// The rigid rows and springs of joints whose bodies form trees, of the variant rows: joint by joint, a body's further
// from the root first. Parameters: tree, bodies (their fourth number is the inverse mass), rows. Macros: those of
// solve/row.h, JOINT (numbers kept of a joint), MOVES (of a body). Everything here is in double, whatever the scalar:
// of a light link between heavy bodies little is left of large numbers. A joint has SIZE rows at most, its parent is
// the body nearer to the root, its child the other one, -1 if that is fixed.
#if !defined(__CUDA_ARCH__)
#pragma clang fp contract(off)
#endif
typedef REAL Real;
const int SIZE = 3;
Real* const velocity = (Real*)bodies.data;
const int* const slots = rows.row_slot.data;
const int t0 = rows.tree_first.data[tree], t1 = rows.tree_first.data[tree + 1];
const int *const row_of = rows.tree_row.data, *const size_of = rows.tree_size.data;
const int *const parent_of = rows.tree_parent.data, *const child_of = rows.tree_child.data;
double *const factors = rows.tree_factor.data, *const moves = rows.tree_moves.data;
// What is kept of a joint: D^-1; G, three numbers of each row; Jacobians at the parent and at the child; what a row is
// off by without its bodies' velocities; softness; inverse inertia of parent and child.
struct Kept {
    double inverse[9], gain[9], parent[9], child[9], off[3], soft[3], inertia[2];
};
static_assert(sizeof(Kept) == JOINT * sizeof(double), "tree_factor holds as many numbers");
auto kept_of = [=](int t) { return (Kept*)(factors + (size_t)t * JOINT); };
// Six numbers of a body's mobility (xx, yy, ww, xy, xw, yw), three of what it moves by, three of the impulse on it.
auto moves_of = [=](int body) { return moves + (size_t)body * MOVES; };
auto dot = [=](const double* a, const double* b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; };
// What is done to a joint is compiled for each number of rows.
struct One {
    enum { ROWS = 1 };
};
struct Two {
    enum { ROWS = 2 };
};
struct Three {
    enum { ROWS = 3 };
};
auto by_size = [=](int t, auto pass) {
    const int size = size_of[t];
    if (size == 2)
        pass(t, Two());
    else if (size == 3)
        pass(t, Three());
    else
        pass(t, One());
};
