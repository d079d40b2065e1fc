// Box of each world's points, and of what lower and upper held before. Macros: DIM, LANES.
#if !defined(__CUDA_ARCH__)
for (int w = world_offset; w < world_offset + worlds; ++w) {
    const Real* p = point.data + (size_t)start.data[w] * DIM;
    const Long m = (Long)(start.data[w + 1] - start.data[w]) * DIM;
    double* low = lower.data + (size_t)w * DIM;
    double* high = upper.data + (size_t)w * DIM;
    Long i = 0;
    if (m >= LANES * DIM) {
        Vector lo[DIM], hi[DIM];
        for (int k = 0; k < DIM; ++k) lo[k] = hi[k] = *(const Vector*)(p + LANES * k);
        for (i = LANES * DIM; i + LANES * DIM <= m; i += LANES * DIM) {
            for (int k = 0; k < DIM; ++k) {
                const Vector v = *(const Vector*)(p + i + LANES * k);
                lo[k] = __builtin_elementwise_min(lo[k], v);
                hi[k] = __builtin_elementwise_max(hi[k], v);
            }
        }
        for (int k = 0; k < DIM; ++k) {
            for (int l = 0; l < LANES; ++l) {
                const int axis = (LANES * k + l) % DIM;
                if (lo[k][l] < low[axis]) low[axis] = lo[k][l];
                if (hi[k][l] > high[axis]) high[axis] = hi[k][l];
            }
        }
    }
    for (; i < m; ++i) {
        const int axis = i % DIM;
        if (p[i] < low[axis]) low[axis] = p[i];
        if (p[i] > high[axis]) high[axis] = p[i];
    }
}
#endif
