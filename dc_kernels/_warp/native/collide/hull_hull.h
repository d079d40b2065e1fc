// Manifold of two hulls in the frame of ``a``, to which ``frame`` takes that of ``b``; normal from a to b.
// Macros: EPSILON, PARALLEL (hull.h, too). Parameters: a, b, frame, reach, slack, overlap, vertices, normals. Returns
// count + 4 corner + 8 beside, features 0 and 1, gaps 0 and 1, normal, points 0 and 1 (see Manifold).
struct Met {
    int count, feature0, feature1;
    bool corner;
    REAL gap0, gap1;
    Point normal, point0, point1;
};
auto larger_of = [](REAL p, REAL q) { return p > q ? p : q; };
auto smaller_of = [](REAL p, REAL q) { return p < q ? p : q; };
auto size_of = [](REAL p) { return wp::abs(p); };
auto length_of = [&](Point p) { return wp::sqrt(dot(p, p)); };
const Pose there = {frame.c, frame.s, {frame.x[0], frame.x[1]}};
const Point x = turned_back(there, there.at);
const Pose back = {there.c, -there.s, {-x.x, -x.y}};
Point copy[4][LANES];
const Core core_a = {points_of(vertices, a.first, a.count, copy[0]), points_of(normals, a.first, a.count, copy[1]),
                     a.count, a.radius};
const Core core_b = {points_of(vertices, b.first, b.count, copy[2]), points_of(normals, b.first, b.count, copy[3]),
                     b.count, b.radius};
const REAL radii = a.radius + b.radius, touching = radii - overlap;

// The incident edge clipped to a reference edge, of b if ``flip``, or the closest corners; where the edge is ``forced``
// on a segment of a chain, nothing beyond it. All in the frame of the reference hull.
auto clip = [&](int edge, bool flip, bool forced, REAL separation, REAL slack) {
    const Core &one = flip ? core_b : core_a, &two = flip ? core_a : core_b;
    const Pose& pose = flip ? back : there;
    auto feature_of = [&](int of_one, int of_two) { return flip ? (of_two << 8) | of_one : (of_one << 8) | of_two; };
    const int r1 = edge, r2 = edge + 1 == one.count ? 0 : edge + 1;
    const Point p1 = one.corners[r1], p2 = one.corners[r2];
    Met m = {};
    m.normal = one.normals[edge];
    // the incident edge looks most against the normal
    const int i1 = edge_along(two, times(turned_back(pose, m.normal), -1)), i2 = i1 + 1 == two.count ? 0 : i1 + 1;
    const Point q1 = placed(pose, two.corners[i1]);
    const Point q2 = placed(pose, two.corners[i2]);
    Point along = minus(p2, p1);
    const REAL length = length_of(along);
    along = {along.x / length, along.y / length};
    const REAL u1 = dot(minus(q1, p1), along), u2 = dot(minus(q2, p1), along);
    // clip both ends of the incident edge to the reference edge; a degenerate clip keeps the nearer end
    const REAL w1 = smaller_of(larger_of(u1, 0), length), w2 = smaller_of(larger_of(u2, 0), length);
    const REAL span = u2 - u1;
    const bool upright = !(size_of(span) > (REAL)EPSILON * length);
    Point k1 = q1, k2 = q2;
    if (!upright) {
        k1 = plus(q1, times(minus(q2, q1), (w1 - u1) / span));
        k2 = plus(q1, times(minus(q2, q1), (w2 - u1) / span));
    }
    REAL g1 = dot(m.normal, minus(k1, p1)), g2 = dot(m.normal, minus(k2, p1));
    const bool outside = larger_of(u1, u2) < 0 || smaller_of(u1, u2) > length;
    if (forced && outside) return m;  // what lies past the end of a chain's segment is its neighbour's
    if ((outside && (separation > slack || (one.count == 2 && two.count == 2))) ||
        (separation > slack && smaller_of(g1, g2) > separation + slack)) {
        // cores apart, and the nearest point of the incident hull does not face the edge: two corners are closest
        REAL nearest = (REAL)1e30;
        int of_one = 0, of_two = 0;
        Point apart = pose.at;
        for (int j = 0; j < two.count; ++j) {
            const Point q = placed(pose, two.corners[j]);
            for (int i = 0; i < one.count; ++i) {
                const Point between = minus(q, one.corners[i]);
                const REAL squared = dot(between, between);
                if (squared < nearest) {
                    nearest = squared;
                    of_one = i;
                    of_two = j;
                    apart = between;
                }
            }
        }
        const REAL distance = wp::sqrt(nearest);
        m.count = 1;
        m.corner = true;
        m.normal = {apart.x / distance, apart.y / distance};
        m.gap0 = distance - radii;
        m.point0 = plus(one.corners[of_one], times(m.normal, one.radius + (REAL)0.5 * m.gap0));
        m.feature0 = feature_of(of_one, of_two);
        return m;
    }
    if (outside) {
        // deep overlap past the edge's end: the support vertex itself, not a point of its edge's extension
        k1 = q1;
        k2 = q2;
        g1 = dot(m.normal, minus(q1, p1));
        g2 = dot(m.normal, minus(q2, p1));
    }
    const REAL half = (REAL)0.5 * (one.radius - two.radius);
    // the incident edge runs against the reference edge: its first end meets the reference's second
    m.gap0 = g1 - radii;
    m.point0 = plus(k1, times(m.normal, half - (REAL)0.5 * g1));
    m.feature0 = feature_of(r2, i1);
    m.gap1 = g2 - radii;
    m.point1 = plus(k2, times(m.normal, half - (REAL)0.5 * g2));
    m.feature1 = feature_of(r1, i2);
    m.count = 2;
    if (w1 == w2 || upright) {
        // one point only: the deeper end
        m.count = 1;
        if (g2 < g1) {
            m.gap0 = m.gap1;
            m.point0 = m.point1;
            m.feature0 = m.feature1;
        }
    }
    return m;
};

