// By how much the impulses of the step have changed the velocities of the bodies b0 .. b1 beyond fall, in the mean over
// the mass of those that they have changed; of a velocity the larger change along x and y counts.
// Parameters: bodies, predicted, b0, b1, fall, team. Stands behind runtime/ranges.h.
const Real *const now = (const Real*)bodies.data, *const then = (const Real*)predicted.data;
#if defined(__CUDA_ARCH__)
Real push = 0, mass = 0;
for (int i = 4 * b0; i < 4 * b1; i += 4) {
    const Real x = fabs(now[i] - then[i]), y = fabs(now[i + 1] - then[i + 1]);
    const Real given = x > y ? x : y;
    if (!(given > 0)) continue;
    mass += 1 / now[i + 3];
    if (given > fall) push += 1 / now[i + 3] * (given - fall);
}
#else
struct Sums {
    Vector push, mass;
    Sums& operator+=(const Sums& other) {
        push += other.push;
        mass += other.mass;
        return *this;
    }
};
const Sums sums = sum_range(team, b0, b1, 4, [=](int first, int last) {
    Sums part = {zero, zero};
    const auto add = [&](Vector given, Vector inverse) {
        const Vector mass = given > zero ? 1 / inverse : zero;
        part.push += mass * __builtin_elementwise_max(given - fall, zero);
        part.mass += mass;
    };
    // of two bodies, x, y, spin and inverse mass each: what is given to them stands in 0 and 4
    const auto given = [=](int b) {
        const Vector change = *(const Vector*)(now + 4 * b) - *(const Vector*)(then + 4 * b);
        const Vector size = __builtin_elementwise_abs(change);
        return __builtin_elementwise_max(size, __builtin_shufflevector(size, size, 1, 0, 3, 2, 5, 4, 7, 6));
    };
    const auto both = [=](int b) { return *(const Vector*)(now + 4 * b); };
    int b = first;
    for (; b + LANES <= last; b += LANES) {
        const Vector p = given(b), q = given(b + 2), r = given(b + 4), s = given(b + 6);
        const Vector low = __builtin_shufflevector(p, q, 0, 4, 8, 12, 0, 4, 8, 12);
        const Vector high = __builtin_shufflevector(r, s, 0, 4, 8, 12, 0, 4, 8, 12);
        const Vector lower = __builtin_shufflevector(both(b), both(b + 2), 3, 7, 11, 15, 3, 7, 11, 15);
        const Vector upper = __builtin_shufflevector(both(b + 4), both(b + 6), 3, 7, 11, 15, 3, 7, 11, 15);
        add(__builtin_shufflevector(low, high, 0, 1, 2, 3, 8, 9, 10, 11),
            __builtin_shufflevector(lower, upper, 0, 1, 2, 3, 8, 9, 10, 11));
    }
    Vector rest = zero, inverse = zero;
    for (int i = 0; b + i < last; ++i) {
        const Real *const v = now + 4 * (b + i), *const u = then + 4 * (b + i);
        const Real x = __builtin_elementwise_abs(v[0] - u[0]), y = __builtin_elementwise_abs(v[1] - u[1]);
        rest[i] = x > y ? x : y;
        inverse[i] = v[3];
    }
    add(rest, inverse);
    return part;
});
const Real push = total(sums.push), mass = total(sums.mass);
#endif
const Real mean = push / mass;
return mean < (Real)1e30 ? mean : 0;  // NaN where there is no mass
