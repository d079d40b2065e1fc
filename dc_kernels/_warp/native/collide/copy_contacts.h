// What persists of the contacts i0 .. i1, into the cache. Parameters: contacts, cache, i0, i1, team. Stands behind
// runtime/ranges.h.
const auto* const key = contacts.key.data;
const auto* const impulse = contacts.impulse.data;
const int *const color = contacts.color.data, *const age = contacts.age.data;
auto* const kept_key = cache.key.data;
auto* const kept_impulse = cache.impulse.data;
int *const kept_color = cache.color.data, *const kept_age = cache.age.data;
take_range(team, i0, i1, 4096, [=](int first, int last) {
    for (int i = first; i < last; ++i) kept_key[i] = key[i];
    for (int i = first; i < last; ++i) kept_impulse[i] = impulse[i];
    for (int i = first; i < last; ++i) kept_color[i] = color[i];
    for (int i = first; i < last; ++i) kept_age[i] = age[i];
});
