// Keeps which edges and corners of two hulls the full test goes by, and how far they may move against each other until
// it may go by others (collide/recycle.py derives the bound). Parameters: w, pair, a, b, frame, sizes (bounds
// on the distance of their corners from their bodies' centres), moves (way and spin of the step, at most), vertices,
// normals, pairs. Macros: ROUNDING. Stands behind prelude.h and collide/hull.h.
#if !defined(__CUDA_ARCH__)
const REAL size_a = sizes[0], size_b = sizes[1], way = moves[0], spin = moves[1];
const int start = pairs.start.data[w], room = pairs.start.data[w + 1] - start;
const int place = 2 * start + pairs.kept_side.data[w] * room + pairs.temp_b.data[pair] - start;
auto& bound = pairs.kept_bound.data[place];
bound[1] = -1;
const Pose there = {frame.c, frame.s, {frame.x[0], frame.x[1]}};
const Point x = turned_back(there, there.at);
const Pose back = {there.c, -there.s, {-x.x, -x.y}};
auto size_of = [](REAL p) { return wp::abs(p); };
const REAL away = size_of(there.at.x) + size_of(there.at.y);
const REAL reach_a = size_a + away, arm = reach_a > size_b ? reach_a : size_b, most = arm * spin + way;
if (!(most < (REAL)0.1 * arm)) return;  // what moves like this would have to be looked at again in the next steps
Point copy[4][LANES];
const Core core_a = {points_of(vertices, a.first, a.count, copy[0]), points_of(normals, a.first, a.count, copy[1]),
                     a.count, a.radius};
const Core core_b = {points_of(vertices, b.first, b.count, copy[2]), points_of(normals, b.first, b.count, copy[3]),
                     b.count, b.radius};
const Vector lane = {0, 1, 2, 3, 4, 5, 6, 7}, far_off = (Real)1e30;
auto least_of = [&](Vector v) {
    Vector other = __builtin_shufflevector(v, v, 4, 5, 6, 7, 0, 1, 2, 3);
    v = smaller(v, other);
    other = __builtin_shufflevector(v, v, 2, 3, 0, 1, 6, 7, 4, 5);
    v = smaller(v, other);
    other = __builtin_shufflevector(v, v, 1, 0, 3, 2, 5, 4, 7, 6);
    v = smaller(v, other);
    return v[0];
};
struct Side {
    int edge, incident;  // the edge farthest from the other hull, and the edge of that which faces it
    REAL value, second;  // its separation, and that of the next best edge
    REAL margin, turn;   // distance, and cosine, by which edges and corners come before others
};
auto side_of = [&](const Core& one, const Core& two, const Pose& pose) {
    const Points normal = load_points(one.normals), corner = load_points(one.corners);
    const Vector dx = pose.c * normal.x + pose.s * normal.y, dy = pose.c * normal.y - pose.s * normal.x;
    Vector low = far_off;
    for (int j = 0; j < two.count; ++j) {
        const Vector distance = dx * two.corners[j].x + dy * two.corners[j].y;
        low = smaller(distance, low);
    }
    const Vector own = normal.x * (corner.x - pose.at.x) + normal.y * (corner.y - pose.at.y);
    Vector value = low - own;
    value = lane < (Real)one.count ? value : -far_off;
    Side side;
    const Best best = best_lane(value, one.count, 0);
    side.edge = best.edge;
    side.value = best.value;
    side.second = -least_of(lane == (Real)side.edge ? far_off : -value);
    side.margin = side.value - side.second;
    // what of the other hull is nearest along this edge's normal, and the edge that faces it
    const Point direction = turned_back(pose, one.normals[side.edge]);
    const Points facing = load_points(two.normals), at = load_points(two.corners);
    const Vector along = (-direction.x) * facing.x + (-direction.y) * facing.y;
    const Best most = best_lane(along, two.count, 0);
    side.incident = most.edge;
    const auto other = (lane < (Real)two.count) & (lane != (Real)most.edge);
    side.turn = most.value + least_of(other ? -along : far_off);
    const int next = most.edge + 1 == two.count ? 0 : most.edge + 1;
    const Vector distance = direction.x * at.x + direction.y * at.y;
    const REAL p = distance[most.edge], q = distance[next], support = p < q ? p : q;
    const REAL rest = least_of((other & (lane != (Real)next)) ? distance : far_off);
    side.margin = rest - support < side.margin ? rest - support : side.margin;
    return side;
};
const Side of_a = side_of(core_a, core_b, there), of_b = side_of(core_b, core_a, back);
const REAL rounding = (REAL)ROUNDING * (size_a + size_b + away);
const REAL margin = (REAL)0.5 * (of_a.margin < of_b.margin ? of_a.margin : of_b.margin) - rounding;
const REAL turn = (REAL)0.5 * (of_a.turn < of_b.turn ? of_a.turn : of_b.turn) - (REAL)ROUNDING;
if (!(margin > most && turn > 0)) return;
const REAL steep = margin / turn;
auto next_of = [](const Core& core, int edge) { return edge + 1 == core.count ? 0 : edge + 1; };
const int edges[] = {of_a.edge, next_of(core_a, of_a.edge), of_a.incident, next_of(core_b, of_a.incident),
                     of_b.edge, next_of(core_b, of_b.edge), of_b.incident, next_of(core_a, of_b.incident)};
int packed = a.count == 2 && b.count == 2 ? 1 << 24 : 0;
for (int i = 0; i < 8; ++i) packed |= edges[i] << 3 * i;
pairs.kept_edges.data[place] = packed;
auto& pose = pairs.kept_frame.data[place];
pose[0] = there.c;
pose[1] = there.s;
pose[2] = there.at.x;
pose[3] = there.at.y;
bound[0] = steep > arm ? steep : arm;
bound[1] = margin;
bound[2] = (of_a.second > of_b.second ? of_a.second : of_b.second) + rounding;
#endif
