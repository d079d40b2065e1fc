// Sum of what `part` counts of the blocks of a world's rows, up to ASTRAY, which stands for more than there are. Stands
// behind ranges.h and `part`. Parameters: span, colors, at.
#if defined(__CUDA_ARCH__)
return 0;  // a GPU counts row by row
#else
const long long count = count_blocks(span.team, colors.data + at, part);
return count < ASTRAY ? (int)count : ASTRAY;
#endif
