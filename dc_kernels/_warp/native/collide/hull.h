// Hulls after the prelude: separations of their edges and the edge that looks most along a direction, an edge in each
// of LANES lanes; loops take the place of lanes on a GPU. Types: Point, Pose, Core, Best.
struct Point {
    REAL x, y;
};
// Takes points of one frame to another: rotation by (cosine, sine), then translation.
struct Pose {
    REAL c, s;
    Point at;
};
// The first edge with the largest value, and how many have at least ``enough``.
struct Best {
    REAL value;
    int edge, enough;
};
auto dot = [](Point p, Point q) { return p.x * q.x + p.y * q.y; };
auto plus = [](Point p, Point q) { return Point{p.x + q.x, p.y + q.y}; };
auto minus = [](Point p, Point q) { return Point{p.x - q.x, p.y - q.y}; };
auto times = [](Point p, REAL factor) { return Point{p.x * factor, p.y * factor}; };
auto turned = [](const Pose& pose, Point p) { return Point{pose.c * p.x - pose.s * p.y, pose.s * p.x + pose.c * p.y}; };
auto turned_back = [](const Pose& pose, Point p) {
    return Point{pose.c * p.x + pose.s * p.y, pose.c * p.y - pose.s * p.x};
};
auto placed = [&](const Pose& pose, Point p) { return plus(turned(pose, p), pose.at); };
// The points of a hull where they lie, if LANES of them follow each other there, else a copy.
auto points_of = [](const auto& points, int first, int count, Point* copy) {
    if (points.strides[0] == sizeof(Point) && first + LANES <= points.shape[0])
        return (const Point*)points.data + first;
    for (int i = 0; i < LANES; ++i) {
        copy[i] = {0, 0};
        if (i < count) copy[i] = {wp::index(points, first + i)[0], wp::index(points, first + i)[1]};
    }
    return (const Point*)copy;
};
struct Core {
    const Point *corners, *normals;
    int count;
    REAL radius;
};
#if !defined(__CUDA_ARCH__)
typedef bool Booleans __attribute__((ext_vector_type(LANES)));
struct Points {
    Vector x, y;
};
auto load_points = [&](const Point* points) {
    const Vector low = load((const Real*)points), high = load((const Real*)points + LANES);
    return Points{__builtin_shufflevector(low, high, 0, 2, 4, 6, 8, 10, 12, 14),
                  __builtin_shufflevector(low, high, 1, 3, 5, 7, 9, 11, 13, 15)};
};
auto bits_of = [](auto lanes) {
    return (unsigned)__builtin_bit_cast(unsigned char, __builtin_convertvector(lanes, Booleans));
};
auto best_lane = [&](Vector value, int count, REAL enough) {
    const Vector lane = {0, 1, 2, 3, 4, 5, 6, 7};
    value = lane < (Real)count ? value : (Vector)(Real)-1e30;
    Vector other = __builtin_shufflevector(value, value, 4, 5, 6, 7, 0, 1, 2, 3);
    Vector most = value < other ? other : value;
    other = __builtin_shufflevector(most, most, 2, 3, 0, 1, 6, 7, 4, 5);
    most = most < other ? other : most;
    other = __builtin_shufflevector(most, most, 1, 0, 3, 2, 5, 4, 7, 6);
    most = most < other ? other : most;
    const unsigned equal = bits_of(value == most);
    return Best{most[0], equal ? __builtin_ctz(equal) : 0, __builtin_popcount(bits_of(value >= enough))};
};
#endif
// Over the edges of hull one the smallest distance of hull two's corners; ``pose`` takes those to the frame of one.
auto separation = [&](const Core& one, const Core& two, const Pose& pose, REAL enough) {
#if defined(__CUDA_ARCH__)
    Best best = {(REAL)-1e30, 0, 0};
    for (int i = 0; i < one.count; ++i) {
        const Point normal = one.normals[i], direction = turned_back(pose, normal);
        REAL low = (REAL)1e30;
        for (int j = 0; j < two.count; ++j) {
            const REAL distance = dot(direction, two.corners[j]);
            if (distance < low) low = distance;
        }
        low = low - dot(normal, minus(one.corners[i], pose.at));
        if (low >= enough) ++best.enough;
        if (low > best.value) {
            best.value = low;
            best.edge = i;
        }
    }
    return best;
#else
    const Points normal = load_points(one.normals);
    const Points corner = load_points(one.corners);
    const Vector x = pose.c * normal.x + pose.s * normal.y, y = pose.c * normal.y - pose.s * normal.x;
    Vector low = (Real)1e30;
    for (int j = 0; j < two.count; ++j) {
        const Point point = two.corners[j];
        const Vector distance = x * point.x + y * point.y;
        low = smaller(distance, low);
    }
    const Vector own = normal.x * (corner.x - pose.at.x) + normal.y * (corner.y - pose.at.y);
    return best_lane(low - own, one.count, enough);
#endif
};
// The edge of a hull whose normal looks most along a direction.
auto edge_along = [&](const Core& hull, Point direction) {
#if defined(__CUDA_ARCH__)
    REAL most = (REAL)-1e30;
    int edge = 0;
    for (int i = 0; i < hull.count; ++i) {
        const REAL along = dot(direction, hull.normals[i]);
        if (along > most) {
            most = along;
            edge = i;
        }
    }
    return edge;
#else
    const Points normal = load_points(hull.normals);
    return best_lane(direction.x * normal.x + direction.y * normal.y, hull.count, (Real)0).edge;
#endif
};
// Both separations of two hulls of four corners at once: four lanes for the edges of each.
struct Bests {
    Best of_one, of_two;
};
#if !defined(__CUDA_ARCH__)
auto quad_separations = [&](const Core& one, const Core& two, const Pose& there, const Pose& back, REAL enough) {
    const Vector ones = load((const Real*)one.corners), twos = load((const Real*)two.corners);
    const Vector to_one = load((const Real*)one.normals), to_two = load((const Real*)two.normals);
    auto halves = [&](REAL p, REAL q) { return Vector{p, p, p, p, q, q, q, q}; };
#define EACH(p, q, k) __builtin_shufflevector(p, q, k, k + 2, k + 4, k + 6, k + 8, k + 10, k + 12, k + 14)
#define BOTH(p, q, k) __builtin_shufflevector(p, q, k, k, k, k, k + 8, k + 8, k + 8, k + 8)
    const Vector nx = EACH(to_one, to_two, 0), ny = EACH(to_one, to_two, 1);
    const Vector s = halves(there.s, back.s), x = there.c * nx + s * ny, y = there.c * ny - s * nx;
    auto along = [&](Vector px, Vector py) { return x * px + y * py; };
    Vector low = along(BOTH(twos, ones, 0), BOTH(twos, ones, 1));
    auto lower = [&](Vector distance) { low = smaller(distance, low); };
    lower(along(BOTH(twos, ones, 2), BOTH(twos, ones, 3)));
    lower(along(BOTH(twos, ones, 4), BOTH(twos, ones, 5)));
    lower(along(BOTH(twos, ones, 6), BOTH(twos, ones, 7)));
    const Vector atx = halves(there.at.x, back.at.x), aty = halves(there.at.y, back.at.y);
    low = low - (nx * (EACH(ones, twos, 0) - atx) + ny * (EACH(ones, twos, 1) - aty));
#undef EACH
#undef BOTH
    Vector other = __builtin_shufflevector(low, low, 2, 3, 0, 1, 6, 7, 4, 5);
    Vector most = low < other ? other : low;
    other = __builtin_shufflevector(most, most, 1, 0, 3, 2, 5, 4, 7, 6);
    most = most < other ? other : most;
    const unsigned equal = bits_of(low == most), open = bits_of(low >= enough);
    auto first = [&](unsigned bits) { return bits ? __builtin_ctz(bits) : 0; };
    return Bests{{most[0], first(equal & 15), __builtin_popcount(open & 15)},
                 {most[4], first(equal >> 4), __builtin_popcount(open >> 4)}};
};
#endif
auto separations = [&](const Core& one, const Core& two, const Pose& there, const Pose& back, REAL enough) {
#if !defined(__CUDA_ARCH__)
    if (one.count == 4 && two.count == 4) return quad_separations(one, two, there, back, enough);
#endif
    return Bests{separation(one, two, there, enough), separation(two, one, back, enough)};
};
