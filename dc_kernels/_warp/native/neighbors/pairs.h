// Sweeps along each line and the ones ahead of it, and stores the pairs that are near. Macros: DIM, MAX_FOUND.
#if !defined(__CUDA_ARCH__)
Long out = 0;
const Long room = (Long)pair.shape[0] - LANES;
auto emit = [&](int own, Long j, unsigned bits) {
    const int more = __builtin_popcount(bits);
    if (out <= room) {
        int* to = pair.data + 2 * out;
#ifdef __AVX512F__
        const Integers other = pack(*(const Integers*)(cells.number.data + j), bits);
        const Integers mine = own;
        const Integers low = __builtin_elementwise_min(other, mine), high = __builtin_elementwise_max(other, mine);
        *(Integers*)to = __builtin_shufflevector(low, high, 0, 16, 1, 17, 2, 18, 3, 19, 4, 20, 5, 21, 6, 22, 7, 23);
        *(Integers*)(to + LANES) =
            __builtin_shufflevector(low, high, 8, 24, 9, 25, 10, 26, 11, 27, 12, 28, 13, 29, 14, 30, 15, 31);
#else
        for (unsigned b = bits; b; b &= b - 1) {
            const int other = cells.number.data[j + __builtin_ctz(b)];
            *to++ = other < own ? other : own;
            *to++ = other < own ? own : other;
        }
#endif
    }
    out += more;
};
const size_t stride = cells.place.shape[1];
for (int w = world_offset; w < world_offset + worlds; ++w) {
    const Long before = out;
    const Long* keys = cells.line_key.data + cells.start.data[w];
    const int* starts = cells.line_start.data + (size_t)cells.start.data[w] + w;
    const int lines = cells.line_count.data[w];
    const Long layer = cells.line_stride.data[w];
    const Long ahead[4] = {1, layer - 1, layer, layer + 1};
    int at[4] = {0, 0, 0, 0};
    for (int l = 0; l < lines && out <= MAX_FOUND; ++l) {
        const Long a0 = starts[l], a1 = starts[l + 1];
        auto sweep = [&](Long b0, Long b1, bool same) {
            for (Long i = a0; i < a1 && out <= MAX_FOUND; ++i) {
                Real own[DIM];
                for (int a = 0; a < DIM; ++a) own[a] = cells.place.data[a * stride + i];
                const int c = cells.column.data[i], mine = cells.number.data[i];
                Long j = i + 1;
                if (!same) j = b0 = skip(cells.column.data, b0, b1, c - 1);
                for (; j < b1 && cells.column.data[j] <= c + 1; j += LANES)
                    emit(mine, j, near(cells.place.data, stride, j, b1, own));
            }
        };
        sweep(a0, a1, true);
        for (int k = 0; k < (DIM == 3 ? 4 : 1); ++k) {
            while (at[k] < lines && keys[at[k]] < keys[l] + ahead[k]) ++at[k];
            if (at[k] < lines && keys[at[k]] == keys[l] + ahead[k]) sweep(starts[at[k]], starts[at[k] + 1], false);
        }
    }
    found.data[w - world_offset] = out - before;
}
#endif
