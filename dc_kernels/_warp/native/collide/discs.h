// Contacts of the pairs of discs i0 .. i1 of world w, up to the first pair that has another shape, LANES pairs side by
// side: that pair, or i1, and the contacts found, to which they are added. The arithmetic is that of the scalar path of
// narrowphase.py, operation by operation; the centre of a disc is that of its body.
// Parameters: w, i0, i1, found, config, model, state, motion, pairs, contacts.
// Macros: DISC, SHIFT_A, SHIFT_B, FAST. Stands behind prelude.h, predicted.h, solve/bodies.h and side.h.
#if defined(__CUDA_ARCH__)
return wp::vec_t<2, int>(i0, found);  // a GPU takes pair after pair
#else
typedef long long Key;
typedef Real Point __attribute__((ext_vector_type(2), aligned(4)));
const int* const kind = model.shape_type.data;
const int* const shape_a = pairs.shape_a.data;
const int* const shape_b = pairs.shape_b.data;
const int* const body_of = model.shape_body.data;
const Real* const radius = model.shape_radius.data;
const Real* const position = (const Real*)state.position.data;
const Real step = motion.step_dt.data[w], reach = motion.reach.data[w], slop = config.slop * model.length_scale.data[w];
const int start = contacts.contact_start.data[w], room = contacts.contact_start.data[w + 1] - start;
const int first_shape = model.shape_start.data[w];
const Vector order = {0, 1, 2, 3, 4, 5, 6, 7};
auto root = [&](Vector v) { return __builtin_elementwise_sqrt(v); };
auto store_pairs = [&](Real* to, Vector x, Vector y) {
    store(to, __builtin_shufflevector(x, y, 0, 8, 1, 9, 2, 10, 3, 11));
    store(to + LANES, __builtin_shufflevector(x, y, 4, 12, 5, 13, 6, 14, 7, 15));
};
// a scene of one material need not look it up
const bool slips = config.uniform_friction < 0, bounces = config.uniform_restitution < 0;
auto friction_of = [&](int one, int other) {
    const Real mu = model.shape_friction.data[one], second = model.shape_friction.data[other];
    return mu == second ? mu : wp::sqrt(mu * second);
};
auto restitution_of = [&](int one, int other) {
    const Real e = model.shape_restitution.data[one], second = model.shape_restitution.data[other];
    return e > second ? e : second;
};
Key* const key = (Key*)contacts.key.data;
int* const body_a = contacts.body_a.data;
int* const body_b = contacts.body_b.data;
Point* const normal = (Point*)contacts.normal.data;
Point* const arm_a = (Point*)contacts.arm_a.data;
Point* const arm_b = (Point*)contacts.arm_b.data;
Real* const contact_gap = contacts.gap.data;
Real* const friction = contacts.friction.data;
Real* const restitution = contacts.restitution.data;
int next = i0;
while (next < i1) {
    int a[LANES], b[LANES], of_a[LANES], of_b[LANES], lanes = 0;
    for (; lanes < LANES && next + lanes < i1; ++lanes) {
        a[lanes] = shape_a[next + lanes];
        b[lanes] = shape_b[next + lanes];
        if (kind[a[lanes]] != DISC || kind[b[lanes]] != DISC) break;
    }
    if (lanes == 0) break;
    next += lanes;
    for (int i = lanes; i < LANES; ++i) {
        a[i] = a[0];
        b[i] = b[0];
    }
    for (int i = 0; i < LANES; ++i) {
        of_a[i] = body_of[a[i]];
        of_b[i] = body_of[b[i]];
    }
    const Bodies A = load_bodies(of_a), B = load_bodies(of_b);
    Vector xA, yA, xB, yB;
    pairs_at(position, of_a, xA, yA);
    pairs_at(position, of_b, xB, yB);
    const Vector rA = values_at(radius, a), rB = values_at(radius, b), radii = rA + rB;
    const Vector x = xB - xA, y = yB - yA, vx = B.x - A.x, vy = B.y - A.y, squared = x * x + y * y;
    const Vector far = radii + reach + step * (magnitude(vx) + magnitude(vy));
    // else asleep, both or beside what does not move (sleep/wake.py)
    const auto awake = (smaller(A.m, B.m) >= 0) | (larger(A.m, B.m) > 0);
    const auto near = awake & ~(squared > far * far);
    if (!any(near)) continue;
    const Vector length = root(squared);
    const auto apart = length > (Real)EPSILON * radii;
    const Vector nx = pick(apart, x / length, zero + (Real)1), ny = pick(apart, y / length, zero);
    Vector gap = length - rA - rB;
    const Vector along = rA + (Real)0.5 * gap, px = xA + nx * along, py = yA + ny * along;
    const Vector speed = nx * vx + ny * vy, closing = -speed * step;
    const auto passing = (gap > slop) & (gap < closing) & (root(vx * vx + vy * vy) * step > (Real)FAST * radii);
    if (any(passing)) {
        const Vector when = (x * vx + y * vy) / (vx * vx + vy * vy);
        const Vector missX = x - vx * when, missY = y - vy * when, endX = x + vx * step, endY = y + vy * step;
        const Vector later = larger(root(endX * endX + endY * endY) - radii + closing, gap);
        gap = pick(passing & (missX * missX + missY * missY >= radii * radii), later, gap);
    }
    const auto touching = near & (order < (Real)lanes) & (gap <= reach + larger(closing, zero));
    Real normals[2 * LANES], arms_a[2 * LANES], arms_b[2 * LANES], gaps[LANES];
    store_pairs(normals, nx, ny);
    store_pairs(arms_a, px - xA, py - yA);
    store_pairs(arms_b, px - xB, py - yB);
    store(gaps, gap);
    // which touch, without a branch that is guessed wrong every few pairs
    int which[LANES], count = 0;
    for (int i = 0; i < LANES; ++i) {
        which[count] = i;
        count += touching[i] != 0;
    }
    const int fit = count < room - found ? count : room - found;
    for (int k = 0; k < fit; ++k) {
        const int i = which[k], c = start + found + k, one = a[i], other = b[i];
        key[c] = (Key)(one - first_shape) << SHIFT_A | (Key)(other - first_shape) << SHIFT_B;
        body_a[c] = of_a[i];
        body_b[c] = of_b[i];
        normal[c] = ((const Point*)normals)[i];
        arm_a[c] = ((const Point*)arms_a)[i];
        arm_b[c] = ((const Point*)arms_b)[i];
        contact_gap[c] = gaps[i];
        friction[c] = slips ? friction_of(one, other) : config.uniform_friction;
        restitution[c] = bounces ? restitution_of(one, other) : config.uniform_restitution;
    }
    found += count;
    if (lanes < LANES) break;
}
return wp::vec_t<2, int>(next, found);
#endif
