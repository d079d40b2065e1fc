// Box of each world's points, and of what lower and upper held before unless it is fresh; NaN for a world with a point
// that is not finite. Macros: DIM, LANES.
#if !defined(__CUDA_ARCH__)
for (int w = world_offset; w < world_offset + worlds; ++w) {
    const Real* p = point.data + (size_t)start.data[w] * DIM;
    const Long m = (Long)(start.data[w + 1] - start.data[w]) * DIM;
    double* low = lower.data + (size_t)w * DIM;
    double* high = upper.data + (size_t)w * DIM;
    if (fresh) {
        for (int k = 0; k < DIM; ++k) {
            low[k] = __builtin_inf();
            high[k] = -__builtin_inf();
        }
    }
    Real odd = 0;  // what is not finite, minus itself, is not 0
    Long i = 0;
    if (m >= LANES * DIM) {
        Vector lo[DIM], hi[DIM], off = *(const Vector*)p - *(const Vector*)p;
        for (int k = 0; k < DIM; ++k) lo[k] = hi[k] = *(const Vector*)(p + LANES * k);
        for (i = LANES * DIM; i + LANES * DIM <= m; i += LANES * DIM) {
            for (int k = 0; k < DIM; ++k) {
                const Vector v = *(const Vector*)(p + i + LANES * k);
                lo[k] = __builtin_elementwise_min(lo[k], v);
                hi[k] = __builtin_elementwise_max(hi[k], v);
                off += v - v;
            }
        }
        for (int k = 0; k < DIM; ++k) {
            off += lo[k] - lo[k] + (hi[k] - hi[k]);
            for (int l = 0; l < LANES; ++l) {
                const int axis = (LANES * k + l) % DIM;
                if (lo[k][l] < low[axis]) low[axis] = lo[k][l];
                if (hi[k][l] > high[axis]) high[axis] = hi[k][l];
            }
        }
        for (int l = 0; l < LANES; ++l) odd += off[l];
    }
    for (; i < m; ++i) {
        const int axis = i % DIM;
        if (p[i] < low[axis]) low[axis] = p[i];
        if (p[i] > high[axis]) high[axis] = p[i];
        odd += p[i] - p[i];
    }
    if (!(odd == 0)) {
        for (int k = 0; k < DIM; ++k) low[k] = high[k] = __builtin_nan("");
    }
}
#endif
