// Scalar product of a change with the move before it, change . (x - before).
// Parameters: change, x, before, at, i0, i1, team. Stands behind runtime/ranges.h.
#if defined(__CUDA_ARCH__)
Real sum = 0;
for (int i = i0; i < i1; ++i) sum += change.data[i] * (x.data[i] - before.data[at + (i - i0)]);
return sum;
#else
const Real *const step = change.data, *const now = x.data, *const past = before.data + at - i0;
return total(sum_range(team, i0, i1, 1, [=](int first, int last) {
    Vector sum = zero;
    for (int i = first; i < last; i += LANES) sum += load(step + i) * (load(now + i) - load(past + i));
    return sum;
}));
#endif
