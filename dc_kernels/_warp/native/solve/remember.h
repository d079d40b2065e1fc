// The latest iterate and its step go in front of the remembered ones.
// Parameters: x, change, history, at, colors, first_color, team. Stands behind runtime/ranges.h.
const int i0 = colors.data[first_color] * 2 * LANES, i1 = colors.data[first_color + COLORS] * 2 * LANES;
const int stride = i1 - i0;
const Real *const now = x.data, *const step = change.data;
Real* const past = history.data + at - i0;
take_rows(team, colors.data + first_color, [=](int first, int last) {
    for (int i = first; i < last; ++i) {
        Real* const of = past + i;
        of[2 * stride] = of[0];
        of[3 * stride] = of[stride];
        of[0] = now[i];
        of[stride] = step[i];
    }
});
