// Of the pairs that are kept those whose boxes, swept over the step, overlap: candidates, a function of the state
// alone. Parameters: w, pairs, team. Stands behind runtime/ranges.h.
const int start = pairs.start.data[w], end = start + pairs.near_count.data[w];
const int *const near_a = pairs.near_a.data, *const near_b = pairs.near_b.data;
int *const shape_a = pairs.shape_a.data, *const shape_b = pairs.shape_b.data;
int* const near_of = pairs.temp_b.data;
const auto* const swept = pairs.swept.data;
// Those of the pairs from .. to, from that place on, up to behind the last.
auto scan = [=](int from, int to) {
    int n = from;
    for (int i = from; i < to; ++i) {
        const int a = near_a[i], b = near_b[i];
        shape_a[n] = a;
        shape_b[n] = b;
        near_of[n] = i;
        n += below(key(load(swept + a)), bound(load(swept + b)));
    }
    return n;
};
#if !defined(__CUDA_ARCH__)
Team* const members = (Team*)team;
const int few = 4096;  // pairs of a part: 8 us
if (end - start >= 2 * few && is_helped(members)) {
    // each thread puts its own to where they begin, and then behind those of the threads before it
    const int parts = members->size;
    int place[SEATS + 1], found[SEATS];
    auto *const to = place, *const behind = found;
    auto begin_of = [=](int p) { return Share::begin(members, start, end, p, parts); };
    Phases scans, moves;
    scans.first[0] = moves.first[0] = 0;
    scans.add(parts, parts, 1);
    take_phases(members, scans, [=](int first, int last) {
        for (int p = first; p < last; ++p) behind[p] = scan(begin_of(p), begin_of(p + 1));
        return 0.0;
    });
    place[0] = start;
    for (int p = 0; p < parts; ++p) place[p + 1] = place[p] + found[p] - begin_of(p);
    for (int k = 1; k < parts; ++k) moves.add(k * parts, parts, 1);
    take_phases(members, moves, [=](int first, int last) {
        for (int i = first; i < last; ++i) {
            const int p = i % parts;
            if (p != i / parts + 1)
                continue;  // one part after the other, as each may move onto where the one before was
            int* const lists[] = {shape_a, shape_b, near_of};
            for (int* const list : lists)
                __builtin_memmove(list + to[p], list + begin_of(p), (behind[p] - begin_of(p)) * sizeof(int));
        }
        return 0.0;
    });
    pairs.count.data[w] = place[parts] - start;
    return;
}
#endif
pairs.count.data[w] = scan(start, end) - start;
