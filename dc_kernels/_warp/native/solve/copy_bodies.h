// Velocities of the bodies b0 .. b1 into a history, four numbers a body. Parameters: bodies, history, at, b0, b1.
const Real* const from = (const Real*)(bodies.data + b0);
Real* const to = history.data + at;
for (int i = 0; i < 4 * (b1 - b0); ++i) to[i] = from[i];
