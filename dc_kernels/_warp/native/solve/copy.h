// Numbers of a world's rows from one array into another, from source_at and target_at on. Parameters: source,
// source_at, target, target_at, colors, first_color, team. Stands behind runtime/ranges.h.
const int i0 = colors.data[first_color] * 2 * LANES;
const Real* const from = source.data + source_at - i0;
Real* const to = target.data + target_at - i0;
take_rows(team, colors.data + first_color, [=](int first, int last) {
    for (int i = first; i < last; ++i) to[i] = from[i];
});
