// Elimination of the joints, leaves first: J M^-1 J^T of a tree is factored without fill (Baraff 1996; Featherstone
// 2008 for the mobility of a body that carries others). For each joint D^-1 and G = W J^T D^-1 are kept, where W is the
// mobility of its parent with what was eliminated before, and D = J W J^T of both bodies plus softness.
// For displacements (places 1) the factors of the velocities serve again where the rows are the same.
// Parameters: tree, places, bodies, rows. Stands behind tree.h.
const double LEAST = 1e-9;  // a pivot below this share of its row's own mass is that of a row that others hold already
const Real* const columns = rows.column.data;
const int* const ends = rows.body.data;
auto column_of = [=](int t, int i) {
    const unsigned slot = slots[row_of[t] + i];
    return columns + (size_t)(slot / (2 * LANES)) * COLUMNS * LANES + slot % (2 * LANES);
};
// Whether a row is solved: not if nothing can move along it, nor in the position phase where that leaves it alone.
auto counts = [=](const Real* column) { return column[AT_en] > 0 && !(places && column[AT_held] == 0); };
// The Jacobian of a row at one of its bodies.
auto jacobian = [=](const Real* column, bool second, double* to) {
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
auto times = [=](const double* m, const double* v, double* to) {
    to[0] = m[0] * v[0] + m[3] * v[1] + m[4] * v[2];
    to[1] = m[3] * v[0] + m[1] * v[1] + m[5] * v[2];
    to[2] = m[4] * v[0] + m[5] * v[1] + m[2] * v[2];
};
auto eliminate = [=](int t, auto n) {
    const int size = decltype(n)::ROWS, parent = parent_of[t], child = child_of[t];
    double* const w_parent = moves_of(parent);
    Kept& kept = *kept_of(t);
    double at_parent[size][3] = {}, at_child[size][3] = {}, wp_[size][3] = {}, wc[size][3] = {}, d[size][size] = {};
    double own[size] = {};
    for (int i = 0; i < size; ++i) {
        const Real* const column = column_of(t, i);
        const bool second = ends[slots[row_of[t] + i]] != parent;
        kept.soft[i] = 0;
        if (!counts(column)) continue;
        jacobian(column, second, at_parent[i]);
        times(w_parent, at_parent[i], wp_[i]);
        if (child >= 0) {
            jacobian(column, !second, at_child[i]);
            times(moves_of(child), at_child[i], wc[i]);
        }
        own[i] = 1 / (double)column[AT_en];
        d[i][i] = kept.soft[i] = column[AT_soft];
    }
    for (int i = 0; i < size; ++i)
        for (int k = 0; k < size; ++k) {
            d[i][k] += dot(at_parent[i], wp_[k]);
            d[i][k] += dot(at_child[i], wc[k]);
        }
    // the inverse by Gauss-Jordan steps; rows without a pivot of their own are left out
    bool solved[size] = {};
    for (int p = 0; p < size; ++p) {
        const double pivot = d[p][p];
        solved[p] = pivot > LEAST * own[p] && own[p] > 0;
        if (!solved[p]) continue;
        for (int i = 0; i < size; ++i)
            for (int k = 0; k < size; ++k)
                if (i != p && k != p) d[i][k] -= d[i][p] * d[p][k] / pivot;
        for (int i = 0; i < size; ++i)
            if (i != p) {
                d[i][p] /= pivot;
                d[p][i] /= pivot;
            }
        d[p][p] = -1 / pivot;
    }
    for (int i = 0; i < size; ++i)
        for (int k = 0; k < size; ++k) kept.inverse[3 * i + k] = solved[i] && solved[k] ? -d[i][k] : 0;
    for (int i = 0; i < size; ++i) {
        double g[3] = {};
        const double* const v = wp_[i];
        for (int n = 0; n < 3; ++n)
            for (int k = 0; k < size; ++k) g[n] += wp_[k][n] * kept.inverse[3 * k + i];
        w_parent[0] -= g[0] * v[0];
        w_parent[1] -= g[1] * v[1];
        w_parent[2] -= g[2] * v[2];
        w_parent[3] -= (g[0] * v[1] + g[1] * v[0]) / 2;
        w_parent[4] -= (g[0] * v[2] + g[2] * v[0]) / 2;
        w_parent[5] -= (g[1] * v[2] + g[2] * v[1]) / 2;
        for (int n = 0; n < 3; ++n) {
            kept.gain[3 * i + n] = g[n];
            kept.parent[3 * i + n] = at_parent[i][n];
            kept.child[3 * i + n] = at_child[i][n];
        }
    }
};
// not inlined: the code around it would then be too large to be, and copy its groups at each sweep (1 us a step)
auto factor = [=]() __attribute__((noinline)) {
    bool factored = places != 0;
    for (int t = t0; t < t1; ++t) {
        const int size = size_of[t], parent = parent_of[t], child = child_of[t];
        Kept& kept = *kept_of(t);
        for (int i = 0; i < size; ++i) {
            const Real* const column = column_of(t, i);
            const int slot = slots[row_of[t] + i];
            if (places && ((column[AT_en] > 0 && column[AT_held] == 0) || kept.soft[i] != 0)) factored = false;
            kept.off[i] = column[places ? AT_gap : AT_bias];
            if (child < 0) {
                const bool second = ends[slot] == parent;
                const Real* const v = velocity + 4 * (size_t)ends[slot + (second ? LANES : 0)];
                double along[3];
                jacobian(column, second, along);
                kept.off[i] += along[0] * v[0] + along[1] * v[1] + along[2] * v[2];
            }
        }
    }
    if (!factored) {
        for (int t = t0; t < t1; ++t) {
            Kept& kept = *kept_of(t);
            const int slot = slots[row_of[t]];
            for (int side = 0; side < 2; ++side) {
                const int body = side == 0 ? parent_of[t] : child_of[t];
                if (body < 0) continue;
                double* const m = moves_of(body);
                const double mass = velocity[4 * (size_t)body + 3] > 0 ? velocity[4 * (size_t)body + 3] : 0;
                for (int i = 0; i < MOVES; ++i) m[i] = 0;
                m[0] = m[1] = mass;
                m[2] = kept.inertia[side] = column_of(t, 0)[ends[slot] == body ? AT_iA : AT_iB];
            }
        }
        for (int t = t0; t < t1; ++t) by_size(t, eliminate);
    }
};
factor();
