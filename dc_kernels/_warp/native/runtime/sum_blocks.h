// Sum of what `part` gives for the blocks b0 .. b1. Stands behind ranges.h and `part`. Parameters: b0, b1, team.
#if defined(__CUDA_ARCH__)
return part(b0, b1);
#else
return sum_range(team, b0, b1, 2 * LANES, part);
#endif
