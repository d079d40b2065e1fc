// Takes what is kept along where the near pairs of world w have been found anew: both lists are sorted by (A, B), a
// pair in both keeps what it has, and the others have nothing. Runs of pairs that are in both, as most are where few
// bodies have left their boxes, are found and copied LANES at a time. Parameters: w, pairs.
#if !defined(__CUDA_ARCH__)
const int start = pairs.start.data[w], room = pairs.start.data[w + 1] - start;
const int before = pairs.kept_count.data[w], count = pairs.near_count.data[w];
const int old = 2 * start + pairs.kept_side.data[w] * room, now = 4 * start + room - old;
const int *const near_a = pairs.near_a.data + start, *const near_b = pairs.near_b.data + start;
int *const kept_a = pairs.kept_a.data, *const kept_b = pairs.kept_b.data;
int j = old;
const int end = old + before;
for (int i = 0; i < count;) {
    const int most = count - i < end - j ? count - i : end - j;
    int run = 0;
    for (; run + LANES <= most; run += LANES) {
        int other = 0;
        for (int k = run; k < run + LANES; ++k)
            other |= (near_a[i + k] ^ kept_a[j + k]) | (near_b[i + k] ^ kept_b[j + k]);
        if (other != 0) break;
    }
    if (run > 0) {
        __builtin_memcpy(kept_a + now + i, kept_a + j, run * sizeof(*kept_a));
        __builtin_memcpy(kept_b + now + i, kept_b + j, run * sizeof(*kept_b));
        __builtin_memcpy(pairs.kept_edges.data + now + i, pairs.kept_edges.data + j,
                         run * sizeof(*pairs.kept_edges.data));
        __builtin_memcpy(pairs.kept_frame.data + now + i, pairs.kept_frame.data + j,
                         run * sizeof(*pairs.kept_frame.data));
        __builtin_memcpy(pairs.kept_bound.data + now + i, pairs.kept_bound.data + j,
                         run * sizeof(*pairs.kept_bound.data));
        i += run;
        j += run;
        continue;
    }
    for (const int stop = i + LANES < count ? i + LANES : count; i < stop; ++i) {
        const int a = near_a[i], b = near_b[i], to = now + i;
        while (j < end && (kept_a[j] < a || (kept_a[j] == a && kept_b[j] < b))) ++j;
        kept_a[to] = a;
        kept_b[to] = b;
        if (j < end && kept_a[j] == a && kept_b[j] == b) {
            pairs.kept_edges.data[to] = pairs.kept_edges.data[j];
            pairs.kept_frame.data[to] = pairs.kept_frame.data[j];
            pairs.kept_bound.data[to] = pairs.kept_bound.data[j];
        } else {
            pairs.kept_bound.data[to][1] = -1;
        }
    }
    while (i < count && j < end && (kept_a[j] < near_a[i] || (kept_a[j] == near_a[i] && kept_b[j] < near_b[i]))) ++j;
}
pairs.kept_side.data[w] ^= 1;
pairs.kept_count.data[w] = count;
pairs.kept_rebuilds.data[w] = pairs.rebuilds.data[w];
#endif
