// Sweeps along each line of queries and the lines of points around it. Macros: DIM, MAX_FOUND.
#if !defined(__CUDA_ARCH__)
Long out = 0;
const Long room = (Long)entry.shape[0] - LANES;
const int BEHIND = DIM == 3 ? 9 : 3;
const size_t stride = cells.place.shape[1], query_stride = queries.place.shape[1];
for (int w = world_offset; w < world_offset + worlds; ++w) {
    const Long before = out;
    const Long* query_keys = queries.line_key.data + queries.start.data[w];
    const int* query_starts = queries.line_start.data + (size_t)queries.start.data[w] + w;
    const Long* keys = cells.line_key.data + cells.start.data[w];
    const int* starts = cells.line_start.data + (size_t)cells.start.data[w] + w;
    const int lines = cells.line_count.data[w];
    int at[BEHIND];
    Long away[BEHIND];
    for (int k = 0; k < BEHIND; ++k) {
        at[k] = 0;
        away[k] = k % 3 - 1 + (k / 3 - BEHIND / 6) * cells.line_stride.data[w];
    }
    for (int l = 0; l < queries.line_count.data[w]; ++l) {
        Long from[BEHIND], last[BEHIND];
        int near_lines = 0;
        for (int k = 0; k < BEHIND; ++k) {
            const Long wanted = query_keys[l] + away[k];
            while (at[k] < lines && keys[at[k]] < wanted) ++at[k];
            if (at[k] < lines && keys[at[k]] == wanted) {
                from[near_lines] = starts[at[k]];
                last[near_lines++] = starts[at[k] + 1];
            }
        }
        for (Long i = query_starts[l]; i < query_starts[l + 1] && out <= MAX_FOUND; ++i) {
            Real own[DIM];
            for (int a = 0; a < DIM; ++a) own[a] = queries.place.data[a * query_stride + i];
            const int c = queries.column.data[i], mine = queries.number.data[i];
            const Long begin = out;
            __builtin_prefetch(list_span.data + 2 * (size_t)queries.number.data[i + LANES], 1);
            for (int k = 0; k < near_lines; ++k) {
                from[k] = skip(cells.column.data, from[k], last[k], c - 1);
                for (Long j = from[k]; j < last[k] && cells.column.data[j] <= c + 1; j += LANES) {
                    const unsigned bits = near(cells.place.data, stride, j, last[k], own);
                    if (out <= room) {
                        int* to = entry.data + out;
#ifdef __AVX512F__
                        *(Integers*)to = pack(*(const Integers*)(cells.number.data + j), bits);
#else
                        for (unsigned b = bits; b; b &= b - 1) *to++ = cells.number.data[j + __builtin_ctz(b)];
#endif
                    }
                    out += __builtin_popcount(bits);
                }
            }
            list_span.data[2 * (size_t)mine] = begin;
            list_span.data[2 * (size_t)mine + 1] = out - begin;
        }
    }
    found.data[w - world_offset] = out - before;
}
#endif
