// Manifolds of pairs of a polygon or capsule and a disc about its body's centre, LANES pairs side by side, of those
// that meet_again.h has looked at, ``ends``: they are put behind its slots, of which ``place[CHUNK]`` are
// used. A pair that moves is left to be looked at in full, as closing.py may meet it elsewhere. The arithmetic is that
// of narrowphase.py and of ``hull_disc`` in manifold.py, operation by operation. Parameters: w, ends, lengths (slack,
// overlap, speculative), model, state, motion, pairs. Macros: DISC, POLYGON, EPSILON, HORIZON, CHUNK,
// FIELDS. Stands behind prelude.h, predicted.h, solve/bodies.h, side.h, recycle/sides.h and scratch.h.
#if !defined(__CUDA_ARCH__)
const int first = ends[0], last = ends[1];
const Real slack = lengths[0], speculative = lengths[2];
const int *const kind = model.shape_type.data, *const body_of = model.shape_body.data;
const int* const vertex_start = model.vertex_start.data;
const int *const shape_a = pairs.shape_a.data, *const shape_b = pairs.shape_b.data;
const Real* const centers = (const Real*)model.shape_center.data;
const Real step = motion.step_dt.data[w];
const int count = last - first, used = place[CHUNK];
int listed[CHUNK + LANES], lists = 0;
for (int i = 0; i < count; ++i) {
    const int a = shape_a[first + i], b = shape_b[first + i];
    const int disc = kind[a] == DISC ? a : b;
    listed[lists] = i;
    lists += (kind[a] + kind[b] == DISC + POLYGON) & (centers[2 * disc] == 0) & (centers[2 * disc + 1] == 0);
}
if (lists < FEW) return;
for (int i = lists; i < lists + LANES - 1; ++i) listed[i] = listed[lists - 1];
for (int begin = 0; begin < lists; begin += LANES) {
    int a[LANES], b[LANES], of_a[LANES], of_b[LANES], hull[LANES], disc[LANES], of_hull[LANES], of_disc[LANES];
    int start[LANES], corners = 0;
    Real counts[LANES], sides[LANES];
    for (int l = 0; l < LANES; ++l) {
        const int pair = first + listed[begin + l];
        a[l] = shape_a[pair];
        b[l] = shape_b[pair];
        of_a[l] = body_of[a[l]];
        of_b[l] = body_of[b[l]];
        const bool turned = kind[a[l]] == DISC;
        hull[l] = turned ? b[l] : a[l];
        disc[l] = turned ? a[l] : b[l];
        of_hull[l] = turned ? of_b[l] : of_a[l];
        of_disc[l] = turned ? of_a[l] : of_b[l];
        sides[l] = turned ? -1 : 1;
        start[l] = vertex_start[hull[l]];
        const int own = vertex_start[hull[l] + 1] - start[l];
        counts[l] = (Real)own;
        corners = own > corners ? own : corners;
    }
    const Bodies A = load_bodies(of_a), B = load_bodies(of_b);
    // else asleep, both or beside what does not move (sleep/wake.py)
    auto near = (smaller(A.m, B.m) >= 0) | (larger(A.m, B.m) > 0);
    const Side at_a = side_at(state.position, of_a), at_b = side_at(state.position, of_b), d = minus(at_b, at_a);
    const Side center_a = side_at(model.shape_center, a), center_b = side_at(model.shape_center, b);
    const Vector bound_a = magnitude(center_a.x) + magnitude(center_a.y) + values_at(model.shape_extent.data, a);
    const Vector bound_b = magnitude(center_b.x) + magnitude(center_b.y) + values_at(model.shape_extent.data, b);
    const Side drift = {B.x - A.x, B.y - A.y};
    const Side before_a = side_at(state.velocity, of_a), before_b = side_at(state.velocity, of_b);
    const Side passing = minus(before_b, before_a);
    const Vector spin_a = values_at(state.angular_velocity.data, of_a);
    const Vector spin_b = values_at(state.angular_velocity.data, of_b);
    Vector way = magnitude(drift.x) + magnitude(drift.y) + magnitude(A.w) * bound_a + magnitude(B.w) * bound_b;
    way += (Real)(2.0 * HORIZON) *
           (magnitude(passing.x) + magnitude(passing.y) +
            (magnitude(spin_a) + magnitude(spin_b)) * (magnitude(d.x) + magnitude(d.y) + bound_a + bound_b));
    const Vector far = bound_a + bound_b + speculative + step * way;
    near = near & ~(dot(d, d) > far * far);
    if (!any(near)) {
        for (int l = 0; l < LANES && begin + l < lists; ++l) place[listed[begin + l]] = -2;
        continue;
    }
    const Side turn = side_at(pairs.turn, of_hull);
    const Side at_hull = side_at(state.position, of_hull), at_disc = side_at(state.position, of_disc);
    const Vector c = turn.x, s = turn.y, side = load(sides);
    const Side arm = minus(at_disc, at_hull), p = turned_back(c, s, arm);
    // from the hull to the disc, before the step's forces
    const Side to_disc = minus(side_at(state.velocity, of_disc), side_at(state.velocity, of_hull));
    const Vector spin_hull = values_at(state.angular_velocity.data, of_hull);
    const Vector spin_disc = values_at(state.angular_velocity.data, of_disc);
    const Side none = minus(at_disc, at_disc);
    const Side turning = minus({-none.y * spin_disc, none.x * spin_disc}, {-arm.y * spin_hull, arm.x * spin_hull});
    const Side moving = turned_back(c, s, plus(to_disc, turning));
    const auto full = near & (dot(moving, moving) * step * step > zero + slack * slack);

    const Vector number = load(counts);
    Vector best = (Real)-1e30;
    Side normal = none, v1 = none, v2 = none, first_corner = none, corner = none, next_corner = none;
    for (int i = 0; i <= corners; ++i) {
        // the corners one after the other, and the first again
        int index[LANES];
        for (int l = 0; l < LANES; ++l) index[l] = start[l] + (i < (int)counts[l] ? i : 0);
        next_corner = side_at(model.vertices, index);
        if (i > 0) {
            // the edge from ``corner``, which lies at i - 1, to this one
            int own[LANES];
            for (int l = 0; l < LANES; ++l) own[l] = start[l] + (i - 1 < (int)counts[l] ? i - 1 : 0);
            const Side of_edge = side_at(model.vertex_normals, own);
            const Vector distance = dot(of_edge, minus(p, corner));
            const auto better = (distance > best) & ((Real)(i - 1) < number);
            best = pick(better, distance, best);
            normal = choose(better, of_edge, normal);
            v1 = choose(better, corner, v1);
            v2 = choose(better, next_corner, v2);
        }
        corner = next_corner;
    }
    const Side along = minus(v2, v1);
    const Vector u = dot(minus(p, v1), along), squared = dot(along, along);
    const auto outside = best > 0, flat = ~outside & (number == (Real)2);
    const auto at_first = (outside & (u <= 0)) | (flat & (u < 0));
    const auto at_second = ~at_first & ((outside & (u >= squared)) | (flat & (u > squared)));
    const Vector radius = values_at(model.shape_radius.data, hull), r = values_at(model.shape_radius.data, disc);
    const auto cornered = at_first | at_second;
    const Side q = choose(at_first, v1, v2), from_corner = minus(p, q);
    const Vector length = length_of(from_corner), distance = pick(cornered, length, best);
    const Side pointing = {from_corner.x / length, from_corner.y / length};
    normal = choose(cornered & (length > (Real)EPSILON * (radius + r)), pointing, normal);
    const Vector gap = distance - radius - r;
    const Side local = minus(p, times(normal, r + (Real)0.5 * gap));
    const Side outward = turned(c, s, normal), point = plus(turned(c, s, local), at_hull);
    normal = {outward.x * side, outward.y * side};
    const Side arm_a = minus(point, at_a), arm_b = minus(point, at_b);
    const Vector speed =
        normal.x * drift.x + normal.y * drift.y + (cross(arm_b, normal) * B.w - cross(arm_a, normal) * A.w);
    const auto found = near & (gap <= speculative + larger(-speed * step, zero));
    const int slot = used + begin;
    Real* const to = met + slot * FIELDS;
    store_points(to, normal);
    store_points(to + 2 * LANES, arm_a);
    store_points(to + 4 * LANES, arm_b);
    store(to + 10 * LANES, gap);
    store(to + 12 * LANES, zero + (Real)1);
    store(to + 13 * LANES, zero);
    for (int l = 0; l < LANES && begin + l < lists; ++l)
        place[listed[begin + l]] = full[l] ? -1 : found[l] ? slot + l : -2;
}
#endif
