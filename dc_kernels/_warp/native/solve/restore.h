// Velocities of the bodies b0 .. b1 as they were predicted. Parameters: predicted, solved, b0, b1, team. Stands behind
// runtime/ranges.h.
const Real* const from = (const Real*)predicted.data;
Real* const to = (Real*)solved.data;
take_range(team, 4 * b0, 4 * b1, 8192, [=](int first, int last) {
    for (int i = first; i < last; ++i) to[i] = from[i];
});
