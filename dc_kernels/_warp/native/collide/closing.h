// When the motion closes the last of the axes that part two hulls, of those that it closes within ``horizon``, or 0: an
// edge in each of LANES lanes, as in hull.h. ``frame`` takes b to the frame of a, in which b moves by ``velocity``; an
// overlap up to ``overlap`` counts as open. Parameters: a, b, frame, velocity, overlap, horizon, vertices, normals.
// Stands behind prelude.h and collide/hull.h.
const Pose there = {frame.c, frame.s, {frame.x[0], frame.x[1]}};
const Point way = {velocity[0], velocity[1]};
const REAL radii = a.radius + b.radius;
#if defined(__CUDA_ARCH__)
auto point_at = [](const auto& points, int i) { return Point{wp::index(points, i)[0], wp::index(points, i)[1]}; };
REAL time = 0;
auto close = [&](REAL gap, REAL speed) {
    if (!(gap >= -overlap && speed < 0 && gap + overlap <= -speed * horizon)) return;
    const REAL when = (gap + overlap) / -speed;
    time = when > time ? when : time;
};
for (int i = a.first; i < a.first + a.count; ++i) {
    const Point normal = point_at(normals, i), corner = point_at(vertices, i);
    REAL gap = (REAL)1e30;
    for (int j = b.first; j < b.first + b.count; ++j) {
        const REAL distance = dot(normal, minus(placed(there, point_at(vertices, j)), corner));
        gap = distance < gap ? distance : gap;
    }
    close(gap - radii, dot(normal, way));
}
for (int j = b.first; j < b.first + b.count; ++j) {
    const Point normal = turned(there, point_at(normals, j)), corner = placed(there, point_at(vertices, j));
    REAL gap = (REAL)1e30;
    for (int i = a.first; i < a.first + a.count; ++i) {
        const REAL distance = dot(normal, minus(point_at(vertices, i), corner));
        gap = distance < gap ? distance : gap;
    }
    close(gap - radii, -dot(normal, way));
}
return time;
#else
Point copy[4][LANES];
const Core core_a = {points_of(vertices, a.first, a.count, copy[0]), points_of(normals, a.first, a.count, copy[1]),
                     a.count, a.radius};
const Core core_b = {points_of(vertices, b.first, b.count, copy[2]), points_of(normals, b.first, b.count, copy[3]),
                     b.count, b.radius};
const Vector lane = {0, 1, 2, 3, 4, 5, 6, 7};
auto times_of = [&](int count, Vector gap, Vector speed) {
    gap = gap - radii;
    const auto closes = (lane < (Real)count) & (gap >= -overlap) & (speed < zero) & (gap + overlap <= -speed * horizon);
    return closes ? (gap + overlap) / -speed : zero;
};
auto nearest_of = [&](const Points& normal, const Points& corner, const Core& other, auto place) {
    Vector gap = (Real)1e30;
    for (int k = 0; k < other.count; ++k) {
        const Point q = place(other.corners[k]);
        gap = smaller(normal.x * (q.x - corner.x) + normal.y * (q.y - corner.y), gap);
    }
    return gap;
};
const Points normal_a = load_points(core_a.normals), corner_a = load_points(core_a.corners);
const Vector gap_a = nearest_of(normal_a, corner_a, core_b, [&](Point p) { return placed(there, p); });
const Vector of_a = times_of(a.count, gap_a, normal_a.x* way.x + normal_a.y * way.y);
auto turn = [&](const Points& p) { return Points{there.c * p.x - there.s * p.y, there.s * p.x + there.c * p.y}; };
const Points normal_b = turn(load_points(core_b.normals));
Points corner_b = turn(load_points(core_b.corners));
corner_b = {corner_b.x + there.at.x, corner_b.y + there.at.y};
const Vector gap_b = nearest_of(normal_b, corner_b, core_a, [](Point p) { return p; });
return largest(larger(of_a, times_of(b.count, gap_b, -(normal_b.x* way.x + normal_b.y * way.y))));
#endif
