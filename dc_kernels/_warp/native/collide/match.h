// What the contacts i0 .. i1 carry from the cached ones i0 .. end by their keys, which both are sorted by: impulses
// times scale, colours, ages. Contacts that go on stand in runs, whose arrays are copied one after the other.
// Parameters: contacts, cache, scale, i0, i1, end.
typedef long long Key;
const Key* const key = (const Key*)contacts.key.data;
const Key* const known = (const Key*)cache.key.data;
REAL* const impulse = (REAL*)contacts.impulse.data;
const REAL* const solved = (const REAL*)cache.impulse.data;
int* const color = contacts.color.data;
const int* const kept = cache.color.data;
int* const age = contacts.age.data;
const int* const lived = cache.age.data;
const int AT_ONCE = 16;
int c = i0, old = i0;
while (c < i1) {
    const int most = i1 - c < end - old ? i1 - c : end - old;
    int run = 0;
    for (int go_on = 1; go_on && run + AT_ONCE <= most; run += go_on ? AT_ONCE : 0) {
        Key differ = 0;
        for (int i = run; i < run + AT_ONCE; ++i) differ |= key[c + i] ^ known[old + i];
        go_on = differ == 0;
    }
    while (run < most && key[c + run] == known[old + run]) ++run;
    for (int i = 0; i < 2 * run; ++i) impulse[2 * (size_t)c + i] = solved[2 * (size_t)old + i] * scale;
    for (int i = 0; i < run; ++i) color[c + i] = kept[old + i];
    for (int i = 0; i < run; ++i) age[c + i] = lived[old + i] + 1;
    c += run;
    old += run;
    if (c == i1) break;
    while (old < end && known[old] < key[c]) ++old;
    if (old < end && known[old] == key[c]) continue;
    impulse[2 * (size_t)c] = impulse[2 * (size_t)c + 1] = 0;
    color[c] = -1;
    age[c] = 0;
    ++c;
}
