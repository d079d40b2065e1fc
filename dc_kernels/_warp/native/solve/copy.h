// Numbers of one array into another. Parameters: source, source_at, target, target_at, count, team. Stands behind
// runtime/ranges.h.
const Real* const from = source.data + source_at;
Real* const to = target.data + target_at;
take_range(team, 0, count, 8192, [=](int first, int last) {
    for (int i = first; i < last; ++i) to[i] = from[i];
});
