// Whether a shape has another number of vertices than its type takes, another centre, extent or radius than its
// vertices, normals that are not those of its edges, or corners that are not those of a polygon. Macros: REAL, DISC,
// SEGMENT, MAX_VERTICES, SEGMENT_VERTICES, ROUNDING (of a coordinate), NEAR, FLAT (area over squared size).
#if !defined(__CUDA_ARCH__)
typedef double Four __attribute__((ext_vector_type(4)));  // of four shapes, a lane each
typedef REAL Reals __attribute__((ext_vector_type(4)));
const Four none = 0.0;
auto larger = [](const Four& a, const Four& b) { return __builtin_elementwise_max(a, b); };
auto smaller = [](const Four& a, const Four& b) { return __builtin_elementwise_min(a, b); };
auto size_of = [](const Four& a) { return __builtin_elementwise_abs(a); };
// Looks at four shapes one after the other, or four times at one, whose edges begin at so many corners of those given.
auto misfit = [&](const int first, const int stride, const int corners,
                  const int given) __attribute__((always_inline)) {
    auto lanes = [](const REAL a, const REAL b, const REAL c, const REAL d)
                     __attribute__((always_inline)) { return __builtin_convertvector((Reals){a, b, c, d}, Four); };
    const int one = first, two = first + stride, three = first + 2 * stride, four = first + 3 * stride;
    auto each = [&](auto of) __attribute__((always_inline)) { return lanes(of(one), of(two), of(three), of(four)); };
    const int *start = vertex_start.data, at = start[one], to = start[two], then = start[three], last = start[four];
    auto corner = [&](const REAL* of, const int k) __attribute__((always_inline)) {
        return lanes(of[2 * at + k], of[2 * to + k], of[2 * then + k], of[2 * last + k]);
    };
    const REAL *vertex = (const REAL*)vertices.data, *normal = (const REAL*)vertex_normals.data;
    const Four radius = each([&](const int s) { return shape_radius.data[s]; });
    const Four center_x = each([&](const int s) { return shape_center.data[s][0]; });
    const Four center_y = each([&](const int s) { return shape_center.data[s][1]; });
    Four x[MAX_VERTICES + 1], y[MAX_VERTICES + 1], dx[MAX_VERTICES + 1], dy[MAX_VERTICES + 1];
    x[0] = corner(vertex, 0);
    y[0] = corner(vertex, 1);
    Four left = x[0], right = x[0], bottom = y[0], top = y[0], reach = none;  // squared
    for (int k = 0; k < corners; ++k) {
        x[k] = corner(vertex, 2 * k);
        y[k] = corner(vertex, 2 * k + 1);
        left = smaller(x[k], left);
        right = larger(x[k], right);
        bottom = smaller(y[k], bottom);
        top = larger(y[k], top);
        const Four off_x = x[k] - center_x, off_y = y[k] - center_y;
        reach = larger(off_x * off_x + off_y * off_y, reach);
    }
    x[corners] = x[0];
    y[corners] = y[0];
    const Four size = larger(larger(-left, right), larger(-bottom, top));
    const Four slack = ROUNDING * (size + larger(size_of(center_x), size_of(center_y)));
    auto right_so = (center_x >= left - slack) & (center_x <= right + slack);
    right_so &= (center_y >= bottom - slack) & (center_y <= top + slack);
    const Four arm = each([&](const int s) { return shape_extent.data[s]; }) - radius;
    const Four more = arm + slack + NEAR / 2 * arm, less = larger(arm - slack - NEAR / 2 * arm, none);
    Four lost = size - size;  // NaN where a vertex, or a neighbour in a chain, is not finite
    for (int k = 2 * corners; k < 2 * given; ++k) lost += none * corner(vertex, k) + none * corner(normal, k);
    right_so &= (lost == none) & (arm >= none) & (reach >= less * less) & (reach <= more * more);

    // an edge's length is taken along its normal, turned: neither roots nor quotients, and what bends by less than the
    // rounding, though right, is left to the closer look
    const Four blur = ROUNDING / 2 * size;
    for (int k = 0; k < corners && corners > 1; ++k) {
        dx[k] = x[k + 1] - x[k];
        dy[k] = y[k + 1] - y[k];
        const Four nx = corner(normal, 2 * k), ny = corner(normal, 2 * k + 1);
        const Four along = nx * dy[k] - ny * dx[k], one = nx * nx + ny * ny;
        right_so &= (size_of(nx * dx[k] + ny * dy[k]) <= blur + NEAR / 2 * along) & (along > none);
        right_so &= size_of(one - 1.0) <= none + NEAR;
    }
    if (corners > 2) {
        dx[corners] = dx[0];
        dy[corners] = dy[0];
        Four area = none;
        auto rises = right_so & 0;  // less one for an edge that turns upwards: of one, where vertices go around once
        for (int k = 0; k < corners; ++k) {
            right_so &= dx[k] * dy[k + 1] - dy[k] * dx[k + 1] > none;
            rises += (dy[k] <= none) & (dy[k + 1] > none);
            area += (x[k] - x[0]) * dy[k] - (y[k] - y[0]) * dx[k];
        }
        const Four width = right - left, height = top - bottom;
        right_so &= (rises == -1) & (area > 2 * FLAT * (width * width + height * height));
    }
    return !(right_so[0] & right_so[1] & right_so[2] & right_so[3]);
};
const int n = shape_type.shape[0];
for (int s = 0; s < n; ++s) {
    const int kind = shape_type.data[s], start = vertex_start.data[s];
    const int given = vertex_start.data[s + 1] - start;
    const REAL radius = shape_radius.data[s], center_x = shape_center.data[s][0], center_y = shape_center.data[s][1];
    const REAL* vertex = (const REAL*)(vertices.data + start);
    if (kind == DISC) {
        if (given != 1 || !(radius > 0)) return 1;
        const REAL* normal = (const REAL*)(vertex_normals.data + start);
        if (!(0 * normal[0] + 0 * normal[1] == 0)) return 1;
        if (shape_extent.data[s] == radius && vertex[0] == center_x && vertex[1] == center_y) continue;
    } else if (kind == SEGMENT) {
        if (given != SEGMENT_VERTICES) return 1;
    } else if (given < 2 || given > MAX_VERTICES || (given == 2 && !(radius > 0))) {
        return 1;
    }
    // boxes with radii and the like come in rows
    int alike = kind != DISC && given > 2 && s + 3 < n;
    for (int k = 1; k < 4 && alike; ++k)
        alike = shape_type.data[s + k] == kind && vertex_start.data[s + k + 1] - vertex_start.data[s + k] == given;
    const int corners = kind == SEGMENT ? 2 : given;
    if (corners == 4 && alike ? misfit(s, 1, 4, 4) : misfit(s, alike, corners, given)) return 1;
    if (alike) s += 3;
}
return 0;
#else
return 1;
#endif
