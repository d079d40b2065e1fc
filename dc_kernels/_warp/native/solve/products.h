// The scalar products that Anderson's least squares needs, of differences to the remembered iterates and steps: f1 f1,
// f1 f2, f2 f2, f1 d, f2 d, e1 e1, e1 e2, e2 e2, with d the step, f of steps, e of iterates.
// Parameters: x, change, history, at, i0, i1, kept.
const int stride = i1 - i0;
#if defined(__CUDA_ARCH__)
typedef Real Number;
const int PART = 1;
auto read = [&](const Real* p) { return *p; };
auto sum_of = [&](Real v) { return v; };
#else
typedef Vector Number;
const int PART = LANES;
auto read = [&](const Real* p) { return *(const Vector*)p; };
auto sum_of = [&](Vector v) { return ((v[0] + v[1]) + (v[2] + v[3])) + ((v[4] + v[5]) + (v[6] + v[7])); };
#endif
Number s[8];
for (int k = 0; k < 8; ++k) s[k] = (Real)0;
for (int i = i0; i < i1; i += PART) {
    const Real* const past = history.data + at + (i - i0);
    const Number d = read(change.data + i), v = read(x.data + i);
    const Number e1 = v - read(past), f1 = d - read(past + stride);
    Number e2 = v - read(past + 2 * stride), f2 = d - read(past + 3 * stride);
    if (kept < 2) {
        e2 = (Real)0;
        f2 = (Real)0;
    }
    s[0] += f1 * f1;
    s[1] += f1 * f2;
    s[2] += f2 * f2;
    s[3] += f1 * d;
    s[4] += f2 * d;
    s[5] += e1 * e1;
    s[6] += e1 * e2;
    s[7] += e2 * e2;
}
wp::vec_t<8, Real> sums;
for (int k = 0; k < 8; ++k) sums[k] = sum_of(s[k]);
return sums;
