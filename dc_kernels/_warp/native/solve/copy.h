// Numbers of one array into another. Parameters: source, source_at, target, target_at, count.
const Real* const from = source.data + source_at;
Real* const to = target.data + target_at;
for (int i = 0; i < count; ++i) to[i] = from[i];
