// The impulses that make all rows of the trees hold at once, and the velocities with them; in the position phase
// (places) the displacements that remove a share of what the rows have drifted by.
// Parameters: tree, places, share, limit, bodies, rows. Stands behind tree.h, after tree_factor.h has run.
Real* const impulse = rows.impulse.data;
Real* const change = rows.change.data;
double* const all_wanted = rows.tree_wanted.data;
const double most = places ? (double)limit : 1e300;
auto clipped = [=](double off) { return off < -most ? -most : (off > most ? most : off); };
auto up = [=](int t, auto n) {
    const Kept& kept = *kept_of(t);
    const int size = decltype(n)::ROWS, parent = parent_of[t], child = child_of[t];
    const int* const slot = slots + row_of[t];
    double* const at_parent = moves_of(parent) + 6;
    double vp[3], vc[3] = {}, moved[3] = {}, s[SIZE];
    for (int k = 0; k < 3; ++k) vp[k] = velocity[4 * (size_t)parent + k];
    if (child >= 0)
        for (int k = 0; k < 3; ++k) {
            vc[k] = velocity[4 * (size_t)child + k];
            moved[k] = moves_of(child)[6 + k];
        }
    for (int i = 0; i < size; ++i) {
        const double *const jp = kept.parent + 3 * i, *const jc = kept.child + 3 * i;
        const double given = places ? 0 : kept.soft[i] * impulse[slot[i]];
        const double off = clipped(share * (((kept.off[i] + given) + dot(jp, vp)) + dot(jc, vc)));
        s[i] = -((off + dot(jp, at_parent)) + dot(jc, moved));
    }
    double* const wanted = all_wanted + (size_t)t * SIZE;
    for (int i = 0; i < size; ++i) {
        double sum = 0;
        for (int k = 0; k < size; ++k) sum += kept.inverse[3 * i + k] * s[k];
        wanted[i] = sum;
    }
    for (int i = 0; i < size; ++i)
        for (int k = 0; k < 3; ++k) at_parent[k] += kept.gain[3 * i + k] * s[i];
};
auto down = [=](int t, auto n) {
    const Kept& kept = *kept_of(t);
    const int size = decltype(n)::ROWS, child = child_of[t];
    const int* const slot = slots + row_of[t];
    const double* const wanted = all_wanted + (size_t)t * SIZE;
    double* const on_parent = moves_of(parent_of[t]) + 9;
    double x[SIZE];
    for (int i = 0; i < size; ++i) x[i] = wanted[i] - dot(kept.gain + 3 * i, on_parent);
    for (int i = 0; i < size; ++i) {
        for (int k = 0; k < 3; ++k) on_parent[k] += kept.parent[3 * i + k] * x[i];
        if (child >= 0)
            for (int k = 0; k < 3; ++k) moves_of(child)[9 + k] += kept.child[3 * i + k] * x[i];
        if (!places) {
            impulse[slot[i]] = (Real)(impulse[slot[i]] + x[i]);
            change[slot[i]] = (Real)(change[slot[i]] + x[i]);
        }
    }
};
// each body is the child of one joint, but for the root, which is the parent of the last
auto move = [=](int body, double inertia) {
    double* const m = moves_of(body);
    Real* const v = velocity + 4 * (size_t)body;
    const double mass = v[3] > 0 ? v[3] : 0;
    v[0] = (Real)(v[0] + mass * m[9]);
    v[1] = (Real)(v[1] + mass * m[10]);
    v[2] = (Real)(v[2] + inertia * m[11]);
    for (int n = 6; n < MOVES; ++n) m[n] = 0;
};
// not inlined: the code around it would then be too large to be, and copy its groups at each sweep (1 us a step)
auto solve = [=]() __attribute__((noinline)) {
    for (int t = t0; t < t1; ++t) by_size(t, up);
    for (int t = t1 - 1; t >= t0; --t) by_size(t, down);
    for (int t = t0; t < t1; ++t)
        if (child_of[t] >= 0) move(child_of[t], kept_of(t)->inertia[1]);
    if (t1 > t0) move(parent_of[t1 - 1], kept_of(t1 - 1)->inertia[0]);
};
solve();
