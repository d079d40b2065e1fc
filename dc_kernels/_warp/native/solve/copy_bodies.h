// Velocities of the bodies b0 .. b1 into a history, four numbers a body. Parameters: bodies, history, at, b0, b1, team.
// Stands behind runtime/ranges.h.
const Real* const from = (const Real*)(bodies.data + b0);
Real* const to = history.data + at;
take_range(team, 0, 4 * (b1 - b0), 8192, [=](int first, int last) {
    for (int i = first; i < last; ++i) to[i] = from[i];
});
