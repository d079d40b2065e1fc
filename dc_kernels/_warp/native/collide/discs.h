// Contacts of the pairs of discs i0 .. i1 of world w, up to the first pair that has another shape, LANES pairs side by
// side: that pair, or i1, and the contacts found, to which they are added. The arithmetic is that of the scalar path of
// narrowphase.py, operation by operation; the centre of a disc is that of its body.
// Parameters: w, i0, i1, found, config, model, state, motion, pairs, contacts; where SHARED is 1, ends (i0 and i1) and
// team, which is not 0.
// Macros: DISC, SHIFT_A, SHIFT_B, FAST, SHARED, HOLDS (= or &). Stands behind prelude.h or runtime/ranges.h,
// predicted.h, solve/bodies.h and side.h.
#if SHARED
const int i0 = ends[0], i1 = ends[1];
#endif
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
const int known = contacts.contact_count.data[w], contacts_before = known < room ? known : room;
const Vector order = {0, 1, 2, 3, 4, 5, 6, 7};
auto root = [=](Vector v) { return __builtin_elementwise_sqrt(v); };
auto store_pairs = [=](Real* to, Vector x, Vector y) {
    store(to, __builtin_shufflevector(x, y, 0, 8, 1, 9, 2, 10, 3, 11));
    store(to + LANES, __builtin_shufflevector(x, y, 4, 12, 5, 13, 6, 14, 7, 15));
};
// a scene of one material need not look it up
const bool slips = config.uniform_friction < 0, bounces = config.uniform_restitution < 0;
const Real one_friction = config.uniform_friction, one_restitution = config.uniform_restitution;
const Real* const shape_friction = model.shape_friction.data;
const Real* const shape_restitution = model.shape_restitution.data;
auto friction_of = [=](int one, int other) {
    const Real mu = shape_friction[one], second = shape_friction[other];
    return mu == second ? mu : wp::sqrt(mu * second);
};
auto restitution_of = [=](int one, int other) {
    const Real e = shape_restitution[one], second = shape_restitution[other];
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
// Contacts of the pairs begin .. end, behind those found, as many as fit before `to`, up to the first that does not if
// it `stops` there: the next pair, and those found by then. One that is shared HOLDS copies: what another thread is
// given by its address would be read anew after each store. Where none is shared, copies cost small worlds a tenth.
auto scan = [HOLDS](int begin, int end, int found, int to, bool stops) {
    int next = begin;
    while (next < end) {
        int a[LANES], b[LANES], of_a[LANES], of_b[LANES], lanes = 0;
        for (; lanes < LANES && next + lanes < end; ++lanes) {
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
        if (stops && count > to - found) {
            next -= lanes;
            break;
        }
        const int fit = count < to - found ? count : to - found;
        for (int k = 0; k < fit; ++k) {
            const int i = which[k], c = start + found + k, one = a[i], other = b[i];
            key[c] = (Key)(one - first_shape) << SHIFT_A | (Key)(other - first_shape) << SHIFT_B;
            body_a[c] = of_a[i];
            body_b[c] = of_b[i];
            normal[c] = ((const Point*)normals)[i];
            arm_a[c] = ((const Point*)arms_a)[i];
            arm_b[c] = ((const Point*)arms_b)[i];
            contact_gap[c] = gaps[i];
            friction[c] = slips ? friction_of(one, other) : one_friction;
            restitution[c] = bounces ? restitution_of(one, other) : one_restitution;
        }
        found += count;
        if (lanes < LANES) break;
    }
    return wp::vec_t<2, int>(next, found);
};
#if !SHARED
return scan(i0, i1, found, room, false);
#else
auto scan_part = [=](int begin, int end, int found, int to)
                     __attribute__((noinline)) { return scan(begin, end, found, to, true); };
Team* const members = (Team*)team;
const int few = 1024;  // pairs of a part: 7 us
const int parts = members->size;
const bool helped = i1 - i0 >= few * (parts + 1) && is_helped(members);
// where other shapes lie between those of discs, all parts but the first would be for nothing
for (int begin = i0, limit = helped ? i0 + few : i1;;) {
    const auto ahead = scan(begin, limit, found, room, false);
    begin = ahead[0];
    found = ahead[1];
    if (limit == i1 || begin < limit || found > room - 2 * few) return ahead;
    // each part puts what it finds where it begins if those before it find what they found in the step before
    const int behind = found, most = room - few / 4;  // the rest is room for contacts beyond that
    struct Part {
        int next, begin, end, target;
    } parts_of[SEATS];
    Part* const part = parts_of;
    auto begin_of = [=](int p) { return Share::begin(members, begin, i1, p, parts); };
    auto known_before = [=](int pair) {
        const Key sought = (Key)(shape_a[pair] - first_shape) << SHIFT_A | (Key)(shape_b[pair] - first_shape)
                                                                               << SHIFT_B;
        int low = 0, high = contacts_before;
        while (low < high) {
            const int middle = (low + high) / 2;
            if (key[start + middle] < sought)
                low = middle + 1;
            else
                high = middle;
        }
        return low;
    };
    part[0].begin = behind;
    for (int p = 1; p < parts; ++p) {
        const int before = known_before(begin_of(p)), least = part[p - 1].begin;
        part[p].begin = before < least ? least : before < most ? before : most;
    }
    Phases phases;
    phases.first[0] = 0;
    phases.add(parts, parts, 1);
    take_phases(members, phases, [=](int first, int last) {
        for (int p = first; p < last; ++p) {
            const int to = p + 1 < parts ? part[p + 1].begin : most;
            const auto met = scan_part(begin_of(p), begin_of(p + 1), part[p].begin, to);
            part[p].next = met[0];
            part[p].end = met[1];
        }
        return 0.0;
    });
    // what did not fit, in the spare room; up to the first part that met another shape
    int rest[SEATS + 1], next = begin, count = 0;
    bool fits = true;
    rest[0] = most;
    while (count < parts && fits && next == begin_of(count)) {
        const int p = count++;
        const auto met = scan_part(part[p].next, begin_of(p + 1), rest[p], room);
        next = met[0];
        rest[p + 1] = met[1];
        part[p].target = found;
        found += part[p].end - part[p].begin + rest[p + 1] - rest[p];
        fits = next == begin_of(p + 1) || kind[shape_a[next]] != DISC || kind[shape_b[next]] != DISC;
    }
    if (!fits || found > most) {
        found = behind;
        limit = i1;
        continue;
    }
    auto move = [=](int from, int to, int count) {
        auto move_in = [=](void* array, size_t size) {
            char* const at = (char*)array + start * size;
            __builtin_memmove(at + to * size, at + from * size, count * size);
        };
        move_in(key, sizeof(Key));
        move_in(body_a, sizeof(int));
        move_in(body_b, sizeof(int));
        move_in(normal, sizeof(Point));
        move_in(arm_a, sizeof(Point));
        move_in(arm_b, sizeof(Point));
        move_in(contact_gap, sizeof(Real));
        move_in(friction, sizeof(Real));
        move_in(restitution, sizeof(Real));
    };
    // each thread moves what it found to its place, in an order in which none comes to lie on what has yet to be moved
    int turns = 0, turn_of[2 * SEATS];
    for (int p = 0; p < count; ++p)
        if (part[p].target < part[p].begin) turn_of[turns++] = p;
    for (int p = count - 1; p >= 0; --p)
        if (part[p].target > part[p].begin) turn_of[turns++] = p;
    if (turns > 0) {
        const int* const turn = turn_of;
        Phases moves;
        moves.first[0] = 0;
        for (int k = 1; k <= turns; ++k) moves.add(k * parts, parts, 1);
        take_phases(members, moves, [=](int first, int last) {
            for (int i = first; i < last; ++i) {
                const Part& moved = part[i % parts];
                if (i % parts == turn[i / parts]) move(moved.begin, moved.target, moved.end - moved.begin);
            }
            return 0.0;
        });
    }
    for (int p = 0; p < count; ++p) move(rest[p], part[p].target + part[p].end - part[p].begin, rest[p + 1] - rest[p]);
    return wp::vec_t<2, int>(next, found);
}
#endif
#endif
