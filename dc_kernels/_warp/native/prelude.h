// What the headers share: vectors of LANES numbers, in which operations are not contracted, so that lanes and scalar
// functions give the same bits. Macros: REAL, LANES (8).
#if !defined(__CUDA_ARCH__)
#pragma clang fp contract(off)
#endif
typedef REAL Real;
#if !defined(__CUDA_ARCH__)
typedef Real Vector __attribute__((ext_vector_type(LANES), aligned(4)));
typedef Real Quad __attribute__((ext_vector_type(4), aligned(4)));
const Vector zero = (Real)0;
auto load = [&](const Real* p) { return *(const Vector*)p; };
auto store = [&](Real* p, Vector v) { *(Vector*)p = v; };
// The second of both where either is NaN: one instruction of x86, where to ignore NaN takes three (4 to 12 % of a
// sweep).
auto larger = [&](Vector a, Vector b) { return a > b ? a : b; };
auto smaller = [&](Vector a, Vector b) { return a < b ? a : b; };
auto magnitude = [&](Vector a) { return __builtin_elementwise_abs(a); };
auto clamp = [&](Vector v, Vector limit) { return larger(-limit, smaller(v, limit)); };
// Sum of the lanes, in a fixed order.
auto total = [&](Vector v) { return ((v[0] + v[1]) + (v[2] + v[3])) + ((v[4] + v[5]) + (v[6] + v[7])); };
// The largest lane that is above 0, else 0.
auto largest = [&](Vector v) {
    Real most = 0;
    for (int i = 0; i < LANES; ++i)
        if (v[i] > most) most = v[i];
    return most;
};
#endif
