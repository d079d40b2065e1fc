// The scalar products that Anderson's least squares needs, of differences to the remembered iterates and steps: f1 f1,
// f1 f2, f2 f2, f1 d, f2 d, e1 e1, e1 e2, e2 e2, with d the step, f of steps, e of iterates.
// Parameters: x, change, history, at, kept, colors, first_color, team. Stands behind runtime/ranges.h.
const int i0 = colors.data[first_color] * 2 * LANES, i1 = colors.data[first_color + COLORS] * 2 * LANES;
const int stride = i1 - i0;
const Real *const now = x.data, *const step = change.data, *const before = history.data + at - i0;
#if defined(__CUDA_ARCH__)
typedef Real Number;
const int PART = 1;
#else
typedef Vector Number;
const int PART = LANES;
#endif
struct Sums {
    Number of[8];
    void operator+=(const Sums& other) {
        for (int k = 0; k < 8; ++k) of[k] += other.of[k];
    }
};
Sums none;
for (int k = 0; k < 8; ++k) none.of[k] = (Real)0;
auto part = [=](int first, int last, Sums sums) {
    for (int i = first; i < last; i += PART) {
        auto read = [](const Real* p) { return *(const Number*)p; };
        const Real* const past = before + i;
        const Number d = read(step + i), v = read(now + i);
        const Number e1 = v - read(past), f1 = d - read(past + stride);
        Number e2 = v - read(past + 2 * stride), f2 = d - read(past + 3 * stride);
        if (kept < 2) {
            e2 = (Real)0;
            f2 = (Real)0;
        }
        sums.of[0] += f1 * f1;
        sums.of[1] += f1 * f2;
        sums.of[2] += f2 * f2;
        sums.of[3] += f1 * d;
        sums.of[4] += f2 * d;
        sums.of[5] += e1 * e1;
        sums.of[6] += e1 * e2;
        sums.of[7] += e2 * e2;
    }
    return sums;
};
wp::vec_t<8, Real> found;
#if defined(__CUDA_ARCH__)
const Sums sums = part(i0, i1, none);
for (int k = 0; k < 8; ++k) found[k] = sums.of[k];
#else
const Sums sums = sum_rows(team, colors.data + first_color, COLORS, 2 * LANES, 1, none, part);
for (int k = 0; k < 8; ++k) found[k] = total(sums.of[k]);
#endif
return found;
