// The gradient of a sum by the queries' positions. Macros: QUANTITY_VALUE, QUANTITY_GRADIENT, TERM_F ...
#if !defined(__CUDA_ARCH__)
const Real* const query_values = (const Real*)query_value.data;
const int own_width = (int)query_value.shape[1];
if (sum.quantity != QUANTITY_GRADIENT) {
    run(sum.quantity == QUANTITY_VALUE ? TERM_F : TERM_LAPLACIAN_SLOPE, [&](int q, int vectors) {
        const Real* own = query_values + (size_t)q * own_width;
        Vector x[3] = {zero, zero, zero};
        for (int j = 0; j < LANES * vectors; j += LANES) {
            Vector a = zero;
            for (int c = 0; c < width; ++c) a += own[c] * column(j, c);
            a *= load(s0 + j);
            for (int k = 0; k < dim; ++k) x[k] += a * load(offsets[k] + j);
        }
        for (int k = 0; k < dim; ++k) sums[(size_t)q * dim + k] += sum.scale * total(x[k]);
    });
} else {
    // one side's values have a component for each axis: the queries', or, if swapped, the neighbours'
    const Real signed_scale = sum.swapped ? -sum.scale : sum.scale;
    const int channels = sum.swapped ? own_width : width;
    run(TERM_HESSIAN, [&](int q, int vectors) {
        const Real* own = query_values + (size_t)q * own_width;
        Vector x[3] = {zero, zero, zero};
        for (int j = 0; j < LANES * vectors; j += LANES) {
            Vector s[3] = {zero, zero, zero}, along = zero;
            for (int c = 0; c < channels; ++c) {
                if (sum.swapped) {
                    for (int k = 0; k < dim; ++k) s[k] += own[c] * column(j, c * dim + k);
                } else {
                    const Vector a = column(j, c);
                    for (int k = 0; k < dim; ++k) s[k] += own[c * dim + k] * a;
                }
            }
            for (int k = 0; k < dim; ++k) along += load(offsets[k] + j) * s[k];
            along *= load(s1 + j);
            for (int k = 0; k < dim; ++k) x[k] += load(s0 + j) * s[k] + along * load(offsets[k] + j);
        }
        for (int k = 0; k < dim; ++k) sums[(size_t)q * dim + k] += signed_scale * total(x[k]);
    });
}
#endif
