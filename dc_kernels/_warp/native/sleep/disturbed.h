// Whether a number of the bodies b0 .. b1 is another than a dormant world has: at rest, and as last seen.
// Parameters: state, sleepers, b0, b1.
int other = 0;
const REAL* const v = (const REAL*)state.velocity.data;
for (int i = 2 * b0; i < 2 * b1; ++i) other |= v[i] != 0;
for (int i = b0; i < b1; ++i) other |= state.angular_velocity.data[i] != 0;
const REAL* const x = (const REAL*)state.position.data;
const REAL* const seen = (const REAL*)sleepers.position.data;
for (int i = 2 * b0; i < 2 * b1; ++i) other |= x[i] != seen[i];
for (int i = b0; i < b1; ++i) other |= state.angle.data[i] != sleepers.angle.data[i];
const REAL* const force = (const REAL*)state.force.data;
const REAL* const applied = (const REAL*)sleepers.force.data;
for (int i = 2 * b0; i < 2 * b1; ++i) other |= force[i] != applied[i];
for (int i = b0; i < b1; ++i) other |= state.torque.data[i] != sleepers.torque.data[i];
return other;
