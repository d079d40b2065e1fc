// Elimination of the joints, leaves first: J M^-1 J^T of a tree is factored without fill (Baraff 1996; Featherstone
// 2008 for the mobility of a body that carries others). For each joint D^-1 and G = W J^T D^-1 are kept, where W is the
// mobility of its parent with what was eliminated before, and D = J W J^T of both bodies plus softness.
// Parameters: w, places, bodies, rows. Stands behind tree.h.
const double LEAST = 1e-9;  // a pivot below this share of its row's own mass is that of a row that others hold already
for (int t = t0; t < t1; ++t) {
    const Joint j = joint_at(t);
    for (int side = 0; side < 2; ++side) {
        const int body = side == 0 ? j.parent : j.child;
        if (body < 0) continue;
        double* const m = moves_of(body);
        const bool second = j.second[0] == (side == 0);
        const double mass = velocity[4 * (size_t)body + 3] > 0 ? velocity[4 * (size_t)body + 3] : 0;
        for (int i = 0; i < MOVES; ++i) m[i] = 0;
        m[0] = m[1] = mass;
        m[2] = j.column[0][second ? AT_iB : AT_iA];
    }
}
for (int t = t0; t < t1; ++t) {
    const Joint j = joint_at(t);
    double* const w_parent = moves_of(j.parent);
    double* const factor = rows.tree_factor.data + (size_t)t * FACTORS;
    double jp[SIZE][3], wp_[SIZE][3], d[SIZE][SIZE], own[SIZE];
    for (int i = 0; i < SIZE; ++i)
        for (int k = 0; k < SIZE; ++k) d[i][k] = 0;
    for (int i = 0; i < j.size; ++i) {
        const bool here = counts(j.column[i], places != 0);
        jacobian(j.column[i], j.second[i], jp[i]);
        for (int k = 0; k < 3; ++k) jp[i][k] = here ? jp[i][k] : 0;
        times(w_parent, jp[i], wp_[i]);
        const double mass = j.column[i][AT_en];
        own[i] = here ? 1 / mass : 0;
        d[i][i] = here ? softness(j.column[i]) : 0;
    }
    for (int i = 0; i < j.size; ++i)
        for (int k = 0; k < j.size; ++k) d[i][k] += dot(jp[i], wp_[k]);
    if (j.child >= 0) {
        double jc[SIZE][3], wc[SIZE][3];
        for (int i = 0; i < j.size; ++i) {
            jacobian(j.column[i], !j.second[i], jc[i]);
            for (int k = 0; k < 3; ++k) jc[i][k] = own[i] > 0 ? jc[i][k] : 0;
            times(moves_of(j.child), jc[i], wc[i]);
        }
        for (int i = 0; i < j.size; ++i)
            for (int k = 0; k < j.size; ++k) d[i][k] += dot(jc[i], wc[k]);
    }
    // the inverse by Gauss-Jordan steps; rows without a pivot of their own are left out
    bool kept[SIZE] = {};
    for (int p = 0; p < j.size; ++p) {
        const double pivot = d[p][p];
        kept[p] = pivot > LEAST * own[p] && own[p] > 0;
        if (!kept[p]) continue;
        for (int i = 0; i < j.size; ++i)
            for (int k = 0; k < j.size; ++k)
                if (i != p && k != p) d[i][k] -= d[i][p] * d[p][k] / pivot;
        for (int i = 0; i < j.size; ++i)
            if (i != p) {
                d[i][p] /= pivot;
                d[p][i] /= pivot;
            }
        d[p][p] = -1 / pivot;
    }
    double* const inverse = factor;  // 9 numbers; then G, 9 numbers: three of each row
    double* const gain = factor + 9;
    for (int i = 0; i < SIZE; ++i)
        for (int k = 0; k < SIZE; ++k) inverse[3 * i + k] = kept[i] && kept[k] ? -d[i][k] : 0;
    for (int i = 0; i < SIZE; ++i)
        for (int n = 0; n < 3; ++n) {
            double sum = 0;
            for (int k = 0; k < j.size; ++k) sum += wp_[k][n] * inverse[3 * k + i];
            gain[3 * i + n] = sum;
        }
    for (int i = 0; i < j.size; ++i) {
        const double* const g = gain + 3 * i;
        const double* const v = wp_[i];
        w_parent[0] -= g[0] * v[0];
        w_parent[1] -= g[1] * v[1];
        w_parent[2] -= g[2] * v[2];
        w_parent[3] -= (g[0] * v[1] + g[1] * v[0]) / 2;
        w_parent[4] -= (g[0] * v[2] + g[2] * v[0]) / 2;
        w_parent[5] -= (g[1] * v[2] + g[2] * v[1]) / 2;
    }
}
