// The window of nodes that a point reaches: rows r0 .. r1, and `vectors` vectors of columns from column `first`. It is
// slid into the row where it would leave it, and nodes out of reach have weight 0, so that no column is tested.
// Lengths are in spacings. Names before: stencil, points, image (4-D), world. Macro: WINDOW_ROWS.
#if !defined(__CUDA_ARCH__)
typedef int Integers __attribute__((ext_vector_type(LANES), aligned(4)));
const int rows = image.shape[2], columns = image.shape[3];
const Real inv = 1 / stencil.spacing, hs = stencil.h * inv, inv_h2 = 1 / (hs * hs);
const Real origin_x = ((const Real*)points.origin.data)[2 * world];
const Real origin_y = ((const Real*)points.origin.data)[2 * world + 1];
const Real* const places = (const Real*)points.place.data;
const size_t pitch = points.place.strides[0] / sizeof(Real);  // from a point to the next: 3 where a z is passed over
Vector iota;
for (int j = 0; j < LANES; ++j) iota[j] = (Real)j;
// sum of the lanes by halves
auto fold = [](Vector v) {
    const auto four = v.lo + v.hi;
    const auto two = four.lo + four.hi;
    return two.x + two.y;
};

Real x, y;
int r0, r1, first, vectors;
bool one;  // a single vector, all of it in the row, and few rows
auto slide = [&](int c0, int c1) {
    first = c0;
    vectors = (c1 - c0) / LANES + 1;
    if (first + vectors * LANES > columns) first = columns > vectors * LANES ? columns - vectors * LANES : 0;
    one = vectors == 1 && first + LANES <= columns && r1 - r0 < WINDOW_ROWS;
};
// LANES points at a time: their coordinates, then in spacings, NaN and inf kept; what is finite stays so, far outside
const Real far_outside = sizeof(Real) == 4 ? (Real)1e37 : (Real)1e300;
auto in_spacings = [&](Vector p, Real origin) { return clamp((p - origin) * inv, zero + far_outside) + (p - p); };
Real xs[LANES] = {0}, ys[LANES] = {0};
auto to_grid = [&]() {
    *(Vector*)xs = in_spacings(*(const Vector*)xs, origin_x);
    *(Vector*)ys = in_spacings(*(const Vector*)ys, origin_y);
};
auto is_finite = [](Real u, Real v) { return u - u == 0 && v - v == 0; };
// a grid narrower than the window: what lies beyond it has no weight and is not touched
auto within = [&](Vector w, int v) {
    const int n = columns - (first + v * LANES);
    if (n < LANES)
        for (int j = 0; j < LANES; ++j)
            if (j >= n) w[j] = 0;
    return w;
};
auto load_columns = [&](const Real* p, int v) -> Vector {
    const int n = columns - (first + v * LANES);
    if (n >= LANES) return *(const Vector*)p;
    Vector w = zero;
    for (int j = 0; j < LANES; ++j)
        if (j < n) w[j] = p[j];
    return w;
};
auto store_columns = [&](Real* p, int v, Vector w) {
    const int n = columns - (first + v * LANES);
    if (n >= LANES) {
        *(Vector*)p = w;
        return;
    }
    for (int j = 0; j < LANES; ++j)
        if (j < n) p[j] = w[j];
};
auto finite = [&](int i) {
    const Real px = places[pitch * i], py = places[pitch * i + 1];
    x = clip((px - origin_x) * inv, -far_outside, far_outside);
    y = clip((py - origin_y) * inv, -far_outside, far_outside);
    return is_finite(px, py);
};
auto nearest_node = [&](Real u, int nodes) { return (int)(clip(u, 0, nodes - 1) + (Real)0.5); };
auto outside = [&](Real u, Real v) { return u < 0 || v < 0 || u > (Real)(columns - 1) || v > (Real)(rows - 1); };
const Real steps[WINDOW_ROWS] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
// a sum of weights below it is no weight at all
const Real tiny = sizeof(Real) == 4 ? (Real)1e-37 : (Real)1e-300;
#endif
