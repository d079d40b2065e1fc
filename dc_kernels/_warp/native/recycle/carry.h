// Takes what is kept along where the near pairs of world w have been found anew: both lists are sorted by (A, B), a
// pair in both keeps what it has, and the others have nothing. Parameters: w, pairs.
#if !defined(__CUDA_ARCH__)
const int start = pairs.start.data[w], room = pairs.start.data[w + 1] - start;
const int before = pairs.kept_count.data[w], count = pairs.near_count.data[w];
const int old = 2 * start + pairs.kept_side.data[w] * room, now = 4 * start + room - old;
const int *const near_a = pairs.near_a.data + start, *const near_b = pairs.near_b.data + start;
int *const kept_a = pairs.kept_a.data, *const kept_b = pairs.kept_b.data;
int j = old;
const int end = old + before;
for (int i = 0; i < count; ++i) {
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
pairs.kept_side.data[w] ^= 1;
pairs.kept_count.data[w] = count;
pairs.kept_rebuilds.data[w] = pairs.rebuilds.data[w];
#endif
