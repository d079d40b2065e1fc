// Momentum of the velocities of the bodies b0 .. b1, which follow the impulses by linearity.
// Parameters: bodies, before, at, b0, b1, beta.
Real* const now = (Real*)bodies.data;
Real* const last = before.data + at - 4 * b0;
for (int i = 4 * b0; i < 4 * b1; ++i) {
    const Real v = now[i];
    now[i] = v + beta * (v - last[i]);
    last[i] = v;
}
