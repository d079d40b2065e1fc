// Numbers of SIDE contacts side by side, one after the other in memory or wherever they lie: LANES of them on a CPU,
// one on a GPU. Macros: REAL, LANES. Parameters: bodies. Stands behind prelude.h and solve/bodies.h.
#if defined(__CUDA_ARCH__)
typedef Real Number;
const int SIDE = 1;
const Number zero = 0;
struct Bodies {
    Real x, y, w, m;  // velocity, spin, inverse mass
};
auto load_bodies = [&](const int* index) {
    const Real* const v = (const Real*)bodies.data + 4 * (size_t)index[0];
    return Bodies{v[0], v[1], v[2], v[3]};
};
auto store = [&](Real* to, Number v) { *to = v; };
auto larger = [&](Number a, Number b) { return a > b ? a : b; };
auto smaller = [&](Number a, Number b) { return a < b ? a : b; };
auto any = [&](bool mask) { return mask; };
auto values_at = [&](const Real* from, const int* at) { return from[at[0]]; };
auto pairs_at = [&](const Real* from, const int* at, Number& x, Number& y) {
    x = from[2 * (size_t)at[0]];
    y = from[2 * (size_t)at[0] + 1];
};
#else
typedef Vector Number;
const int SIDE = LANES;
auto any = [&](auto mask) { return __builtin_reduce_or(mask) != 0; };
// An index by which LANES loads stay loads: LLVM would make gathers of them, which take longer (a tenth of meet_again).
auto alone = [](int index) {
    asm("" : "+r"(index));
    return index;
};
auto values_at = [&](const Real* from, const int* at) {
    return Vector{from[at[0]], from[at[1]], from[at[2]], from[at[3]],
                  from[at[4]], from[at[5]], from[at[6]], from[at[7]]};
};
auto pairs_at = [&](const Real* from, const int* at, Vector& x, Vector& y) {
    typedef Real Pair __attribute__((ext_vector_type(2), aligned(4)));
    auto two = [&](int i) {
        const Pair p = *(const Pair*)(from + 2 * (size_t)at[i]), q = *(const Pair*)(from + 2 * (size_t)at[i + 1]);
        return __builtin_shufflevector(p, q, 0, 1, 2, 3);
    };
    const Vector outer = __builtin_shufflevector(two(0), two(4), 0, 1, 2, 3, 4, 5, 6, 7);
    const Vector inner = __builtin_shufflevector(two(2), two(6), 0, 1, 2, 3, 4, 5, 6, 7);
    x = __builtin_shufflevector(outer, inner, 0, 2, 8, 10, 4, 6, 12, 14);
    y = __builtin_shufflevector(outer, inner, 1, 3, 9, 11, 5, 7, 13, 15);
};
#endif
auto pick = [&](auto mask, Number a, Number b) { return mask ? a : b; };
