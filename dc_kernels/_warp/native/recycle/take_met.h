// Stores the contacts of the pairs from ``pair`` to ``looked`` of world w that meet_again.h has looked at, behind those
// ``found``, up to the first that is to be looked at in full: that pair, or ``looked``, and the contacts found by then.
// The first pair that it looked at is ``first``. Parameters: w, span (first, pair, looked), found, config, model,
// pairs, contacts. Macros: SHIFT_A, SHIFT_B, FIELDS, LANES. Stands behind recycle/scratch.h.
#if defined(__CUDA_ARCH__)
return wp::vec_t<2, int>(span[1], found);
#else
typedef long long Key;
typedef REAL Real;
typedef Real Point __attribute__((ext_vector_type(2), aligned(4)));
const int start = contacts.contact_start.data[w], room = contacts.contact_start.data[w + 1] - start;
const int first_shape = model.shape_start.data[w];
const bool slips = config.uniform_friction < 0, bounces = config.uniform_restitution < 0;
const int first = span[0], looked = span[2];
int next = span[1];
for (; next < looked; ++next) {
    const int slot = place[next - first];
    if (slot == -1 || slot == -3) break;
    if (slot < 0) continue;
    const Real* const of = met + slot / LANES * (LANES * FIELDS);
    const int lane = slot % LANES, bits = (int)of[12 * LANES + lane];
    auto point_at = [&](int field) { return ((const Point*)(of + field * LANES))[lane]; };
    const int one = pairs.shape_a.data[next], other = pairs.shape_b.data[next];
    const int edges = (int)of[13 * LANES + lane];
    auto edge = [&](int k) { return edges >> 3 * k & 7; };
    const bool flip = bits & 4;
    const int features[] = {flip ? edge(6) << 8 | edge(5) : edge(1) << 8 | edge(2),
                            flip ? edge(7) << 8 | edge(4) : edge(0) << 8 | edge(3)};
    const int f0 = bits & 8 ? features[1] : features[0], f1 = features[1];
    const int swap = (bits & 16) && f1 < f0;
    const Key shapes = (Key)(one - first_shape) << SHIFT_A | (Key)(other - first_shape) << SHIFT_B;
    for (int k = 0; k < 2; ++k) {
        const int i = k ^ swap;
        if (!(bits >> i & 1)) continue;
        if (found < room) {
            const int c = start + found;
            contacts.key.data[c] = shapes | (Key)(i ? f1 : f0);
            contacts.body_a.data[c] = model.shape_body.data[one];
            contacts.body_b.data[c] = model.shape_body.data[other];
            ((Point*)contacts.normal.data)[c] = point_at(0);
            ((Point*)contacts.arm_a.data)[c] = point_at(2 + 4 * i);
            ((Point*)contacts.arm_b.data)[c] = point_at(4 + 4 * i);
            contacts.gap.data[c] = of[(10 + i) * LANES + lane];
            Real mu = config.uniform_friction, e = config.uniform_restitution;
            if (slips) {
                const Real *const all = model.shape_friction.data, second = all[other];
                mu = all[one];
                mu = mu == second ? mu : wp::sqrt(mu * second);
            }
            if (bounces) {
                const Real *const all = model.shape_restitution.data, p = all[one], q = all[other];
                e = p > q ? p : q;
            }
            contacts.friction.data[c] = mu;
            contacts.restitution.data[c] = e;
        }
        ++found;
    }
}
return wp::vec_t<2, int>(next, found);
#endif
