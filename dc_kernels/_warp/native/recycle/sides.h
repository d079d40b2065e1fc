// Points and directions of LANES pairs side by side. Stands behind prelude.h, solve/bodies.h and side.h.
#if !defined(__CUDA_ARCH__)
struct Side {
    Vector x, y;
};
const Vector one = (Real)1;
auto root = [](Vector v) { return __builtin_elementwise_sqrt(v); };
auto dot = [](Side p, Side q) { return p.x * q.x + p.y * q.y; };
auto cross = [](Side p, Side q) { return p.x * q.y - p.y * q.x; };
auto plus = [](Side p, Side q) { return Side{p.x + q.x, p.y + q.y}; };
auto minus = [](Side p, Side q) { return Side{p.x - q.x, p.y - q.y}; };
auto times = [](Side p, Vector factor) { return Side{p.x * factor, p.y * factor}; };
auto turned = [](Vector c, Vector s, Side p) { return Side{c * p.x - s * p.y, s * p.x + c * p.y}; };
auto turned_back = [](Vector c, Vector s, Side p) { return Side{c * p.x + s * p.y, c * p.y - s * p.x}; };
auto length_of = [&](Side p) { return root(dot(p, p)); };
auto choose = [&](auto mask, Side p, Side q) { return Side{pick(mask, p.x, q.x), pick(mask, p.y, q.y)}; };
auto store_points = [&](Real* to, Side p) {
    store(to, __builtin_shufflevector(p.x, p.y, 0, 8, 1, 9, 2, 10, 3, 11));
    store(to + LANES, __builtin_shufflevector(p.x, p.y, 4, 12, 5, 13, 6, 14, 7, 15));
};
auto side_at = [&](const auto& points, const int* at) {
    Side p;
    pairs_at((const Real*)points.data, at, p.x, p.y);
    return p;
};
#endif
