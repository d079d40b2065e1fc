// What a query asks for, and the shape that it asks with.
#if !defined(__CUDA_ARCH__)
auto world_of = [&](int q) -> int { return query.world.shape[0] > 0 ? query.world.data[q] : 0; };
auto asks_for = [&](int q, int s) -> bool {
    if (query.mask.shape[0] > 0 && (model.shape_category.data[s] & query.mask.data[q]) == 0) return false;
    return query.skip.shape[0] == 0 || model.shape_body.data[s] != query.skip.data[q];
};
// The corners of the shape that a query asks with, turned by its angle; and the box around them.
auto corners_of = [&](int q, Hull& hull, Real* low, Real* high) {
    hull.corners = probe.corner.shape[0];
    hull.radius = probe.radius;
    const bool turned = query.rotation.shape[0] > 0, scaled = query.scale.shape[0] > 0;
    const Real c = turned ? query.rotation.data[q][0] : 1, s = turned ? query.rotation.data[q][1] : 0;
    for (int k = 0; k < hull.corners; ++k) {
        const Real x = probe.corner.data[k][0] * (scaled ? query.scale.data[q][0] : 1);
        const Real y = probe.corner.data[k][1] * (scaled ? query.scale.data[q][1] : 1);
        hull.x[k] = c * x - s * y;
        hull.y[k] = s * x + c * y;
        low[0] = k == 0 || hull.x[k] < low[0] ? hull.x[k] : low[0];
        low[1] = k == 0 || hull.y[k] < low[1] ? hull.y[k] : low[1];
        high[0] = k == 0 || hull.x[k] > high[0] ? hull.x[k] : high[0];
        high[1] = k == 0 || hull.y[k] > high[1] ? hull.y[k] : high[1];
    }
    for (int a = 0; a < 2; ++a) {
        low[a] -= hull.radius;
        high[a] += hull.radius;
    }
};
// A point, and the corners of a shape that are given about it, in the frame of a body.
auto into_frame = [&](int b, Real px, Real py, const Hull& given, Hull& turned, Real* point) {
    const Real c = tree.rotation.data[b][0], s = tree.rotation.data[b][1];
    const Real rx = px - tree.place.data[b][0], ry = py - tree.place.data[b][1];
    point[0] = c * rx + s * ry;
    point[1] = c * ry - s * rx;
    turned.corners = given.corners;
    turned.radius = given.radius;
    for (int k = 0; k < given.corners; ++k) {
        turned.x[k] = c * given.x[k] + s * given.y[k];
        turned.y[k] = c * given.y[k] - s * given.x[k];
    }
};
#endif
