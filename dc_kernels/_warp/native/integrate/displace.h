// What the solved velocities move the bodies b0 .. b1 by in a time dt, into motion.displacement.
// Parameters: b0, b1, dt, motion, team. Stands behind runtime/ranges.h.
const Real* const solved = (const Real*)motion.solved.data;
Real* const displacement = (Real*)motion.displacement.data;
take_range(team, b0, b1, 2048, [=](int first, int last) {
    for (int i = 4 * first; i < 4 * last; i += 4) {
        const Real x = solved[i], y = solved[i + 1], turn = solved[i + 2], m = solved[i + 3];
        displacement[i] = x * dt;
        displacement[i + 1] = y * dt;
        displacement[i + 2] = turn * dt;
        displacement[i + 3] = m;
    }
});
