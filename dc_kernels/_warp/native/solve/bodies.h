// Velocities of the two bodies of LANES = 8 rows: 4 x 4 transposes between vec4 in memory and a vector a component.
// Macros: as prelude.h.
#if !defined(__CUDA_ARCH__)
#define LOW_HALVES(a, b) __builtin_shufflevector(a, b, 0, 8, 1, 9, 4, 12, 5, 13)
#define HIGH_HALVES(a, b) __builtin_shufflevector(a, b, 2, 10, 3, 11, 6, 14, 7, 15)
#define LOW_PAIRS(a, b) __builtin_shufflevector(a, b, 0, 1, 8, 9, 4, 5, 12, 13)
#define HIGH_PAIRS(a, b) __builtin_shufflevector(a, b, 2, 3, 10, 11, 6, 7, 14, 15)
struct Bodies {
    Vector x, y, w, m;  // velocity, spin, inverse mass
};
// Its own inverse.
auto transpose = [&](Vector& a, Vector& b, Vector& c, Vector& d) {
    const Vector t0 = LOW_HALVES(a, b), t1 = LOW_HALVES(c, d), t2 = HIGH_HALVES(a, b), t3 = HIGH_HALVES(c, d);
    a = LOW_PAIRS(t0, t1);
    b = HIGH_PAIRS(t0, t1);
    c = LOW_PAIRS(t2, t3);
    d = HIGH_PAIRS(t2, t3);
};
Real* const velocity = (Real*)bodies.data;
auto load_from = [&](const Real* all, const int* index) {
    auto pair = [&](int i) {
        const Quad q = *(const Quad*)(all + 4 * (size_t)index[i]);
        const Quad r = *(const Quad*)(all + 4 * (size_t)index[i + 4]);
        return __builtin_shufflevector(q, r, 0, 1, 2, 3, 4, 5, 6, 7);
    };
    Bodies v = {pair(0), pair(1), pair(2), pair(3)};
    transpose(v.x, v.y, v.w, v.m);
    return v;
};
auto load_bodies = [=](const int* index) { return load_from(velocity, index); };
// Keeps LLVM from taking apart the shuffles that made a vector: it would put its halves together by twice as many, for
// which processors have one port (4 % of a sweep with AVX-512).
auto intact = [](auto v) {
#if defined(__AVX__)
    if constexpr (sizeof(v) == 32) asm("" : "+x"(v));
#endif
    return v;
};
auto store_bodies = [&](const int* index, Bodies v) {
    transpose(v.x, v.y, v.w, v.m);
    auto pair = [&](int i, Vector both) {
        *(Quad*)(velocity + 4 * (size_t)index[i]) = __builtin_shufflevector(both, both, 0, 1, 2, 3);
        *(Quad*)(velocity + 4 * (size_t)index[i + 4]) = __builtin_shufflevector(both, both, 4, 5, 6, 7);
    };
    pair(0, intact(v.x));
    pair(1, intact(v.y));
    pair(2, intact(v.w));
    pair(3, intact(v.m));
};
#undef LOW_HALVES
#undef HIGH_HALVES
#undef LOW_PAIRS
#undef HIGH_PAIRS
#endif
