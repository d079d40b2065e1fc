// The shape whose surface is nearest to the point of each query, or that it lies deepest in; not farther than `most`.
#if !defined(__CUDA_ARCH__)
for (int q = query_offset; q < query_offset + queries; ++q) {
    const Real px = query.place.data[q][0], py = query.place.data[q][1];
    Real best = query.most.data[q], normal_x = 0, normal_y = 0;
    int met = -1;
    auto look = [&](const Real* box, Vector& key) -> unsigned {
        const Vector x = larger(larger(load(box) - px, px - load(box + 2 * LANES)), zero);
        const Vector y = larger(larger(load(box + LANES) - py, py - load(box + 3 * LANES)), zero);
        key = x * x + y * y;
        key -= ROUNDING * key;
        return bits_of(key <= (best > 0 ? best * best : (Real)0));
    };
    auto visit = [&](int s) {
        if (!asks_for(q, s)) return;
        const int b = model.shape_body.data[s];
        const Real c = tree.rotation.data[b][0], sine = tree.rotation.data[b][1];
        const Real rx = px - tree.place.data[b][0], ry = py - tree.place.data[b][1];
        Hull shape;
        Real nx, ny;
        core_of(s, shape);
        const Real far = distance_to(shape, c * rx + sine * ry, c * ry - sine * rx, nx, ny) - shape.radius;
        if (!(far <= best) || (far == best && met >= 0 && s > met)) return;
        best = far;
        met = s;
        normal_x = c * nx - sine * ny;
        normal_y = sine * nx + c * ny;
    };
    walk(world_of(q), look, [&] { return best > 0 ? best * best : (Real)0; }, visit);
    hit.shape.data[q] = met;
    hit.fraction.data[q] = best;
    hit.normal.data[q][0] = normal_x;
    hit.normal.data[q][1] = normal_y;
    hit.point.data[q][0] = met >= 0 ? px - best * normal_x : px;
    hit.point.data[q][1] = met >= 0 ? py - best * normal_y : py;
}
#endif
