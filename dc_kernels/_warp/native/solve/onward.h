// Momentum: x <- x + beta (x - before), before <- x.
// Parameters: x, before, at, beta, colors, first_color, team. Stands behind runtime/ranges.h.
const int i0 = colors.data[first_color] * 2 * LANES;
Real *const now = x.data, *const past = before.data + at - i0;
take_rows(team, colors.data + first_color, [=](int first, int last) {
    for (int i = first; i < last; ++i) {
        const Real v = now[i];
        now[i] = v + beta * (v - past[i]);
        past[i] = v;
    }
});
