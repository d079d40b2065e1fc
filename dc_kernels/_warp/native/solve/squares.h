// Sum of squares of x, numbers of a world's rows. Parameters: x, colors, first_color, team. Stands
// behind runtime/ranges.h.
const int i0 = colors.data[first_color] * 2 * LANES, i1 = colors.data[first_color + COLORS] * 2 * LANES;
#if defined(__CUDA_ARCH__)
Real sum = 0;
for (int i = i0; i < i1; ++i) sum += x.data[i] * x.data[i];
return sum;
#else
const Real* const numbers = x.data;
return total(
    sum_rows(team, colors.data + first_color, COLORS, 2 * LANES, 1, zero, [=](int first, int last, Vector sum) {
        for (int i = first; i < last; i += LANES) {
            const Vector d = load(numbers + i);
            sum += d * d;
        }
        return sum;
    }));
#endif
