// Sums of the neighbours' values times W, grad W or lap W, or of values . grad W. Macros: QUANTITY_VALUE ...
#if !defined(__CUDA_ARCH__)
if (quantity == QUANTITY_VALUE || quantity == QUANTITY_LAPLACIAN) {
    run(quantity == QUANTITY_VALUE ? TERM_W : TERM_LAPLACIAN, [&](int q, int vectors) {
        for (int c = 0; c < width; ++c) {
            Vector sum = zero;
            for (int j = 0; j < LANES * vectors; j += LANES) sum += load(s0 + j) * column(j, c);
            sums[(size_t)q * out_width + c] += scale * total(sum);
        }
    });
} else if (quantity == QUANTITY_GRADIENT) {
    run(TERM_F, [&](int q, int vectors) {
        for (int c = 0; c < width; ++c) {
            Vector x = zero, y = zero, z = zero;
            for (int j = 0; j < LANES * vectors; j += LANES) {
                const Vector a = load(s0 + j) * column(j, c);
                x += a * load(e0 + j);
                y += a * load(e1 + j);
                if (dim == 3) z += a * load(e2 + j);
            }
            Real* sum = sums + (size_t)q * out_width + c * dim;
            sum[0] += scale * total(x);
            sum[1] += scale * total(y);
            if (dim == 3) sum[2] += scale * total(z);
        }
    });
} else {
    run(TERM_F, [&](int q, int vectors) {
        for (int c = 0; c < out_width; ++c) {
            Vector sum = zero;
            for (int j = 0; j < LANES * vectors; j += LANES) {
                Vector a = zero;
                for (int k = 0; k < dim; ++k) a += load(offsets[k] + j) * column(j, c * dim + k);
                sum += load(s0 + j) * a;
            }
            sums[(size_t)q * out_width + c] += scale * total(sum);
        }
    });
}
#endif
