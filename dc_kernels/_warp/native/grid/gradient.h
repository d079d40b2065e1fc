// The derivative of value . gathered image by the places of a chunk's points. Where weights are divided by their sum,
// S = w / sum w: sum_i dS_i a_i = (sum dw a - (sum w a) (sum dw) / sum w) / sum w, with a_i = sum_c value_c image_ci.
#if !defined(__CUDA_ARCH__)
auto differentiate = [&](auto prepare, auto place, auto first_weight, auto weight, auto gradient, Real constant,
                         bool separable) {
    each_point(prepare, [&](int j, int i) {
        const Real* own = value.data + (size_t)i * channels;
        Real gx = 0, gy = 0;
        if (place(j)) {
            const Real* from = image_of(i);
            Vector sum = zero, wa = zero, dx = zero, dy = zero, dxa = zero, dya = zero;
            for (int r = r0; r <= r1; ++r) {
                for (int v = 0; v < vectors; ++v) {
                    Vector field = zero, wx, wy;
                    const Real* row = from + (size_t)r * columns + first + v * LANES;
                    for (int c = 0; c < channels; ++c) field += load_columns(row + c * channel_stride, v) * own[c];
                    const Vector w = weight(r, v);
                    gradient(r, v, wx, wy);
                    sum += w;
                    wa += w * field;
                    dx += wx;
                    dy += wy;
                    dxa += wx * field;
                    dya += wy * field;
                }
            }
            const Real t = separable ? 1 : fold(sum);
            if (t > tiny) {
                if (constant == 0) {
                    const Real mean = fold(wa) / t;
                    gx = (fold(dxa) - mean * fold(dx)) / t;
                    gy = (fold(dya) - mean * fold(dy)) / t;
                } else {
                    gx = fold(dxa) * constant;
                    gy = fold(dya) * constant;
                }
            }
        }
        Real* out = (Real*)gradient_out.data + 2 * (size_t)i;
        out[0] = gx * inv;
        out[1] = gy * inv;
    });
};
each_stencil(differentiate);
#endif
