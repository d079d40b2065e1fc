// Loops over numbers that threads of a team share, and sums whose bits do not depend on who takes what: a range is cut
// by its length alone. Stands behind prelude.h and team.h. Macros: LANES, SUMMED, MOST_SUMS.
#if defined(__CUDA_ARCH__)
auto take_range = [](auto, int i0, int i1, int, auto part) { part(i0, i1); };
#else
// What `part` does to the numbers i0 .. i1, `least` or more of them by one thread, whole vectors but at the end.
auto take_range = [=](wp::uint64 address, int i0, int i1, int least, auto part) {
    Team* const team = (Team*)address;
    if (!team) {
        part(i0, i1);
        return;
    }
    Phases phases;
    phases.first[0] = 0;
    phases.add((i1 - i0 + LANES - 1) / LANES, team->size, least / LANES);
    take_phases(team, phases, [=](int first, int last) {
        const int end = i0 + last * LANES;
        part(i0 + first * LANES, end < i1 ? end : i1);
        return 0.0;
    });
};
// Sum of what `part` gives for i0 .. i1, items of so many numbers each: what it gives can be added to.
auto sum_range = [=](wp::uint64 address, int i0, int i1, int numbers, auto part) {
    Team* const team = (Team*)address;
    const int even = (i1 - i0 + MOST_SUMS - 1) / MOST_SUMS, least = SUMMED / numbers;
    const int length = even > least ? (even + LANES - 1) / LANES * LANES : least;
    const int count = (i1 - i0 + length - 1) / length;
    if (count <= 1) return part(i0, i1);
    decltype(part(i0, i1)) sums[MOST_SUMS];
    auto* const to = sums;
    auto some = [=](int first, int last) {
        for (int k = first; k < last; ++k) {
            const int from = i0 + k * length;
            to[k] = part(from, i1 - from < length ? i1 : from + length);
        }
        return 0.0;
    };
    if (team) {
        Phases phases;
        phases.first[0] = 0;
        phases.add(count, team->size, 1);
        take_phases(team, phases, some);
    } else {
        some(0, count);
    }
    for (int k = 1; k < count; ++k) sums[0] += sums[k];
    return sums[0];
};
#endif
