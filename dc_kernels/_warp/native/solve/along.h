// Scalar product of a change with the move before it, change . (x - before).
// Parameters: change, x, before, at, colors, first_color, team. Stands behind runtime/ranges.h.
const int i0 = colors.data[first_color] * 2 * LANES, i1 = colors.data[first_color + COLORS] * 2 * LANES;
#if defined(__CUDA_ARCH__)
Real sum = 0;
for (int i = i0; i < i1; ++i) sum += change.data[i] * (x.data[i] - before.data[at + (i - i0)]);
return sum;
#else
const Real *const step = change.data, *const now = x.data, *const past = before.data + at - i0;
return total(
    sum_rows(team, colors.data + first_color, COLORS, 2 * LANES, 1, zero, [=](int first, int last, Vector sum) {
        for (int i = first; i < last; i += LANES) sum += load(step + i) * (load(now + i) - load(past + i));
        return sum;
    }));
#endif
