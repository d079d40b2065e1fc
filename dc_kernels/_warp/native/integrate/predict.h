// Velocities of the bodies b0 .. b1 of world w with forces and gravity applied, and their inverse masses, into
// motion.predicted; how far contacts look ahead into motion.reach. Returns whether all are finite, and time and origin.
// Parameters: w, b0, b1, config, model, state, motion, team. Macros: STATIC, DYNAMIC, TRAITS. Stands behind
// runtime/ranges.h.
const Real dt = motion.step_dt.data[w], gx = model.gravity.data[w][0], gy = model.gravity.data[w][1];
const int* const kind = model.body_type.data;
const Real *const inv_mass = model.inv_mass.data, *const inv_inertia = model.inv_inertia.data;
const Real *const velocity = (const Real*)state.velocity.data, *const spin = state.angular_velocity.data;
const Real *const force = (const Real*)state.force.data, *const torque = state.torque.data;
Real* const predicted = (Real*)motion.predicted.data;
#if TRAITS
const Real *const gravity_scale = model.gravity_scale.data, *const linear_damping = model.linear_damping.data;
const Real* const angular_damping = model.angular_damping.data;
// What v has become after dt where dv/dt = a - rate v: exact, whatever rate and dt.
auto damped = [=](Real v, Real a, Real rate) {
    const Real x = rate * dt, kept = wp::exp(-x);
    Real share = (1 - kept) / (x > (Real)0.1 ? x : (Real)0.1);  // of dt, in which a acts undamped
    if (x < (Real)0.1) {  // the difference above has few digits: Taylor's series of (1 - exp(-x)) / x
        share = 1 - x / 7;
        for (int k = 6; k > 1; --k) share = 1 - x / (Real)k * share;
    }
    return v * kept + a * (dt * share);
};
#endif
struct Found {
    Real fastest, check;  // the largest squared speed; x - x of all: 0 for a finite x, NaN for inf and NaN
    int moving;
    Found& operator+=(const Found& other) {
        fastest = fastest > other.fastest ? fastest : other.fastest;
        check += other.check;
        moving += other.moving;
        return *this;
    }
};
const Found found = add_range(team, b0, b1, 1024, [=](int first, int last) {
    Found of = {0, 0, 0};
    for (int b = first; b < last; ++b) {
        Real x = 0, y = 0, turn = 0, m = 0;
        if (kind[b] == DYNAMIC) {
            m = inv_mass[b];
            const Real *const v = velocity + 2 * b, *const f = force + 2 * b;
#if TRAITS
            const Real s = gravity_scale[b], rate = linear_damping[b];
            x = damped(v[0], gx * s + f[0] * m, rate);
            y = damped(v[1], gy * s + f[1] * m, rate);
            turn = damped(spin[b], torque[b] * inv_inertia[b], angular_damping[b]);
#else
            x = v[0] + (gx + f[0] * m) * dt;
            y = v[1] + (gy + f[1] * m) * dt;
            turn = spin[b] + torque[b] * inv_inertia[b] * dt;
#endif
            ++of.moving;
        } else if (kind[b] != STATIC) {
            x = velocity[2 * b];
            y = velocity[2 * b + 1];
            turn = spin[b];
        } else {  // what hits it looks at its velocity, which stays what was written
            const Real vx = velocity[2 * b], vy = velocity[2 * b + 1], s = spin[b];
            of.check += (vx - vx) + (vy - vy) + (s - s);
        }
        Real* const to = predicted + 4 * b;
        to[0] = x;
        to[1] = y;
        to[2] = turn;
        to[3] = m;
        of.check += (x - x) + (y - y) + (turn - turn);
        const Real square = x * x + y * y;
        of.fastest = of.fastest > square ? of.fastest : square;
    }
    return of;
});
const double time = state.time.data[w], left = model.origin.data[w][0], low = model.origin.data[w][1];
if (found.check != 0 || (time - time) + (left - left) + (low - low) != 0) return false;
const Real scale = model.length_scale.data[w], least = config.speculative * scale;
const Real most = config.speculative_max * scale;
Real way = wp::sqrt(found.fastest) * dt;
if (way > least && found.moving > 0) {  // else the mean, which shortens it at most, need not be known
    Real squares = 0;
    for (int b = b0; b < b1; ++b) {
        const Real x = predicted[4 * b], y = predicted[4 * b + 1];
        if (kind[b] == DYNAMIC) squares += x * x + y * y;
    }
    const Real spread = (Real)16 * squares / (Real)found.moving;
    way = wp::sqrt(found.fastest < spread ? found.fastest : spread) * dt;
}
way = way < most ? way : most;
motion.reach.data[w] = way > least ? way : least;
return true;
