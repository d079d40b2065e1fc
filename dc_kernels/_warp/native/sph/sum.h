// Sums of the neighbours' values times W, grad W or lap W, or of values . grad W. Macros: QUANTITY_VALUE ...
#if !defined(__CUDA_ARCH__)
if (sum.quantity == QUANTITY_VALUE || sum.quantity == QUANTITY_LAPLACIAN) {
    run(sum.quantity == QUANTITY_VALUE ? TERM_W : TERM_LAPLACIAN, [&](int q, int vectors) {
        for (int c = 0; c < width; ++c) {
            Vector added = zero;
            for (int j = 0; j < LANES * vectors; j += LANES) added += load(s0 + j) * column(j, c);
            sums[(size_t)q * out_width + c] += sum.scale * total(added);
        }
    });
} else if (sum.quantity == QUANTITY_GRADIENT) {
    run(TERM_F, [&](int q, int vectors) {
        for (int c = 0; c < width; ++c) {
            Vector x = zero, y = zero, z = zero;
            for (int j = 0; j < LANES * vectors; j += LANES) {
                const Vector a = load(s0 + j) * column(j, c);
                x += a * load(e0 + j);
                y += a * load(e1 + j);
                if (dim == 3) z += a * load(e2 + j);
            }
            Real* own = sums + (size_t)q * out_width + c * dim;
            own[0] += sum.scale * total(x);
            own[1] += sum.scale * total(y);
            if (dim == 3) own[2] += sum.scale * total(z);
        }
    });
} else {
    run(TERM_F, [&](int q, int vectors) {
        for (int c = 0; c < out_width; ++c) {
            Vector added = zero;
            for (int j = 0; j < LANES * vectors; j += LANES) {
                Vector a = zero;
                for (int k = 0; k < dim; ++k) a += load(offsets[k] + j) * column(j, c * dim + k);
                added += load(s0 + j) * a;
            }
            sums[(size_t)q * out_width + c] += sum.scale * total(added);
        }
    });
}
#endif
