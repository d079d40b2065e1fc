// Whether a shape has another number of vertices than its type takes, another centre, extent or radius than its
// vertices, normals that are not those of its edges, or corners that are not those of a polygon. Macros: REAL, DISC,
// SEGMENT, MAX_VERTICES, SEGMENT_VERTICES, ROUNDING (of a coordinate), NEAR, FLAT (area over squared size).
#if !defined(__CUDA_ARCH__)
auto larger = [](double a, double b) { return a > b ? a : b; };
auto smaller = [](double a, double b) { return a < b ? a : b; };
auto size_of = [](double a) { return __builtin_fabs(a); };
// inlined, so that the loops over a box's corners are unrolled
auto misfits = [&](const int s, const int corners) __attribute__((always_inline)) {
    const int start = vertex_start.data[s];
    const REAL radius = shape_radius.data[s], center_x = shape_center.data[s][0], center_y = shape_center.data[s][1];
    const REAL* vertex = (const REAL*)(vertices.data + start);
    double x[MAX_VERTICES + 1], y[MAX_VERTICES + 1], dx[MAX_VERTICES + 1], dy[MAX_VERTICES + 1];
    double left = vertex[0], right = left, bottom = vertex[1], top = bottom, reach = 0;  // squared
    for (int k = 0; k < corners; ++k) {
        x[k] = vertex[2 * k];
        y[k] = vertex[2 * k + 1];
        left = smaller(x[k], left);
        right = larger(x[k], right);
        bottom = smaller(y[k], bottom);
        top = larger(y[k], top);
        const double off_x = x[k] - center_x, off_y = y[k] - center_y;
        reach = larger(off_x * off_x + off_y * off_y, reach);
    }
    x[corners] = x[0];
    y[corners] = y[0];
    const double size = larger(larger(-left, right), larger(-bottom, top));
    const double slack = ROUNDING * (size + larger(size_of(center_x), size_of(center_y)));
    if (!(center_x >= left - slack && center_x <= right + slack)) return 1;
    if (!(center_y >= bottom - slack && center_y <= top + slack)) return 1;
    const double arm = (double)shape_extent.data[s] - radius, more = arm + slack + NEAR / 2 * arm;
    const double less = larger(arm - slack - NEAR / 2 * arm, 0);
    if (!(arm >= 0 && reach >= less * less && reach <= more * more)) return 1;
    if (corners == 1) return 0;

    // an edge's length is taken along its normal, turned: neither roots nor quotients, and what bends by less than the
    // rounding, though right, is left to the closer look
    const REAL* normal = (const REAL*)(vertex_normals.data + start);
    const double blur = ROUNDING / 2 * size;
    int wrong = 0;
    for (int k = 0; k < corners; ++k) {
        dx[k] = x[k + 1] - x[k];
        dy[k] = y[k + 1] - y[k];
        const double nx = normal[2 * k], ny = normal[2 * k + 1], one = nx * nx + ny * ny;
        const double along = nx * dy[k] - ny * dx[k];
        wrong |= (int)!(size_of(nx * dx[k] + ny * dy[k]) <= blur + NEAR / 2 * along) | (int)!(along > 0);
        wrong |= (int)!(size_of(one - 1) <= NEAR);
    }
    if (wrong) return 1;
    if (corners == 2) return 0;
    dx[corners] = dx[0];
    dy[corners] = dy[0];
    double area = 0;
    int rises = 0;  // edges that turn upwards: one of them, where vertices go around once
    for (int k = 0; k < corners; ++k) {
        wrong |= (int)!(dx[k] * dy[k + 1] - dy[k] * dx[k + 1] > 0);
        rises += (int)(dy[k] <= 0) & (int)(dy[k + 1] > 0);
        area += (x[k] - x[0]) * dy[k] - (y[k] - y[0]) * dx[k];
    }
    const double width = right - left, height = top - bottom;
    return (int)(wrong || rises != 1 || !(area > 2 * FLAT * (width * width + height * height)));
};
const int n = shape_type.shape[0];
for (int s = 0; s < n; ++s) {
    const int kind = shape_type.data[s], start = vertex_start.data[s];
    const int given = vertex_start.data[s + 1] - start;
    const REAL radius = shape_radius.data[s], center_x = shape_center.data[s][0], center_y = shape_center.data[s][1];
    const REAL* vertex = (const REAL*)(vertices.data + start);
    if (kind == DISC) {
        if (given != 1 || !(radius > 0)) return 1;
        if (shape_extent.data[s] == radius && vertex[0] == center_x && vertex[1] == center_y) continue;
    } else if (kind == SEGMENT) {
        if (given != SEGMENT_VERTICES) return 1;
    } else if (given < 2 || given > MAX_VERTICES || (given == 2 && !(radius > 0))) {
        return 1;
    }
    if (kind != SEGMENT && given == 4 ? misfits(s, 4) : misfits(s, kind == SEGMENT ? 2 : given)) return 1;
}
return 0;
#else
return 1;
#endif