// Whether a chain's inner corner would catch what slides over it: the normal has to lie between those of the two
// segments that meet there. Then the segment's ``face`` is to be the reference.
auto catches = [&](Point normal, int nearest, int& face) {
    const Point v1 = core_a.corners[0], v2 = core_a.corners[1], run = minus(v2, v1);
    auto cross = [](Point p, Point q) { return p.x * q.y - p.y * q.x; };
    face = dot(core_a.normals[0], normal) < 0;
    const REAL side = face ? -1 : 1;
    const Point own = core_a.normals[face];
    if (size_of(cross(own, normal)) <= (REAL)1e-3) return false;
    const bool at_start = dot(normal, run) < 0;
    const Point neighbour = at_start ? minus(v1, core_a.corners[2]) : minus(core_a.corners[3], v2);
    if (neighbour.x == 0 && neighbour.y == 0) return false;
    const REAL turn = (at_start ? cross(neighbour, run) : cross(run, neighbour)) * side;
    const Point theirs = times(Point{neighbour.y, -neighbour.x}, side);
    if (size_of(turn) <= (REAL)1e-3 * length_of(neighbour) * length_of(run)) {
        face = nearest;  // segments of a flat chain have to agree on a side: that with less of the hull beyond it
        return true;
    }
    // between: no farther from this segment's normal than the neighbour's is
    return turn <= 0 || dot(normal, own) * length_of(theirs) < dot(theirs, own);
};

// not in each place that calls it: the narrowphase would take an eighth longer to compile, and no less to run
auto whole = [&]() __attribute__((noinline)) {
    wp::vec_t<11, REAL> result;
    const auto [of_a, of_b] = separations(core_a, core_b, there, back, touching);
    if (larger_of(of_a.value, of_b.value) > reach + radii) return result;
    bool beside = of_a.enough > 1 || of_b.enough > 1;
    if (of_a.value >= touching && of_b.value >= touching) {
        const Point facing = turned(there, core_b.normals[of_b.edge]);
        beside = beside || dot(core_a.normals[of_a.edge], facing) > (REAL)PARALLEL;
    }
    // prefer a's edge, so that round-off does not switch between the two
    bool flip = of_b.value > of_a.value + slack;
    Met m = clip(flip ? of_b.edge : of_a.edge, flip, false, flip ? of_b.value : of_a.value, slack);
    if (flip) {
        m.normal = turned(there, m.normal);
        m.normal = {-m.normal.x, -m.normal.y};
        m.point0 = placed(there, m.point0);
        m.point1 = placed(there, m.point1);
    }
    if (a.segment) {
        int face = 0;
        if (catches(m.normal, of_a.edge, face)) m = clip(face, false, true, 0, (REAL)1e30);
    }
    result[0] = (REAL)(m.count + 4 * m.corner + 8 * (beside || m.corner));
    result[1] = (REAL)m.feature0;
    result[2] = (REAL)m.feature1;
    result[3] = m.gap0;
    result[4] = m.gap1;
    result[5] = m.normal.x;
    result[6] = m.normal.y;
    result[7] = m.point0.x;
    result[8] = m.point0.y;
    result[9] = m.point1.x;
    result[10] = m.point1.y;
    return result;
};
return whole();
