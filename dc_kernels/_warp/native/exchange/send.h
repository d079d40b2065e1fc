// Solved velocities of the bodies b0 .. b1, impulses and colours of the contacts i0 .. i1, to their owner; nothing
// where a velocity is not finite: how many are not. Parameters: taken, motion, contacts, b0, b1, i0, i1. Macros: REAL.
const auto* const solved = motion.solved.data;
int bad = 0;
for (int i = b0; i < b1; ++i) {
    // 0 x is 0 for a finite x, NaN for inf and NaN
    bad += (REAL)0 * solved[i][0] + (REAL)0 * solved[i][1] + (REAL)0 * solved[i][2] != 0;
}
if (bad) return bad;
auto* const velocity = taken.velocity.data;
REAL* const spin = taken.angular_velocity.data;
for (int i = b0; i < b1; ++i) {
    velocity[i][0] = solved[i][0];
    velocity[i][1] = solved[i][1];
    spin[i] = solved[i][2];
}
auto* const impulse = taken.impulse.data;
for (int i = i0; i < i1; ++i) impulse[i] = contacts.impulse.data[i];
for (int i = i0; taken.color.shape[0] > 0 && i < i1; ++i) taken.color.data[i] = contacts.color.data[i];
return 0;
