// Start impulses of the contacts i0 .. i1 into the rows of the blocks b0 .. b1, zero in all others, and in those along
// which nothing can move: no sweep would change it.
// Parameters: columns, slot, start, impulse, b0, b1, i0, i1. Macros: LANES, COLUMNS, AT_en, AT_et.
Real* const x = impulse.data;
for (int i = i0; i < i1; ++i) {
    const auto given = start.data[i];
    x[slot.data[i]] = given[0];
    x[slot.data[i] + LANES] = given[1];
}
// empty lanes have no mass
for (int b = b0; b < b1; ++b) {
    const Real* const block = columns.data + (size_t)b * COLUMNS * LANES;
    Real* const to = x + (size_t)b * 2 * LANES;
#if defined(__CUDA_ARCH__)
    for (int i = 0; i < LANES; ++i) {
        if (!(block[AT_en + i] > 0)) to[i] = 0;
        if (!(block[AT_et + i] > 0)) to[LANES + i] = 0;
    }
#else
    store(to, load(block + AT_en) > (Real)0 ? load(to) : zero);
    store(to + LANES, load(block + AT_et) > (Real)0 ? load(to + LANES) : zero);
#endif
}
