// The shapes that the shape of each query overlaps or touches: counted, and stored from `list_start`
// on where there is room.
#if !defined(__CUDA_ARCH__)
for (int q = query_offset; q < query_offset + queries; ++q) {
    Hull own;
    Real low[2], high[2];
    corners_of(q, own, low, high);
    const Real px = query.place.data[q][0], py = query.place.data[q][1];
    const Real grow = ROUNDING * (size_of(px) + size_of(py) + size_of(high[0]) + size_of(low[0]));
    long long found = 0;
    auto look = [&](const Real* box, Vector& key) -> unsigned {
        key = 0;
        return bits_of((load(box) <= px + high[0] + grow) & (load(box + 2 * LANES) >= px + low[0] - grow) &
                       (load(box + LANES) <= py + high[1] + grow) & (load(box + 3 * LANES) >= py + low[1] - grow));
    };
    auto visit = [&](int s) {
        if (!asks_for(q, s)) return;
        Hull shape, turned, sum;
        Real at[2], nx, ny;
        core_of(s, shape);
        into_frame(model.shape_body.data[s], px, py, own, turned, at);
        if (own.corners == 1) {
            sum = shape;
            sum.radius += own.radius;
        } else {
            add_reversed(shape, turned, sum);
        }
        if (!(distance_to(sum, at[0], at[1], nx, ny) <= sum.radius)) return;
        if (index.shape[0] > 0) index.data[list_start.data[q] + found] = s;
        ++found;
    };
    walk(world_of(q), look, [] { return (Real)0; }, visit);
    list_count.data[q] = found;
}
#endif
