// Gathers a chunk's values from the image. Bilinear alone has a loop of its own: places and weights of LANES points at
// once, while the four nodes of each of those before are read, two channels at a time. Nothing is fetched ahead: nodes
// of so many points are asked for at once that fetches only add to what waits (48 ns in place of 27 for each of 1e6
// points in random order on 64 MB, where every node is a cache line of its own).
#if !defined(__CUDA_ARCH__)
auto gather = [&](auto prepare, auto place, auto first_weight, auto weight, auto gradient, Real constant,
                  bool separable) {
    each_point(prepare, [&](int j, int i) {
        Real* own = value.data + (size_t)i * channels;
        const Real* from = image_of(i);
        bool hit = place(j);
        if (hit && one) {
            Vector sum = zero, f0 = zero, f1 = zero, f2 = zero, f3 = zero;
            const Real* row = from + (size_t)r0 * columns + first;
            const int d1 = channels > 1, d2 = channels > 2 ? 2 : 0, d3 = channels > 3 ? 3 : 0;
            for (int r = r0; r <= r1; ++r, row += columns) {
                const Vector w = first_weight(r);
                sum += w;
                f0 += w * *(const Vector*)row;
                f1 += w * *(const Vector*)(row + d1 * channel_stride);
                f2 += w * *(const Vector*)(row + d2 * channel_stride);
                f3 += w * *(const Vector*)(row + d3 * channel_stride);
            }
            const Real t = separable ? 1 : fold(sum);
            hit = t > tiny;
            const Real factor = hit ? (constant == 0 ? 1 / t : constant) : 0;
            own[0] = fold(f0) * factor;
            if (channels > 1) own[1] = fold(f1) * factor;
            if (channels > 2) own[2] = fold(f2) * factor;
            if (channels > 3) own[3] = fold(f3) * factor;
            for (int c = 4; c < channels; ++c) {
                Vector f = zero;
                const Real* p = from + c * channel_stride + (size_t)r0 * columns + first;
                for (int r = r0; r <= r1; ++r, p += columns) f += first_weight(r) * *(const Vector*)p;
                own[c] = fold(f) * factor;
            }
        } else if (hit) {
            for (int c = 0; c < channels; ++c) {
                Vector sum = zero, f = zero;
                for (int r = r0; r <= r1; ++r)
                    for (int v = 0; v < vectors; ++v) {
                        const Vector w = weight(r, v);
                        const Real* p = from + c * channel_stride + (size_t)r * columns + first + v * LANES;
                        sum += w;
                        f += w * load_columns(p, v);
                    }
                const Real t = separable ? 1 : fold(sum);
                hit = t > tiny;
                own[c] = hit ? fold(f) * (constant == 0 ? 1 / t : constant) : 0;
            }
        }
        if (!hit) {
            const Real px = xs[j], py = ys[j];
            const bool valid = is_finite(px, py);
            const Real* p = from + (valid ? (size_t)nearest_node(py, rows) * columns + nearest_node(px, columns) : 0);
            for (int c = 0; c < channels; ++c)
                own[c] = valid && stencil.nearest && stencil.normalize ? p[c * channel_stride] : 0;
        }
    });
};
auto gather_linear = [&]() {
    const size_t step = bins > 1 ? channels * channel_stride : 0;
    typedef long long Longs __attribute__((ext_vector_type(LANES), aligned(8)));
    typedef Real Pair __attribute__((ext_vector_type(2), aligned(sizeof(Real))));
    typedef Real Four __attribute__((ext_vector_type(4)));
    auto pairs = [](const Real* a, const Real* b) {
        return __builtin_shufflevector(*(const Pair*)a, *(const Pair*)b, 0, 1, 2, 3);
    };
    const Real* const origin = base + channel_offset * channel_stride;
    long long at[2][LANES];
    Real low[2][2 * LANES], high[2][2 * LANES];  // weights of the two nodes of a row, point by point
    for (int i = begin, k = 0; i < end + LANES; i += LANES, k ^= 1) {
        const int ahead = end - i < LANES ? end - i : LANES;
        if (ahead > 0) {
            Real xy[2 * LANES] = {0};
            const Real* q = places + pitch * i;
            if (ahead < LANES || pitch != 2) {
                for (int j = 0; j < 2 * ahead; ++j) xy[j] = q[j / 2 * pitch + j % 2];
                q = xy;
            }
            const Vector a = *(const Vector*)q, b = *(const Vector*)(q + LANES);
            Vector u = in_spacings(__builtin_shufflevector(a, b, 0, 2, 4, 6, 8, 10, 12, 14), origin_x);
            Vector v = in_spacings(__builtin_shufflevector(a, b, 1, 3, 5, 7, 9, 11, 13, 15), origin_y);
            const auto valid = (u - u == 0) & (v - v == 0);
            u = __builtin_elementwise_min(__builtin_elementwise_max(valid ? u : zero, zero),
                                          (Vector)(Real)(columns - 1));
            v = __builtin_elementwise_min(__builtin_elementwise_max(valid ? v : zero, zero), (Vector)(Real)(rows - 1));
            const Integers ix =
                __builtin_elementwise_min(__builtin_convertvector(u, Integers), (Integers)(columns - 2));
            const Integers iy = __builtin_elementwise_min(__builtin_convertvector(v, Integers), (Integers)(rows - 2));
            const Vector tx = u - __builtin_convertvector(ix, Vector), ty = v - __builtin_convertvector(iy, Vector);
            const Vector w00 = (1 - tx) * (1 - ty) * (valid ? (Vector)(Real)1 : zero), w01 = tx * (1 - ty);
            const Vector w10 = (1 - tx) * ty, w11 = tx * ty;
            *(Vector*)low[k] = __builtin_shufflevector(w00, w01, 0, 8, 1, 9, 2, 10, 3, 11);
            *(Vector*)(low[k] + LANES) = __builtin_shufflevector(w00, w01, 4, 12, 5, 13, 6, 14, 7, 15);
            *(Vector*)high[k] = __builtin_shufflevector(w10, w11, 0, 8, 1, 9, 2, 10, 3, 11);
            *(Vector*)(high[k] + LANES) = __builtin_shufflevector(w10, w11, 4, 12, 5, 13, 6, 14, 7, 15);
            *(Longs*)at[k] = __builtin_convertvector(iy, Longs) * columns + __builtin_convertvector(ix, Longs);
            if (step)
                for (int j = 0; j < ahead; ++j) at[k][j] += points.bin.data[i + j] * step;
        }
        const int done = i - LANES, n = end - done < LANES ? end - done : LANES;
        if (done < begin) continue;
        for (int j = 0; j < n; ++j) {
            Real* own = value.data + (size_t)(done + j) * channels;
            const Real* p = origin + at[k ^ 1][j];
            const Pair l = *(const Pair*)(low[k ^ 1] + 2 * j), h = *(const Pair*)(high[k ^ 1] + 2 * j);
            int c = 0;
#pragma clang loop unroll(disable)  // the pointers of two rounds do not fit into registers: that takes twice as long
            for (; c + 1 < channels; c += 2, p += 2 * channel_stride) {
                const Four sum =
                    pairs(p, p + channel_stride) * l.xyxy + pairs(p + columns, p + columns + channel_stride) * h.xyxy;
                *(Pair*)(own + c) = sum.even + sum.odd;
            }
            if (c < channels) own[c] = (l.x * p[0] + h.x * p[columns]) + (l.y * p[1] + h.y * p[columns + 1]);
        }
    }
};
each_stencil_but_linear(gather, gather_linear);
#endif
