// Rows of b0 .. b1 without bounds, as joints are held by, that lacked more than still of their speed as the last sweep
// came to them, counted until there are enough. Parameters: columns, change, b0, b1, still, enough. Stands behind
// prelude.h.
#if defined(__CUDA_ARCH__)
return 0;  // a GPU looks row by row
#else
const Vector bounded = (Real)UNBOUNDED;
int count = 0;
for (int b = b0; b < b1; ++b) {
    const Real* const block = columns.data + (size_t)b * COLUMNS * LANES;
    const Vector dn = magnitude(load(change.data + (size_t)b * 2 * LANES));
    // NaN is lacking
    const auto lacks = ~(dn <= still * load(block + AT_en));
    const auto holds = (load(block + AT_lo) < -bounded) & (load(block + AT_hi) > bounded);
    const auto found = lacks & holds;
    for (int lane = 0; lane < LANES; ++lane) count -= (int)found[lane];  // a true lane is -1
    if (count >= enough) break;
}
return count;
#endif
