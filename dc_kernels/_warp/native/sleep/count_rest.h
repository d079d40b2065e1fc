// For how long the bodies b0 .. b1 have rested: the time step is added to the rest time of each that is dynamic, awake
// and slow; that of others that are awake is made zero. A kinematic body that moves is seen where it is. Returns the
// longest time, or -1 where none is awake or moves. Parameters: model, state, sleepers, b0, b1, slow, dt, size.
const int *const kind = model.body_type.data, *const asleep = sleepers.asleep.data;
const REAL* const v = (const REAL*)state.velocity.data;
const REAL* const spin = state.angular_velocity.data;
REAL* const rest_time = sleepers.rest_time.data;
const REAL arm = (REAL)0.5 * size;
REAL longest = -1;
int moving = 0;
for (int b = b0; b < b1; ++b) {
    const int counts = (kind[b] == DYNAMIC) & (asleep[b] == AWAKE);
    const REAL x = v[2 * b], y = v[2 * b + 1], rim = arm * spin[b];
    const int still = (x * x + y * y <= slow) & (rim * rim <= slow);
    const REAL rested = still ? rest_time[b] + dt : (REAL)0;
    const REAL counted = counts ? rested : (REAL)-1;
    rest_time[b] = counts ? rested : rest_time[b];
    longest = counted > longest ? counted : longest;
    moving |= (kind[b] == KINEMATIC) & ((x != 0) | (y != 0) | (spin[b] != 0));
}
if (moving) {
    longest = longest > 0 ? longest : (REAL)0;
    for (int b = b0; b < b1; ++b)
        if (kind[b] == KINEMATIC && (v[2 * b] != 0 || v[2 * b + 1] != 0 || spin[b] != 0)) {
            sleepers.position.data[b] = state.position.data[b];
            sleepers.angle.data[b] = state.angle.data[b];
        }
}
return longest;
