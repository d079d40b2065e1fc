// 1 where a row of b0 .. b1 without bounds, as joints are held by, lacked more than still of its speed as the last
// sweep came to it, else 0. Parameters: columns, change, b0, b1, still. Stands behind prelude.h.
#if defined(__CUDA_ARCH__)
return 0;  // a GPU looks row by row
#else
const Vector bounded = (Real)UNBOUNDED;
for (int b = b0; b < b1; ++b) {
    const Real* const block = columns.data + (size_t)b * COLUMNS * LANES;
    const Vector dn = magnitude(load(change.data + (size_t)b * 2 * LANES));
    // NaN is lacking
    const auto lacks = ~(dn <= still * load(block + AT_en));
    const auto holds = (load(block + AT_lo) < -bounded) & (load(block + AT_hi) > bounded);
    const auto found = lacks & holds;
    int any = 0;
    for (int lane = 0; lane < LANES; ++lane) any |= (int)found[lane];
    if (any) return 1;
}
return 0;
#endif
