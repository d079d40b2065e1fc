// Copies the lists into the order of the queries and sorts each. Macro: LANES.
#if !defined(__CUDA_ARCH__)
const int AHEAD = 16;
for (int q = query_offset; q < query_offset + queries; ++q) {
    const Long m = list_start.data[q + 1] - list_start.data[q];
    // the lists lie in the order of the sorted queries: each is fetched from anywhere
    if (q + AHEAD < query_offset + queries) __builtin_prefetch(entry.data + list_span.data[2 * (size_t)(q + AHEAD)]);
    const int* from = entry.data + list_span.data[2 * (size_t)q];
    int* to = index.data + list_start.data[q];
    if (m <= 4 * LANES) {
        // a number's place is how many are less; all differ
        Integers block[4];
        Integers lane;
        for (int l = 0; l < LANES; ++l) lane[l] = l;
        const int blocks = (int)((m + LANES - 1) / LANES);
        for (int b = 0; b < blocks; ++b) {
            const Integers all = *(const Integers*)(from + LANES * b), none = 0x7fffffff;
            block[b] = lane + LANES * b < (int)m ? all : none;
        }
        for (int i = 0; i < m; ++i) {
            int rank = 0;
            for (int b = 0; b < blocks; ++b)
                rank += __builtin_popcount(
                    __builtin_bit_cast(unsigned short, __builtin_convertvector(block[b] < from[i], Booleans)));
            to[rank] = from[i];
        }
        continue;
    }
    for (Long i = 0; i < m; ++i) to[i] = from[i];
    // heap sort: the greatest of the first `size` moves to their end
    auto sift = [&](Long root, Long size) {
        const int moved = to[root];
        for (Long child; (child = 2 * root + 1) < size; root = child) {
            if (child + 1 < size && to[child + 1] > to[child]) ++child;
            if (to[child] <= moved) break;
            to[root] = to[child];
        }
        to[root] = moved;
    };
    for (Long i = m / 2; i-- > 0;) sift(i, m);
    for (Long size = m - 1; size > 0; --size) {
        const int greatest = to[0];
        to[0] = to[size];
        to[size] = greatest;
        sift(0, size);
    }
}
#endif
