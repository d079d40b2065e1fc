// What reading contacts in lanes needs: logarithm and asinh, and rows of memory from a vector a column. The logarithm
// of float32 is that of Cephes (Moshier). Behind prelude.h. Macro: IS_FLOAT.
#if !defined(__CUDA_ARCH__)
typedef int Integers __attribute__((ext_vector_type(LANES), aligned(4)));
// Of positive numbers that are not subnormal.
auto logarithm = [&](Vector x) {
#if IS_FLOAT
    const Integers bits = *(const Integers*)&x;
    const Integers exponent = (bits - 0x3f3504f3) >> 23;  // what is left lies between the roots of 1/2 and 2
    const Integers rest = bits - (exponent << 23);
    const Vector f = *(const Vector*)&rest - 1.0f, e = __builtin_convertvector(exponent, Vector), z = f * f;
    Vector p = 7.0376836292e-2f * f - 1.1514610310e-1f;
    p = p * f + 1.1676998740e-1f;
    p = p * f - 1.2420140846e-1f;
    p = p * f + 1.4249322787e-1f;
    p = p * f - 1.6668057665e-1f;
    p = p * f + 2.0000714765e-1f;
    p = p * f - 2.4999993993e-1f;
    p = p * f + 3.3333331174e-1f;
    return f + (p * f * z - 2.12194440e-4f * e - 0.5f * z) + 0.693359375f * e;
#else
    for (int i = 0; i < LANES; ++i) x[i] = wp::log(x[i]);
    return x;
#endif
};
auto root = [&](Vector x) { return __builtin_elementwise_sqrt(x); };
// asinh: linear for small values, logarithmic for large ones.
auto squash = [&](Vector x) {
    const Vector size =
        smaller(magnitude(x), zero + (Real)1e18);  // whose square is finite: at exact rest the step is none
    const Vector log = logarithm(size + root(size * size + 1));
    return x < 0 ? -log : log;
};
// Values of eight columns, a vector each, to `lanes` rows that are `pitch` apart.
auto store_rows = [&](const Vector* column, Real* to, size_t pitch, int lanes) {
#define LOW_HALVES(a, b) __builtin_shufflevector(a, b, 0, 8, 1, 9, 4, 12, 5, 13)
#define HIGH_HALVES(a, b) __builtin_shufflevector(a, b, 2, 10, 3, 11, 6, 14, 7, 15)
#define LOW_PAIRS(a, b) __builtin_shufflevector(a, b, 0, 1, 8, 9, 4, 5, 12, 13)
#define HIGH_PAIRS(a, b) __builtin_shufflevector(a, b, 2, 3, 10, 11, 6, 7, 14, 15)
    Vector four[2][4], row[LANES];
#pragma unroll
    for (int h = 0; h < 2; ++h) {
        const Vector* const c = column + 4 * h;
        const Vector low = LOW_HALVES(c[0], c[1]), high = HIGH_HALVES(c[0], c[1]);
        const Vector next_low = LOW_HALVES(c[2], c[3]), next_high = HIGH_HALVES(c[2], c[3]);
        four[h][0] = LOW_PAIRS(low, next_low);
        four[h][1] = HIGH_PAIRS(low, next_low);
        four[h][2] = LOW_PAIRS(high, next_high);
        four[h][3] = HIGH_PAIRS(high, next_high);
    }
#pragma unroll
    for (int i = 0; i < 4; ++i) {
        row[i] = __builtin_shufflevector(four[0][i], four[1][i], 0, 1, 2, 3, 8, 9, 10, 11);
        row[i + 4] = __builtin_shufflevector(four[0][i], four[1][i], 4, 5, 6, 7, 12, 13, 14, 15);
    }
    for (int i = 0; i < lanes; ++i) store(to + i * pitch, row[i]);
#undef LOW_HALVES
#undef HIGH_HALVES
#undef LOW_PAIRS
#undef HIGH_PAIRS
};
auto store_pairs = [&](Real* to, Vector x, Vector y, int lanes) {
    const Vector low = __builtin_shufflevector(x, y, 0, 8, 1, 9, 2, 10, 3, 11);
    const Vector high = __builtin_shufflevector(x, y, 4, 12, 5, 13, 6, 14, 7, 15);
    if (lanes == LANES) {
        store(to, low);
        store(to + LANES, high);
        return;
    }
    for (int i = 0; i < 2 * lanes; ++i) to[i] = i < LANES ? low[i] : high[i - LANES];
};
#endif
