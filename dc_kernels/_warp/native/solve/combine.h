// Anderson's update into change, -(a e1 + b e2), and the latest iterate remembered.
// Parameters: x, change, history, at, i0, i1, kept, a, b, team. Stands behind runtime/ranges.h.
const int stride = i1 - i0;
Real *const now = x.data, *const step = change.data, *const past = history.data + at - i0;
take_range(team, i0, i1, 2048, [=](int first, int last) {
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
