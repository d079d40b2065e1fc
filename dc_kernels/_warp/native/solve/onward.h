// Momentum: x <- x + beta (x - before), before <- x.
// Parameters: x, before, at, i0, i1, beta, team. Stands behind runtime/ranges.h.
Real *const now = x.data, *const past = before.data + at - i0;
take_range(team, i0, i1, 4096, [=](int first, int last) {
    for (int i = first; i < last; ++i) {
        const Real v = now[i];
        now[i] = v + beta * (v - past[i]);
        past[i] = v;
    }
});
