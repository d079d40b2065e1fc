// Whether a shape has another number of vertices than its type takes, another centre, extent or radius than its
// vertices, normals that are not those of its edges, or corners that are not those of a polygon. Macros: REAL, DISC,
// SEGMENT, MAX_VERTICES, SEGMENT_VERTICES, ROUNDING (of a coordinate), NEAR, FLAT (area over squared size).
#if !defined(__CUDA_ARCH__)
auto larger = [](double a, double b) { return a > b ? a : b; };
auto smaller = [](double a, double b) { return a < b ? a : b; };
auto size_of = [](double a) { return __builtin_fabs(a); };
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
    const int corners = kind == SEGMENT ? 2 : given;
    double x[MAX_VERTICES + 1], y[MAX_VERTICES + 1], ux[MAX_VERTICES + 1], uy[MAX_VERTICES + 1], blur[MAX_VERTICES + 1];
    double left = vertex[0], right = left, bottom = vertex[1], top = bottom, reach = 0;
    for (int k = 0; k < corners; ++k) {
        x[k] = vertex[2 * k];
        y[k] = vertex[2 * k + 1];
        left = smaller(x[k], left);
        right = larger(x[k], right);
        bottom = smaller(y[k], bottom);
        top = larger(y[k], top);
        const double dx = x[k] - center_x, dy = y[k] - center_y;
        reach = larger(dx * dx + dy * dy, reach);
    }
    x[corners] = x[0];
    y[corners] = y[0];
    reach = __builtin_sqrt(reach) + radius;
    const double size = larger(larger(-left, right), larger(-bottom, top));
    const double slack = ROUNDING * (size + larger(size_of(center_x), size_of(center_y)));
    if (!(center_x >= left - slack && center_x <= right + slack)) return 1;
    if (!(center_y >= bottom - slack && center_y <= top + slack)) return 1;
    if (!(size_of((double)shape_extent.data[s] - reach) <= slack + NEAR * reach)) return 1;
    if (corners == 1) continue;

    const REAL* normal = (const REAL*)(vertex_normals.data + start);
    int wrong = 0;
#pragma clang loop vectorize_width(4) interleave_count(1)
    for (int k = 0; k < corners; ++k) {
        const double dx = x[k + 1] - x[k], dy = y[k + 1] - y[k];
        const double per_side = 1 / __builtin_sqrt(dx * dx + dy * dy);
        ux[k] = dx * per_side;
        uy[k] = dy * per_side;
        blur[k] = ROUNDING * size * per_side + NEAR;
        const double nx = normal[2 * k], ny = normal[2 * k + 1], one = nx * nx + ny * ny;
        const double off_x = nx - uy[k], off_y = ny + ux[k];
        wrong |= (int)!(off_x * off_x + off_y * off_y <= blur[k] * blur[k]);
        wrong |= (int)!(one >= (1 - NEAR) * (1 - NEAR)) | (int)!(one <= (1 + NEAR) * (1 + NEAR));
    }
    if (wrong) return 1;
    if (corners == 2) continue;
    ux[corners] = ux[0];
    uy[corners] = uy[0];
    blur[corners] = blur[0];
    double area = 0, turn = 0;
    for (int k = 0; k < corners; ++k) {
        const double sine = ux[k] * uy[k + 1] - uy[k] * ux[k + 1];
        if (!(sine >= -(blur[k] + blur[k + 1]))) return 1;
        if (corners > 4) turn += wp::atan2(larger(sine, 0.0), ux[k] * ux[k + 1] + uy[k] * uy[k + 1]);
        area += ((x[k] - x[0]) * (y[k + 1] - y[0]) - (y[k] - y[0]) * (x[k + 1] - x[0])) / 2;
    }
    const double width = right - left, height = top - bottom;
    if (!(area > FLAT * (width * width + height * height) && turn < 3 * 3.141592653589793)) return 1;
}
return 0;
#else
return 1;
#endif
