// For how long the bodies b0 .. b1 have rested: the time step is added to the rest time of each that is dynamic, awake
// and slow; that of others that are awake is made zero. A kinematic body that moves is seen where it is. Returns
// whether any is awake or moves (1), and whether any has rested for so long that it may sleep (RESTED). Bits are
// gathered, as the maximum of floats, which may be NaN, is not vectorised. Parameters: model, state, sleepers, b0, b1,
// slow, dt, size, g, enough.
const int *const kind = model.body_type.data, *const asleep = sleepers.asleep.data;
const REAL* const v = (const REAL*)state.velocity.data;
const REAL* const spin = state.angular_velocity.data;
REAL* const rest_time = sleepers.rest_time.data;
const REAL arm = (REAL)0.5 * size;
int lively = 0, rested_enough = 0, moving = 0;
for (int b = b0; b < b1; ++b) {
    const int counts = (kind[b] == DYNAMIC) & (asleep[b] == AWAKE);
    const REAL x = v[2 * b], y = v[2 * b + 1], rim = arm * spin[b], before = rest_time[b];
    const int still = (x * x + y * y <= slow) & (rim * rim <= slow);
    const REAL rested = still ? before + dt : (REAL)0;
    rest_time[b] = counts ? rested : before;
    lively |= counts;
    rested_enough |= counts & (g > 0) & (rested > 0) & (rested * rested * g >= enough);
    moving |= (kind[b] == KINEMATIC) & ((x != 0) | (y != 0) | (spin[b] != 0));
}
if (moving)
    for (int b = b0; b < b1; ++b)
        if (kind[b] == KINEMATIC && (v[2 * b] != 0 || v[2 * b + 1] != 0 || spin[b] != 0)) {
            sleepers.position.data[b] = state.position.data[b];
            sleepers.angle.data[b] = state.angle.data[b];
        }
return (lively | moving) + RESTED * rested_enough;
