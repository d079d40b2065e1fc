// Contacts of the pairs of discs i0 .. i1 of world w, up to the first pair that has another shape, LANES pairs side by
// side: that pair, or i1, and the contacts found, to which they are added. The arithmetic is that of the scalar path of
// narrowphase.py, operation by operation; the centre of a disc is that of its body.
// Parameters: w, i0, i1, found, config, model, state, motion, pairs, contacts.
// Macros: DISC, SHIFT_A, SHIFT_B, FAST. Stands behind prelude.h, predicted.h, solve/bodies.h and side.h.
#if defined(__CUDA_ARCH__)
return wp::vec_t<2, int>(i0, found);  // a GPU takes pair after pair
#else
typedef long long Key;
const int* const kind = model.shape_type.data;
const int* const shape_a = pairs.shape_a.data;
const int* const shape_b = pairs.shape_b.data;
const int* const body_of = model.shape_body.data;
const Real* const radius = model.shape_radius.data;
const Real* const position = (const Real*)state.position.data;
const Real step = motion.step_dt.data[w], reach = motion.reach.data[w], slop = config.slop * model.length_scale.data[w];
const int start = contacts.contact_start.data[w], room = contacts.contact_start.data[w + 1] - start;
const int first_shape = model.shape_start.data[w];
auto root = [&](Vector v) { return __builtin_elementwise_sqrt(v); };
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
    const auto touching = near & (gap <= reach + larger(closing, zero));
    const Vector aX = px - xA, aY = py - yA, bX = px - xB, bY = py - yB;
    for (int i = 0; i < lanes; ++i) {
        if (!touching[i]) continue;
        if (found < room) {
            const int c = start + found;
            const int one = a[i], other = b[i];
            Real mu = config.uniform_friction, e = config.uniform_restitution;
            if (mu < 0) {
                mu = model.shape_friction.data[one];
                const Real second = model.shape_friction.data[other];
                if (second != mu) mu = wp::sqrt(mu * second);
            }
            if (e < 0) {
                const Real first = model.shape_restitution.data[one], second = model.shape_restitution.data[other];
                e = first > second ? first : second;
            }
            contacts.key.data[c] = (Key)(one - first_shape) << SHIFT_A | (Key)(other - first_shape) << SHIFT_B;
            contacts.body_a.data[c] = of_a[i];
            contacts.body_b.data[c] = of_b[i];
            contacts.normal.data[c] = wp::vec_t<2, Real>(nx[i], ny[i]);
            contacts.arm_a.data[c] = wp::vec_t<2, Real>(aX[i], aY[i]);
            contacts.arm_b.data[c] = wp::vec_t<2, Real>(bX[i], bY[i]);
            contacts.gap.data[c] = gap[i];
            contacts.friction.data[c] = mu;
            contacts.restitution.data[c] = e;
        }
        ++found;
    }
    if (lanes < LANES) break;
}
return wp::vec_t<2, int>(next, found);
#endif
