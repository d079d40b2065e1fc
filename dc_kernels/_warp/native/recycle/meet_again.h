// Manifolds of pairs of hulls by the edges and corners that are kept of them (collide/recycle.py), LANES pairs side by
// side, of the first CHUNK pairs of ``ends`` of world w at most: returns behind which it stopped. In
// ``place`` each pair has a slot of ``met`` (FIELDS numbers, LANES slots side by side), or -2 where it has no contact,
// or -1 where it has to be looked at in full, or
// -3 where that costs less. The arithmetic is that of narrowphase.py and hull_hull.h, operation by
// operation. Parameters: w, ends, lengths (slack, overlap, speculative), model, state, motion, pairs.
// Macros: POLYGON, EPSILON, PARALLEL, CHUNK, FIELDS. Stands behind prelude.h, predicted.h, solve/bodies.h, side.h and
// recycle/sides.h and scratch.h.
#if defined(__CUDA_ARCH__)
return ends[0];  // a GPU takes pair after pair
#else
const int first = ends[0], last = ends[1];
const Real slack = lengths[0], overlap = lengths[1], speculative = lengths[2];
const int *const kind = model.shape_type.data, *const body_of = model.shape_body.data;
const int* const vertex_start = model.vertex_start.data;
const int *const shape_a = pairs.shape_a.data, *const shape_b = pairs.shape_b.data;
const int *const near_of = pairs.temp_b.data, *const kept_edges = pairs.kept_edges.data;
const auto* const kept_bound = pairs.kept_bound.data;
const int start = pairs.start.data[w], room = pairs.start.data[w + 1] - start;
const int kept = start + pairs.kept_side.data[w] * room;  // and the place of the near pair
const Real step = motion.step_dt.data[w];
const int count = last - first < CHUNK ? last - first : CHUNK;
int listed[CHUNK + LANES], lists = 0;
for (int i = 0; i < count; ++i) {
    const int a = shape_a[first + i], b = shape_b[first + i];
    place[i] = -1;
    listed[lists] = i;
    lists += (kind[a] == POLYGON) & (kind[b] == POLYGON) && kept_bound[kept + near_of[first + i]][1] >= 0;
}
if (lists % LANES == 1) place[listed[--lists]] = -3;  // a full test costs half of what LANES of them cost here
for (int i = lists; lists > 0 && i < lists + LANES - 1; ++i) listed[i] = listed[lists - 1];
for (int begin = 0; begin < lists; begin += LANES) {
    int a[LANES], b[LANES], of_a[LANES], of_b[LANES], from[LANES];
    int a1[LANES], a2[LANES], b1[LANES], b2[LANES], other_a1[LANES], other_a2[LANES], other_b1[LANES], other_b2[LANES];
    Real segments[LANES], edges[LANES];
    for (int l = 0; l < LANES; ++l) {
        const int pair = alone(first + listed[begin + l]);
        a[l] = shape_a[pair];
        b[l] = shape_b[pair];
        of_a[l] = body_of[a[l]];
        of_b[l] = body_of[b[l]];
        from[l] = kept + near_of[pair];
        const int packed = kept_edges[from[l]], va = vertex_start[a[l]], vb = vertex_start[b[l]];
        a1[l] = va + (packed & 7);
        a2[l] = va + (packed >> 3 & 7);
        b1[l] = vb + (packed >> 6 & 7);
        b2[l] = vb + (packed >> 9 & 7);
        other_b1[l] = vb + (packed >> 12 & 7);
        other_b2[l] = vb + (packed >> 15 & 7);
        other_a1[l] = va + (packed >> 18 & 7);
        other_a2[l] = va + (packed >> 21 & 7);
        edges[l] = (Real)(packed & 0xffffff);
        segments[l] = (Real)(packed >> 24);
    }
    const Bodies A = load_bodies(of_a), B = load_bodies(of_b);
    // else asleep, both or beside what does not move (sleep/wake.py)
    auto near = (smaller(A.m, B.m) >= 0) | (larger(A.m, B.m) > 0);
    const Side at_a = side_at(state.position, of_a), at_b = side_at(state.position, of_b), d = minus(at_b, at_a);
    const Side center_a = side_at(model.shape_center, a), center_b = side_at(model.shape_center, b);
    const Vector extent_a = values_at(model.shape_extent.data, a), extent_b = values_at(model.shape_extent.data, b);
    const Side drift = {B.x - A.x, B.y - A.y};
    // too far apart, even if they close at their full relative speed
    const Vector bound_a = magnitude(center_a.x) + magnitude(center_a.y) + extent_a;
    const Vector bound_b = magnitude(center_b.x) + magnitude(center_b.y) + extent_b;
    const Vector way = magnitude(drift.x) + magnitude(drift.y) + magnitude(A.w) * bound_a + magnitude(B.w) * bound_b;
    const Vector far = bound_a + bound_b + speculative + step * way;
    near = near & ~(dot(d, d) > far * far);
    const Vector size_a = length_of(center_a) + extent_a, size_b = length_of(center_b) + extent_b;
    const Vector within = speculative + step * (length_of(drift) + magnitude(A.w) * size_a + magnitude(B.w) * size_b);
    near = near & ~(length_of(d) > size_a + size_b + within);

    const Side turn_a = side_at(pairs.turn, of_a), turn_b = side_at(pairs.turn, of_b);
    const Vector ca = turn_a.x, sa = turn_a.y, cb = turn_b.x, sb = turn_b.y;
    const Vector c = ca * cb + sa * sb, s = ca * sb - sa * cb;
    const Side x = turned_back(ca, sa, d), back = turned_back(c, s, x), x_back = {-back.x, -back.y};
    // how far they have moved against each other at most since all edges and corners were looked at
    const Bodies pose = load_from((const Real*)pairs.kept_frame.data, from);
    Real bounds[3][LANES];
    for (int l = 0; l < LANES; ++l)
        for (int k = 0; k < 3; ++k) bounds[k][l] = kept_bound[from[l]][k];
    const Vector moved = load(bounds[0]) * (magnitude(c - pose.x) + magnitude(s - pose.y)) +
                         (magnitude(x.x - pose.w) + magnitude(x.y - pose.m));
    auto full = near & ~(moved <= load(bounds[1]));

    // separations along the two edges, whose bits are those of the largest of all
    const Side corner_a1 = side_at(model.vertices, a1), corner_a2 = side_at(model.vertices, a2);
    const Side corner_b1 = side_at(model.vertices, b1), corner_b2 = side_at(model.vertices, b2);
    const Side far_a1 = side_at(model.vertices, other_a1), far_a2 = side_at(model.vertices, other_a2);
    const Side far_b1 = side_at(model.vertices, other_b1), far_b2 = side_at(model.vertices, other_b2);
    const Side normal_a = side_at(model.vertex_normals, a1), normal_b = side_at(model.vertex_normals, other_b1);
    auto separation_of = [&](Side normal, Side begin, Vector s, Side at, Side p, Side q) {
        const Side direction = turned_back(c, s, normal);
        return smaller(dot(direction, q), dot(direction, p)) - dot(normal, minus(begin, at));
    };
    const Vector value_a = separation_of(normal_a, corner_a1, s, x, corner_b1, corner_b2);
    const Vector value_b = separation_of(normal_b, far_b1, -s, x_back, far_a1, far_a2);
    const Vector radius_a = values_at(model.shape_radius.data, a), radius_b = values_at(model.shape_radius.data, b);
    const Vector radii = radius_a + radius_b, touching = radii - overlap;
    near = near & ~(larger(value_a, value_b) > within + radii);
    // the reference edge, of b where ``flip``, and the edge that faces it
    const auto flip = value_b > value_a + slack;
    const Vector separation = pick(flip, value_b, value_a), sine = pick(flip, -s, s);
    const Side at = choose(flip, x_back, x), p1 = choose(flip, far_b1, corner_a1), p2 = choose(flip, far_b2, corner_a2);
    Side normal = choose(flip, normal_b, normal_a);
    const Side q1 = plus(turned(c, sine, choose(flip, far_a1, corner_b1)), at);
    const Side q2 = plus(turned(c, sine, choose(flip, far_a2, corner_b2)), at);
    // both ends of that clipped to the reference edge; a degenerate clip keeps the nearer end
    Side along = minus(p2, p1);
    const Vector length = length_of(along);
    along = {along.x / length, along.y / length};
    const Vector u1 = dot(minus(q1, p1), along), u2 = dot(minus(q2, p1), along);
    const Vector w1 = smaller(larger(u1, zero), length), w2 = smaller(larger(u2, zero), length), span = u2 - u1;
    const auto upright = ~(magnitude(span) > (Real)EPSILON * length);
    Side k1 = choose(upright, q1, plus(q1, times(minus(q2, q1), (w1 - u1) / span)));
    Side k2 = choose(upright, q2, plus(q1, times(minus(q2, q1), (w2 - u1) / span)));
    Vector g1 = dot(normal, minus(k1, p1)), g2 = dot(normal, minus(k2, p1));
    const auto outside = (larger(u1, u2) < zero) | (smaller(u1, u2) > length), apart = separation > zero + slack;
    // two corners are closest
    full = full |
           (near & ((outside & (apart | (load(segments) > zero))) | (apart & (smaller(g1, g2) > separation + slack))));
    if (any(outside)) {
        k1 = choose(outside, q1, k1);
        k2 = choose(outside, q2, k2);
        g1 = pick(outside, dot(normal, minus(q1, p1)), g1);
        g2 = pick(outside, dot(normal, minus(q2, p1)), g2);
    }
    // where another axis than the normal's may part them too, it depends on their motion where they meet
    const auto facing =
        (value_a >= touching) & (value_b >= touching) & (dot(normal_a, turned(c, s, normal_b)) > (Real)PARALLEL);
    const auto beside = near & (facing | (load(bounds[2]) + moved >= touching));
    if (any(beside)) {
        const Side arm_a = turned(ca, sa, center_a), arm_b = turned(cb, sb, center_b);
        const Vector spin_a = values_at(state.angular_velocity.data, of_a);
        const Vector spin_b = values_at(state.angular_velocity.data, of_b);
        const Side turning = minus({-arm_b.y * spin_b, arm_b.x * spin_b}, {-arm_a.y * spin_a, arm_a.x * spin_a});
        const Side moving = plus(minus(side_at(state.velocity, of_b), side_at(state.velocity, of_a)), turning);
        full = full | (beside & (dot(moving, moving) * step * step > zero + slack * slack));
    }
    const Vector half = (Real)0.5 * pick(flip, radius_b - radius_a, radius_a - radius_b);
    Vector gap0 = g1 - radii;
    const Vector gap1 = g2 - radii;
    Side point0 = plus(k1, times(normal, half - (Real)0.5 * g1)),
         point1 = plus(k2, times(normal, half - (Real)0.5 * g2));
    const auto single = (w1 == w2) | upright, deeper = single & (g2 < g1);
    gap0 = pick(deeper, gap1, gap0);
    point0 = choose(deeper, point1, point0);
    const Side across = turned(c, s, normal);
    normal = choose(flip, Side{-across.x, -across.y}, normal);
    point0 = choose(flip, plus(turned(c, s, point0), x), point0);
    point1 = choose(flip, plus(turned(c, s, point1), x), point1);
    normal = turned(ca, sa, normal);
    point0 = plus(turned(ca, sa, point0), at_a);
    point1 = plus(turned(ca, sa, point1), at_a);

    const Vector along_normal = normal.x * drift.x + normal.y * drift.y;
    auto is_near = [&](Side arm_a, Side arm_b, Vector gap) {
        const Vector speed = along_normal + (cross(arm_b, normal) * B.w - cross(arm_a, normal) * A.w);
        return near & (gap <= speculative + larger(-speed * step, zero));
    };
    const Side arm_a0 = minus(point0, at_a), arm_b0 = minus(point0, at_b);
    const Side arm_a1 = minus(point1, at_a), arm_b1 = minus(point1, at_b);
    const auto first_near = is_near(arm_a0, arm_b0, gap0), second_near = ~single & is_near(arm_a1, arm_b1, gap1);
    auto bit = [&](auto mask, int value) { return pick(mask, zero + (Real)value, zero); };
    const int slot = begin / LANES * LANES;
    Real* const to = met + slot * FIELDS;
    store_points(to, normal);
    store_points(to + 2 * LANES, arm_a0);
    store_points(to + 4 * LANES, arm_b0);
    store_points(to + 6 * LANES, arm_a1);
    store_points(to + 8 * LANES, arm_b1);
    store(to + 10 * LANES, gap0);
    store(to + 11 * LANES, gap1);
    store(to + 12 * LANES, bit(first_near, 1) + bit(second_near, 2) + bit(flip, 4) + bit(deeper, 8) + bit(~single, 16));
    store(to + 13 * LANES, load(edges));
    const auto found = first_near | second_near;
    for (int l = 0; l < LANES && begin + l < lists; ++l)
        place[listed[begin + l]] = full[l] ? -1 : found[l] ? slot + l : -2;
}
place[CHUNK] = (lists + LANES - 1) / LANES * LANES;
return first + count;
#endif
