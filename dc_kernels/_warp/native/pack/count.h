// Contacts of each colour of the contacts i0 .. i1 added to `fill`, from `at` on. Two counts at a time, as neighbours
// often have one colour and would wait for each other. Parameters: color, fill, at, i0, i1. Macros: COLORS.
int* const of = fill.data + at;
int i = i0;
#if !defined(__CUDA_ARCH__)
int other[COLORS] = {};
for (; i + 1 < i1; i += 2) {
    ++of[color.data[i]];
    ++other[color.data[i + 1]];
}
for (int k = 0; k < COLORS; ++k) of[k] += other[k];
#endif
for (; i < i1; ++i) ++of[color.data[i]];
