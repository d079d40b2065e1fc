// Boxes as four numbers, (low x, low y, high x, high y), and the comparisons that they need. Macro: REAL.
#if !defined(__CUDA_ARCH__)
#pragma clang fp contract(off)
typedef REAL Real;
typedef Real Quad __attribute__((ext_vector_type(4), aligned(4)));
auto quad = [](Real x, Real y, Real z, Real w) -> Quad { return (Quad){x, y, z, w}; };
auto least = [&](Quad p, Quad q) -> Quad { return __builtin_elementwise_min(p, q); };
auto most = [&](Quad p, Quad q) -> Quad { return __builtin_elementwise_max(p, q); };
// whether no number of p is above that of q; false where one is NaN
auto below = [&](Quad p, Quad q) -> bool { return __builtin_reduce_and(p <= q); };
#else
typedef REAL Real;
struct Quad {
    Real x, y, z, w;
    CUDA_CALLABLE Quad operator+(Quad q) const { return {x + q.x, y + q.y, z + q.z, w + q.w}; }
    CUDA_CALLABLE Quad operator-(Quad q) const { return {x - q.x, y - q.y, z - q.z, w - q.w}; }
};
auto quad = [](Real x, Real y, Real z, Real w) -> Quad { return {x, y, z, w}; };
auto smaller = [](Real p, Real q) -> Real { return q < p ? q : p; };
auto larger = [](Real p, Real q) -> Real { return p < q ? q : p; };
auto least = [&](Quad p, Quad q) -> Quad {
    return {smaller(p.x, q.x), smaller(p.y, q.y), smaller(p.z, q.z), smaller(p.w, q.w)};
};
auto most = [&](Quad p, Quad q) -> Quad {
    return {larger(p.x, q.x), larger(p.y, q.y), larger(p.z, q.z), larger(p.w, q.w)};
};
auto below = [&](Quad p, Quad q) -> bool { return p.x <= q.x && p.y <= q.y && p.z <= q.z && p.w <= q.w; };
#endif
auto load = [](const void* p) -> Quad { return *(const Quad*)p; };
auto store = [](void* p, Quad q) { *(Quad*)p = q; };
// box p has a point in common with box q where below(key(p), bound(q)), and lies in it where below(key(q), key(p))
auto key = [&](Quad p) -> Quad { return quad(p.x, p.y, -p.z, -p.w); };
auto bound = [&](Quad p) -> Quad { return quad(p.z, p.w, -p.x, -p.y); };
