// New places and velocities of the bodies b0 .. b1; unless one is not finite: nothing is changed then. Returns whether
// all are. Parameters: b0, b1, model, state, motion, team. Macro: STATIC. Stands behind runtime/ranges.h.
const Real *const solved = (const Real*)motion.solved.data, *const way = (const Real*)motion.displacement.data;
const int* const kind = model.body_type.data;
Real *const position = (Real*)state.position.data, *const angle = state.angle.data;
Real *const velocity = (Real*)state.velocity.data, *const spin = state.angular_velocity.data;
// x - x is 0 for a finite x, NaN for inf and NaN
const Real check = add_range(team, b0, b1, 2048, [=](int first, int last) {
    Real sum = 0;
    for (int b = first; b < last; ++b) {
        const Real *const v = solved + 4 * b, *const d = way + 4 * b;
        const Real x = position[2 * b] + d[0], y = position[2 * b + 1] + d[1], a = angle[b] + d[2];
        sum += (v[0] - v[0]) + (v[1] - v[1]) + (v[2] - v[2]) + (x - x) + (y - y) + (a - a);
    }
    return sum;
});
if (check != 0) return false;
take_range(team, b0, b1, 2048, [=](int first, int last) {
    for (int b = first; b < last; ++b) {
        if (kind[b] == STATIC) continue;
        const Real *const v = solved + 4 * b, *const d = way + 4 * b;
        position[2 * b] += d[0];
        position[2 * b + 1] += d[1];
        angle[b] += d[2];
        velocity[2 * b] = v[0];
        velocity[2 * b + 1] = v[1];
        spin[b] = v[2];
    }
});
return true;
