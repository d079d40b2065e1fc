// Image of bodies, contacts and walls of a world before the solve, in the world's unit of length, what gravity moves a
// body by in the step; and what stays of bodies and contacts from round to round.
// Macros: BINS, BIN (channels of one), the channels MASS, WAY, FORCE, CONTACTS, WALL; DYNAMIC (code of a body),
// FLOATING, LEAST_GIVE; BODY_*, CONTACT_* (columns of what stays). Parameters: w, network, model, state, motion,
// contacts, asking. Behind learn/maps.h.
#if !defined(__CUDA_ARCH__)
const int first_body = model.body_start.data[w], bodies = model.body_start.data[w + 1] - first_body;
const int first = contacts.contact_start.data[w], count = contacts.contact_count.data[w];
const double dt = motion.step_dt.data[w];
const double gravity_x = model.gravity.data[w][0], gravity_y = model.gravity.data[w][1];
const double pull = sqrt(gravity_x * gravity_x + gravity_y * gravity_y);
const double unit = pull > 0 ? pull * dt * dt : (double)FLOATING * model.length_scale.data[w];
const Real speed = unit / dt, per_spacing = 1 / network.spacing;
const int near_pitch = padded(network.near), hidden_pitch = padded(network.kept);
auto body_at = [&](int body) { return asking.body_work.data + (size_t)body * asking.body_work.shape[1]; };
auto contact_at = [&](int i) { return asking.contact_work.data + (size_t)(first + i) * asking.contact_work.shape[1]; };
auto across = [&](int column, Real x) {
    return (x - (column == 0 ? network.origin_x : network.origin_y)) * per_spacing;
};
double mean = 0;
int dynamic = 0;
for (int b = first_body; b < first_body + bodies; ++b)
    if (model.body_type.data[b] == DYNAMIC) {
        mean += model.mass.data[b];
        ++dynamic;
    }
mean = dynamic && mean > 0 ? mean / dynamic : 1;
Vector value[image_vectors];
auto put = [&](int column, Real x) { value[column / LANES][column % LANES] = x; };
for (int b = first_body; b < first_body + bodies; ++b) {
    Real* const own = body_at(b);
    const bool moves = model.body_type.data[b] == DYNAMIC;
    own[BODY_MASS] = moves ? model.inv_mass.data[b] : 0;
    own[BODY_INERTIA] = moves ? model.inv_inertia.data[b] : 0;
    for (int i = 0; i < 3; ++i) own[BODY_WAY + i] = own[BODY_NOW + i] = motion.predicted.data[b][i] / speed;
    if (!moves) continue;
    for (int n = 0; n < image_vectors; ++n) value[n] = zero;
    put(MASS, (Real)(model.mass.data[b] / mean));
    for (int i = 0; i < 3; ++i) put(WAY + i, own[BODY_WAY + i]);
    for (int i = 0; i < 2; ++i) put(FORCE + i, (motion.predicted.data[b][i] - state.velocity.data[b][i]) / speed);
    splat(across(0, state.position.data[b][0]), across(1, state.position.data[b][1]), value);
}
// How B moves against A along normal and tangent.
struct Pair {
    Real n, t;
};
auto relative = [&](const Real* c, const Real* a, const Real* b) {
    const Real x = b[0] - a[0], y = b[1] - a[1], nx = c[CONTACT_NORMAL], ny = c[CONTACT_NORMAL + 1];
    return Pair{x * nx + y * ny + b[2] * c[CONTACT_TURN_B] - a[2] * c[CONTACT_TURN_A],
                x * ny - y * nx + b[2] * c[CONTACT_SPIN_B] - a[2] * c[CONTACT_SPIN_A]};
};
for (int i = 0; i < count; ++i) {
    Real* const own = contact_at(i);
    const int m = first + i, a = contacts.body_a.data[m], b = contacts.body_b.data[m];
    const Real *const of_a = body_at(a), *const of_b = body_at(b);
    const Real nx = contacts.normal.data[m][0], ny = contacts.normal.data[m][1];
    const Real ax = contacts.arm_a.data[m][0], ay = contacts.arm_a.data[m][1];
    const Real bx = contacts.arm_b.data[m][0], by = contacts.arm_b.data[m][1];
    own[CONTACT_NORMAL] = nx;
    own[CONTACT_NORMAL + 1] = ny;
    own[CONTACT_TURN_A] = ax * ny - ay * nx;
    own[CONTACT_TURN_B] = bx * ny - by * nx;
    own[CONTACT_SPIN_A] = -ax * nx - ay * ny;
    own[CONTACT_SPIN_B] = -bx * nx - by * ny;
    auto give = [&](Real turn_a, Real turn_b) {
        const Real sum = of_a[BODY_MASS] + of_b[BODY_MASS] + of_a[BODY_INERTIA] * turn_a * turn_a +
                         of_b[BODY_INERTIA] * turn_b * turn_b;
        return sum < (Real)LEAST_GIVE ? (Real)LEAST_GIVE : sum;
    };
    own[CONTACT_GIVE] = give(own[CONTACT_TURN_A], own[CONTACT_TURN_B]);
    own[CONTACT_GIVE + 1] = give(own[CONTACT_SPIN_A], own[CONTACT_SPIN_B]);
    const Real apart = contacts.gap.data[m];
    const Real gap = own[CONTACT_GAP] = (apart > 0 ? apart : 0) / unit;
    own[CONTACT_IMPULSE] = own[CONTACT_IMPULSE + 1] = 0;
    const Pair moves = relative(own, of_a + BODY_WAY, of_b + BODY_WAY);
    // direction of the line, whichever body is A
    const bool flip = ny < 0 || (ny == 0 && nx < 0);
    const Real turn = wp::atan2(flip ? -ny : ny, flip ? -nx : nx) * (Real)(1 / 3.14159265358979323846);
    const int at = CONTACTS + BIN * ((int)(turn * BINS + (Real)0.5) % BINS);
    for (int n = 0; n < image_vectors; ++n) value[n] = zero;
    put(at, 1);
    put(at + 1, gap);
    put(at + 2, moves.n + gap < 0 ? moves.n + gap : 0);
    put(at + 3, moves.t);
    splat(across(0, state.position.data[a][0] + ax), across(1, state.position.data[a][1] + ay), value);
}
for (int y = 0; y < image.rows; ++y) {
    const Real* const wall = asking.wall.data + ((size_t)w * image.rows + y) * image.columns;
    for (int x = 0; x < image.columns; ++x) image.at[(size_t)y * image.row_pitch + x * image.pitch + WALL] = wall[x];
}
#endif
