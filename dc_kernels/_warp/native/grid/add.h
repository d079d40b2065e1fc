// Adds the points to rows row_low .. row_high - 1 of `base`, whose first column is `left`. `lost`: how many reach no
// node, of those whose nearest node lies in these rows and columns column_low .. column_high - 1.
#if !defined(__CUDA_ARCH__)
int lost = 0;
auto home = [&](Real px, Real py) {
    const bool valid = is_finite(px, py);
    const int c = valid ? nearest_node(px, columns) : 0, r = valid ? nearest_node(py, rows) : 0;
    return r >= row_low && r < row_high && c >= column_low && c < column_high;
};
auto add = [&](auto prepare, auto place, auto first_weight, auto weight, auto gradient, Real constant, bool separable) {
    each_point(prepare, [&](int j, int i) {
        const Real px = xs[j], py = ys[j];
        const bool out = separable && outside(px, py);
        const Real* own = value.data + (size_t)i * channels;
        Real* to = base + (size_t)(channel_offset + (bins > 1 ? points.bin.data[i] * channels : 0)) * channel_stride;
        if (place(j)) {
            const int from = r0 < row_low ? row_low : r0, until = r1 < row_high ? r1 : row_high - 1;
            if (one) {
                Vector kept[WINDOW_ROWS], sum = zero;
                for (int r = r0; r <= r1; ++r) {
                    kept[r - r0] = first_weight(r);
                    sum += kept[r - r0];
                }
                const Real t = separable ? 1 : fold(sum);
                if (t > tiny) {
                    const Real factor = constant == 0 ? 1 / t : constant;
                    Real* row = to + (size_t)(from - row_low) * row_stride + (first - left);
                    if (channels == 4) {
                        const Vector a0 = own[0] * factor, a1 = own[1] * factor;
                        const Vector a2 = own[2] * factor, a3 = own[3] * factor;
                        for (int r = from; r <= until; ++r, row += row_stride) {
                            const Vector w = kept[r - r0];
                            Real *p0 = row, *p1 = row + channel_stride;
                            Real *p2 = p1 + channel_stride, *p3 = p2 + channel_stride;
                            *(Vector*)p0 += w * a0;
                            *(Vector*)p1 += w * a1;
                            *(Vector*)p2 += w * a2;
                            *(Vector*)p3 += w * a3;
                        }
                    } else {
                        for (int c = 0; c < channels; ++c) {
                            const Vector scaled = own[c] * factor;
                            Real* p = row + c * channel_stride;
                            for (int r = from; r <= until; ++r, p += row_stride) *(Vector*)p += kept[r - r0] * scaled;
                        }
                    }
                    mark(r0, r1);
                    if (out) lost += home(px, py);
                    return;
                }
            } else {
                Vector sum = zero;
                if (!separable)
                    for (int r = r0; r <= r1; ++r)
                        for (int v = 0; v < vectors; ++v) sum += weight(r, v);
                const Real t = separable ? 1 : fold(sum);
                if (t > tiny) {
                    const Real factor = constant == 0 ? 1 / t : constant;
                    for (int r = from; r <= until; ++r)
                        for (int v = 0; v < vectors; ++v) {
                            const Vector w = weight(r, v);
                            Real* p = to + (size_t)(r - row_low) * row_stride + (first - left) + v * LANES;
                            for (int c = 0; c < channels; ++c, p += channel_stride)
                                store_columns(p, v, load_columns(p, v) + w * (own[c] * factor));
                        }
                    mark(r0, r1);
                    if (out) lost += home(px, py);
                    return;
                }
            }
        }
        if (!home(px, py)) return;
        ++lost;
        if (is_finite(px, py) && stencil.nearest && stencil.normalize) {
            const int r = nearest_node(py, rows);
            Real* p = to + (size_t)(r - row_low) * row_stride + (nearest_node(px, columns) - left);
            for (int c = 0; c < channels; ++c, p += channel_stride) *p += own[c];
            mark(r, r);
        }
    });
};
#endif
