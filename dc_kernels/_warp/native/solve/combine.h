// Anderson's update into change, -(a e1 + b e2), and the latest iterate remembered.
// Parameters: x, change, history, at, kept, a, b, colors, first_color, team. Stands behind runtime/ranges.h.
const int i0 = colors.data[first_color] * 2 * LANES, i1 = colors.data[first_color + COLORS] * 2 * LANES;
const int stride = i1 - i0;
Real *const now = x.data, *const step = change.data, *const past = history.data + at - i0;
take_rows(team, colors.data + first_color, [=](int first, int last) {
    for (int i = first; i < last; ++i) {
        Real* const of = past + i;
        const Real v = now[i], d = step[i];
        Real move = a * (v - of[0]);
        if (kept > 1) move += b * (v - of[2 * stride]);
        of[2 * stride] = of[0];
        of[3 * stride] = of[stride];
        of[0] = v;
        of[stride] = d;
        step[i] = -move;
    }
});
