// Momentum of the velocities of the bodies b0 .. b1, which follow the impulses by linearity.
// Parameters: bodies, before, at, b0, b1, beta, team. Stands behind runtime/ranges.h.
Real *const now = (Real*)bodies.data, *const past = before.data + at - 4 * b0;
take_range(team, 4 * b0, 4 * b1, 4096, [=](int first, int last) {
    for (int i = first; i < last; ++i) {
        const Real v = now[i];
        now[i] = v + beta * (v - past[i]);
        past[i] = v;
    }
});
