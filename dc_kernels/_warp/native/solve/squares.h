// Sum of squares of x[i0 .. i1]. Parameters: x, i0, i1, team. Stands behind runtime/ranges.h.
#if defined(__CUDA_ARCH__)
Real sum = 0;
for (int i = i0; i < i1; ++i) sum += x.data[i] * x.data[i];
return sum;
#else
const Real* const numbers = x.data;
return total(sum_range(team, i0, i1, 1, [=](int first, int last) {
    Vector sum = zero;
    for (int i = first; i < last; i += LANES) {
        const Vector d = load(numbers + i);
        sum += d * d;
    }
    return sum;
}));
#endif
