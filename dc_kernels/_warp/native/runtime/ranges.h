// Loops over numbers that threads of a team share, and sums whose bits do not depend on who takes what: a range is cut
// by its length alone. Stands behind prelude.h and team.h. Macros: LANES, COLORS, SUMMED, MOST_SUMS.
#if defined(__CUDA_ARCH__)
auto take_range = [](auto, int i0, int i1, int, auto part) { part(i0, i1); };
auto add_range = [](auto, int i0, int i1, int, auto part) { return part(i0, i1); };
auto sum_rows = [](auto, const int* ends, int colors, int per_block, int, auto none, auto part) {
    return part(ends[0] * per_block, ends[colors] * per_block, none);
};
auto take_rows = [](auto, const int* ends, auto part) { part(ends[0] * 2 * LANES, ends[COLORS] * 2 * LANES); };
#else
// What `part` does to the numbers i0 .. i1, `least` or more of them by one thread, whole vectors but at the end.
auto take_range = [=](wp::uint64 address, int i0, int i1, int least, auto part) {
    Team* const team = (Team*)address;
    if (!team) {
        part(i0, i1);
        return;
    }
    auto share = [=]() __attribute__((noinline)) {
        Phases phases;
        phases.first[0] = 0;
        phases.add((i1 - i0 + LANES - 1) / LANES, team->size, least / LANES);
        take_phases(team, phases, [=](int first, int last) {
            const int end = i0 + last * LANES;
            part(i0 + first * LANES, end < i1 ? end : i1);
            return 0.0;
        });
    };
    share();
};
// Sum of what `part` gives for shares of i0 .. i1, one a thread, of `least` items or more: its order must not matter.
auto add_range = [=](wp::uint64 address, int i0, int i1, int least, auto part) {
    Team* const team = (Team*)address;
    if (i1 - i0 < 2 * least || !is_helped(team)) return part(i0, i1);
    auto share = [=]() __attribute__((noinline)) {
        const int size = team->size;
        decltype(part(i0, i1)) sums[SEATS];
        auto* const to = sums;
        Phases phases;
        phases.first[0] = 0;
        phases.add(size, size, 1);
        take_phases(team, phases, [=](int first, int last) {
            for (int p = first; p < last; ++p)
                to[p] = part(Share::begin(team, i0, i1, p, size), Share::begin(team, i0, i1, p + 1, size));
            return 0.0;
        });
        for (int p = 1; p < size; ++p) sums[0] += sums[p];
        return sums[0];
    };
    return share();
};
// Sum of what `part` counts of the blocks of a world's rows, given where its colours end: a thread takes that share of
// each colour which it sweeps, and has in its caches.
auto count_blocks = [=](wp::uint64 address, const int* ends, auto part) -> long long {
    Team* const team = (Team*)address;
    const int few = 128;  // blocks: 1 us
    if (ends[COLORS] - ends[0] < few || !is_helped(team)) return part(ends[0], ends[COLORS]);
    // compiled once, not wherever the function is called
    auto share = [=]() __attribute__((noinline)) {
        const int size = team->size;
        long long counts[SEATS];
        auto* const to = counts;
        Phases phases;
        phases.first[0] = 0;
        phases.add(size, size, 1);
        take_phases(team, phases, [=](int first, int last) {
            for (int p = first; p < last; ++p) {
                long long count = 0;
                for (int k = 0; k < COLORS; ++k) {
                    if (ends[k] == ends[k + 1]) continue;
                    const Share share(team, ends[k], ends[k + 1] - ends[k], team->split[k], p, size);
                    for (int i = 0; i < 2; ++i)
                        if (share.first[i] < share.last[i]) count += part(share.first[i], share.last[i]);
                }
                to[p] = count;
            }
            return 0.0;
        });
        for (int p = 1; p < size; ++p) counts[0] += counts[p];
        return counts[0];
    };
    return share();
};
// What `part` does to the numbers of a world's rows, two of each lane, shared in this way. It is compiled once, and not
// wherever it is called: what calls it is only inlined itself, without copies of its groups, as long as it is short.
auto take_rows = [=](wp::uint64 address, const int* ends, auto part) {
    auto take = [=]() __attribute__((noinline)) {
        count_blocks(address, ends, [=](int first, int last) {
            part(first * 2 * LANES, last * 2 * LANES);
            return 0;
        });
    };
    take();
};
// How a range is cut into pieces whose sums are added in order: by its length alone, so that the bits do not depend on
// who sums up. Items hold so many numbers each.
struct Pieces {
    int i0, i1, length, count;
    Pieces(int from, int to, int numbers) : i0(from), i1(to) {
        const int even = (i1 - i0 + MOST_SUMS - 1) / MOST_SUMS, least = SUMMED / numbers;
        length = even > least ? (even + LANES - 1) / LANES * LANES : least;
        count = (i1 - i0 + length - 1) / length;
    }
    int begin(int k) const { return i0 + k * length; }
    int end(int k) const { return k + 1 < count ? i0 + (k + 1) * length : i1; }
};
// Sum of what `part` gives for i0 .. i1: what it gives can be added to.
auto sum_range = [=](wp::uint64 address, int i0, int i1, int numbers, auto part) {
    Team* const team = (Team*)address;
    const Pieces pieces(i0, i1, numbers);
    if (pieces.count <= 1) return part(i0, i1);
    auto share = [=]() __attribute__((noinline)) {
        decltype(part(i0, i1)) sums[MOST_SUMS];
        auto* const to = sums;
        auto some = [=](int first, int last) {
            for (int k = first; k < last; ++k) to[k] = part(pieces.begin(k), pieces.end(k));
            return 0.0;
        };
        if (team) {
            Phases phases;
            phases.first[0] = 0;
            phases.add(pieces.count, team->size, 1);
            take_phases(team, phases, some);
        } else {
            some(0, pieces.count);
        }
        for (int k = 1; k < pieces.count; ++k) sums[0] += sums[k];
        return sums[0];
    };
    return share();
};
// Sum over the rows of a world's first colours, so many items a block, of what `part` makes of a sum and some items
// behind those in it, from `none` on. A piece reaches across the shares of several threads, each of which takes what it
// sweeps, and has in its caches: one goes on where another ended, in turns. What another core has written comes from
// there at 5 to 20 ns a line, and would have to go back with the next sweep.
auto sum_rows = [=](wp::uint64 address, const int* ends, int colors, int per_block, int numbers, auto none, auto part) {
    auto sum_up = [=]() __attribute__((noinline)) {
        const int i0 = ends[0] * per_block, i1 = ends[colors] * per_block;
        if ((long long)(i1 - i0) * numbers <= SUMMED) return part(i0, i1, none);  // one piece, without its divisions
        const Pieces pieces(i0, i1, numbers);
        if (pieces.count <= 1) return part(i0, i1, none);
        auto share = [=]() __attribute__((noinline)) {
            Team* const team = (Team*)address;
            decltype(none) sums[MOST_SUMS];
            auto* const to = sums;
            const Plan* const made = is_helped(team) ? team->plan(team, ends, colors, per_block, pieces.length) : 0;
            if (made && made->count > 0) {
                const int size = team->size;
                Phases phases;
                phases.first[0] = 0;
                for (int k = 0; k < made->turns; ++k) phases.add((k + 1) * size, size, 1);
                take_phases(team, phases, [=](int first, int last) {
                    for (int i = first; i < last; ++i)
                        for (int k = 0; k < made->count; ++k) {
                            const Plan::Segment& one = made->segment[k];
                            if (one.owner != i % size || one.turn != i / size) continue;
                            const bool begins = one.first == pieces.begin(one.piece);
                            to[one.piece] = part(one.first, one.last, begins ? none : to[one.piece]);
                        }
                    return 0.0;
                });
            } else {
                for (int k = 0; k < pieces.count; ++k) sums[k] = part(pieces.begin(k), pieces.end(k), none);
            }
            for (int k = 1; k < pieces.count; ++k) sums[0] += sums[k];
            return sums[0];
        };
        return share();
    };
    return sum_up();
};
#endif
