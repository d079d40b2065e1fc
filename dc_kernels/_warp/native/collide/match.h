// What the contacts i0 .. i1 carry from the cached ones i0 .. end by their keys, which both are sorted by: impulses
// times scale, colours, ages. Contacts that go on stand in runs, whose arrays are copied one after the other.
// Parameters: contacts, cache, scale, i0, i1, end, team. Stands behind runtime/ranges.h.
typedef long long Key;
const Key* const key = (const Key*)contacts.key.data;
const Key* const known = (const Key*)cache.key.data;
REAL* const impulse = (REAL*)contacts.impulse.data;
const REAL* const solved = (const REAL*)cache.impulse.data;
int* const color = contacts.color.data;
const int* const kept = cache.color.data;
int* const age = contacts.age.data;
const int* const lived = cache.age.data;
take_range(team, i0, i1, 4096, [=](int first, int last) {
    // a share begins with a key that no contact before it has
    auto begin_of = [=](int c) {
        while (c > i0 && c < i1 && key[c] == key[c - 1]) ++c;
        return c;
    };
    const int AT_ONCE = 16, behind = begin_of(last);
    int c = begin_of(first), old = i0;
    if (c > i0 && c < behind) {
        for (int length = end - old; length > 0;) {
            const int half = length / 2;
            if (known[old + half] < key[c]) {
                old += half + 1;
                length -= half + 1;
            } else {
                length = half;
            }
        }
    }
    while (c < behind) {
        const int most = behind - c < end - old ? behind - c : end - old;
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
        if (c >= behind) break;
        while (old < end && known[old] < key[c]) ++old;
        if (old < end && known[old] == key[c]) continue;
        impulse[2 * (size_t)c] = impulse[2 * (size_t)c + 1] = 0;
        color[c] = -1;
        age[c] = 0;
        ++c;
    }
});
