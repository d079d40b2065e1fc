// What the shape of each query meets first on its way along a translation: the point of the shape in a body's frame is
// cast against the sum of that body's shape and its own turned around, which is exact (no iterations).
#if !defined(__CUDA_ARCH__)
for (int q = query_offset; q < query_offset + queries; ++q) {
    Hull own;
    Real low[2], high[2];
    corners_of(q, own, low, high);
    const Real px = query.place.data[q][0], py = query.place.data[q][1];
    const Real dx = query.translation.data[q][0], dy = query.translation.data[q][1];
    const Real wide = size_of(dx), tall = size_of(dy), square = dx * dx + dy * dy;
    const Real grow = ROUNDING * (size_of(px) + size_of(py) + wide + tall + size_of(high[0]) + size_of(low[0]));
    Real best = 1, normal_x = 0, normal_y = 0;
    int met = -1;
    auto look = [&](const Real* box, Vector& key) -> unsigned {
        const Vector left = load(box) - (px + high[0] + grow), right = load(box + 2 * LANES) - (px + low[0] - grow);
        const Vector bottom = load(box + LANES) - (py + high[1] + grow);
        const Vector top = load(box + 3 * LANES) - (py + low[1] - grow);
        const Vector cx = (left + right) * (Real)0.5, cy = (bottom + top) * (Real)0.5;
        const Vector hx = (right - left) * (Real)0.5, hy = (top - bottom) * (Real)0.5;
        const Real mx = dx * best * (Real)0.5, my = dy * best * (Real)0.5;
        const Vector ax = magnitude(cx), ay = magnitude(cy), reach = hx * wide + hy * tall;
        const Vector across = magnitude(cy * dx - cx * dy) - ROUNDING * (ay * wide + ax * tall);
        key = cx * dx + cy * dy - reach - ROUNDING * (ax * wide + ay * tall);
        return bits_of((magnitude(cx - mx) <= hx + size_of(mx)) & (magnitude(cy - my) <= hy + size_of(my)) &
                       (across <= hx * tall + hy * wide));
    };
    auto visit = [&](int s) {
        if (!asks_for(q, s)) return;
        const int b = model.shape_body.data[s];
        const Real c = tree.rotation.data[b][0], sine = tree.rotation.data[b][1];
        Hull shape, turned, sum;
        Real at[2], nx, ny;
        core_of(s, shape);
        into_frame(b, px, py, own, turned, at);
        if (own.corners == 1) {
            sum = shape;
            sum.radius += own.radius;
        } else {
            add_reversed(shape, turned, sum);
        }
        const Real t = cast(sum, at[0], at[1], c * dx + sine * dy, c * dy - sine * dx, best, nx, ny);
        if (!(t >= 0) || (t == best && met >= 0 && s > met)) return;
        best = t;
        met = s;
        normal_x = c * nx - sine * ny;
        normal_y = sine * nx + c * ny;
    };
    walk(world_of(q), look, [&] { return best * square; }, visit);
    hit.shape.data[q] = met;
    hit.fraction.data[q] = best;
    hit.normal.data[q][0] = normal_x;
    hit.normal.data[q][1] = normal_y;
    Real x = px + best * dx, y = py + best * dy;
    if (met >= 0 && (normal_x != 0 || normal_y != 0)) {
        // the foremost point of the shape; where a side meets a side, the middle of what both have in common
        Real mine[2], other[2], middle = 0, front = own.radius;
        if (own.corners > 1) {
            const int b = model.shape_body.data[met];
            const Real c = tree.rotation.data[b][0], sine = tree.rotation.data[b][1];
            Hull shape, placed;
            core_of(met, shape);
            placed = shape;
            for (int k = 0; k < shape.corners; ++k) {
                placed.x[k] = c * shape.x[k] - sine * shape.y[k] + tree.place.data[b][0] - x;
                placed.y[k] = sine * shape.x[k] + c * shape.y[k] + tree.place.data[b][1] - y;
            }
            front = front_of(own, -normal_x, -normal_y, mine);
            front_of(placed, normal_x, normal_y, other);
            // the own tangent is the other's turned around
            const Real from = -mine[1] > other[0] ? -mine[1] : other[0], to = -mine[0] < other[1] ? -mine[0] : other[1];
            middle = (from + to) / 2;
        }
        x += middle * normal_y - front * normal_x;
        y -= middle * normal_x + front * normal_y;
    }
    hit.point.data[q][0] = x;
    hit.point.data[q][1] = y;
}
#endif
