// Impulses of rolling resistance of the contacts i0 .. i1, from the cached ones i0 .. end by their keys, which both are
// sorted by, times scale; 0 where a contact is new. Parameters: contacts, cache, scale, i0, i1, end.
typedef long long Key;
const Key* const key = (const Key*)contacts.key.data;
const Key* const known = (const Key*)cache.key.data;
REAL* const impulse = contacts.rolling_impulse.data;
const REAL* const solved = cache.rolling_impulse.data;
int old = i0;
for (int c = i0; c < i1; ++c) {
    while (old < end && known[old] < key[c]) ++old;
    impulse[c] = old < end && known[old] == key[c] ? solved[old] * scale : 0;
}
