// The impulses that make all rows of the trees hold at once, and the velocities with them; in the position phase
// (places) the displacements that remove a share of what the rows have drifted by.
// Parameters: w, places, share, limit, bodies, rows. Stands behind tree.h, after tree_factor.h has run.
Real* const impulse = rows.impulse.data;
Real* const change = rows.change.data;
double* const wanted = rows.tree_wanted.data;
for (int t = t0; t < t1; ++t) {
    const Joint j = joint_at(t);
    const double* const inverse = rows.tree_factor.data + (size_t)t * FACTORS;
    double* const at_parent = moves_of(j.parent) + 6;
    double s[SIZE] = {};
    for (int i = 0; i < j.size; ++i) {
        const Real* const column = j.column[i];
        double lacking = places ? (double)column[AT_gap] : column[AT_bias] + softness(column) * impulse[j.slot[i]];
        double along[2][3];
        for (int side = 0; side < 2; ++side) {
            const Real* const v = velocity + 4 * (size_t)ends[j.slot[i] + side * LANES];
            jacobian(column, side == 1, along[side]);
            lacking += along[side][0] * v[0] + along[side][1] * v[1] + along[side][2] * v[2];
        }
        if (places) {
            lacking *= share;
            lacking = lacking < -limit ? -limit : (lacking > limit ? limit : lacking);
        }
        for (int side = 0; side < 2; ++side) {
            const int body = ends[j.slot[i] + side * LANES];
            if (body == j.parent || body == j.child) lacking += dot(along[side], moves_of(body) + 6);
        }
        s[i] = counts(column, places != 0) ? -lacking : 0;
    }
    const double* const gain = inverse + 9;
    double* const kept = wanted + (size_t)t * SIZE;
    for (int i = 0; i < SIZE; ++i)
        kept[i] = inverse[3 * i] * s[0] + inverse[3 * i + 1] * s[1] + inverse[3 * i + 2] * s[2];
    for (int n = 0; n < 3; ++n) at_parent[n] += gain[n] * s[0] + gain[3 + n] * s[1] + gain[6 + n] * s[2];
}
for (int t = t1 - 1; t >= t0; --t) {
    const Joint j = joint_at(t);
    const double* const gain = rows.tree_factor.data + (size_t)t * FACTORS + 9;
    const double* const kept = wanted + (size_t)t * SIZE;
    double* const on_parent = moves_of(j.parent) + 9;
    double x[SIZE];
    for (int i = 0; i < j.size; ++i) x[i] = kept[i] - dot(gain + 3 * i, on_parent);
    for (int i = 0; i < j.size; ++i) {
        double of[3];
        jacobian(j.column[i], j.second[i], of);
        for (int n = 0; n < 3; ++n) on_parent[n] += of[n] * x[i];
        if (j.child >= 0) {
            jacobian(j.column[i], !j.second[i], of);
            for (int n = 0; n < 3; ++n) moves_of(j.child)[9 + n] += of[n] * x[i];
        }
        if (!places) {
            impulse[j.slot[i]] = (Real)(impulse[j.slot[i]] + x[i]);
            change[j.slot[i]] = (Real)(change[j.slot[i]] + x[i]);
        }
    }
}
for (int t = t0; t < t1; ++t) {
    const Joint j = joint_at(t);
    for (int side = 0; side < 2; ++side) {
        const int body = side == 0 ? j.parent : j.child;
        if (body < 0) continue;
        double* const m = moves_of(body);
        Real* const v = velocity + 4 * (size_t)body;
        const double mass = v[3] > 0 ? v[3] : 0;
        const double inertia = j.column[0][j.second[0] == (side == 0) ? AT_iB : AT_iA];
        v[0] = (Real)(v[0] + mass * m[9]);
        v[1] = (Real)(v[1] + mass * m[10]);
        v[2] = (Real)(v[2] + inertia * m[11]);
        for (int n = 6; n < MOVES; ++n) m[n] = 0;
    }
}
