// Start impulses of the contacts i0 .. i1 into the rows of the blocks b0 .. b1, zero in all others, and in those along
// which nothing can move: no sweep would change it. Parameters: columns, slot, start, impulse, b0, b1, i0, i1, team.
// Macros: LANES, COLUMNS, AT_en, AT_et. Stands behind prelude.h and runtime/ranges.h.
const Real* const column = columns.data;
const int* const at = slot.data;
const auto* const given = start.data;
Real* const x = impulse.data;
take_range(team, i0, i1, 2048, [=](int first, int last) {
    for (int i = first; i < last; ++i) {
        const auto both = given[i];
        x[at[i]] = both[0];
        x[at[i] + LANES] = both[1];
    }
});
#if !defined(__CUDA_ARCH__)
// Most blocks need nothing, or zeros; a masked store, which the others take, is slow on some processors (Zen 3: 15
// cycles).
auto keep_moving = [](Vector mass, Real* to) {
    const Vector none = (Real)0;
    const auto moves = mass > none;
    if (__builtin_reduce_and(moves)) return;
    if (__builtin_reduce_or(moves))
        *(Vector*)to = moves ? *(const Vector*)to : none;
    else
        *(Vector*)to = none;
};
#endif
// empty lanes have no mass
take_range(team, b0, b1, 256, [=](int first, int last) {
    for (int b = first; b < last; ++b) {
        const Real* const block = column + (size_t)b * COLUMNS * LANES;
        Real* const to = x + (size_t)b * 2 * LANES;
#if defined(__CUDA_ARCH__)
        for (int i = 0; i < LANES; ++i) {
            if (!(block[AT_en + i] > 0)) to[i] = 0;
            if (!(block[AT_et + i] > 0)) to[LANES + i] = 0;
        }
#else
        keep_moving(load(block + AT_en), to);
        keep_moving(load(block + AT_et), to + LANES);
#endif
    }
});
