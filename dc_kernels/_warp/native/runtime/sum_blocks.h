// Sum of what `part` adds to a sum for the blocks of a world's colours but the serial one. Stands behind ranges.h and
// `part`. Parameters: colors, at (of the world's first colour), team. Macros: REAL, SERIAL.
#if defined(__CUDA_ARCH__)
return 0;  // a GPU sums row by row
#else
return sum_rows(team, colors.data + at, SERIAL, 1, 2 * LANES, (REAL)0, part);
#endif
