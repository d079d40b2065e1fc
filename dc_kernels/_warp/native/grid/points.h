// Calls work(j, i) for the points i = item(k), k = begin .. end - 1, LANES of them at a time: prepare() takes their
// coordinates from xs and ys and leaves them in spacings.
#if !defined(__CUDA_ARCH__)
auto each_point = [&](auto prepare, auto work) {
    for (int k = begin; k < end; k += LANES) {
        const int together = end - k < LANES ? end - k : LANES;
        int at[LANES];
        for (int j = 0; j < together; ++j) {
            at[j] = item(k + j);
            const Real* const p = places + pitch * at[j];
            xs[j] = p[0];
            ys[j] = p[1];
        }
        prepare();
        for (int j = 0; j < together; ++j) work(j, at[j]);
    }
};
#endif
