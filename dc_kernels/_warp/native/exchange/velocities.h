// Velocities of the bodies b0 .. b1 and start impulses of the contacts i0 .. i1 as their owner gives them, and how many
// are not finite. Velocities before the step's forces are those with them where none are given; masses are those that
// the rows were made with where they are kept.
// Parameters: kept, given, model, state, motion, contacts, b0, b1, i0, i1. Macros: REAL.
const auto* const v = given.velocity.data;
const REAL* const spin = given.angular_velocity.data;
const bool before = given.velocity_before.shape[0] > 0;
const auto* const v0 = before ? given.velocity_before.data : v;
const REAL* const spin0 = before ? given.angular_velocity_before.data : spin;
auto* const predicted = motion.predicted.data;
auto* const velocity = state.velocity.data;
REAL* const angular_velocity = state.angular_velocity.data;
int bad = 0;
for (int i = b0; i < b1; ++i) {
    predicted[i][0] = v[i][0];
    predicted[i][1] = v[i][1];
    predicted[i][2] = spin[i];
    // 0 x is 0 for a finite x, NaN for inf and NaN
    bad += (REAL)0 * v[i][0] + (REAL)0 * v[i][1] + (REAL)0 * spin[i] != 0;
}
for (int i = b0; !kept && i < b1; ++i) predicted[i][3] = model.inv_mass.data[i];
for (int i = b0; before && i < b1; ++i) bad += (REAL)0 * v0[i][0] + (REAL)0 * v0[i][1] + (REAL)0 * spin0[i] != 0;
for (int i = b0; i < b1; ++i) velocity[i] = v0[i];
for (int i = b0; i < b1; ++i) angular_velocity[i] = spin0[i];
const auto* const start = given.impulse.data;
auto* const impulse = contacts.impulse.data;
for (int i = i0; i < i1; ++i) {
    impulse[i] = start[i];
    bad += (REAL)0 * start[i][0] + (REAL)0 * start[i][1] != 0;
}
return bad;
