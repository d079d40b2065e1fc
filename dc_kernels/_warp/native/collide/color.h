// Colours of the contacts i0 .. i1, of which so many are fresh: others keep theirs, which the masks of bodies with a
// fresh one are told of first; a fresh one takes the lowest that is free at both bodies. Bodies that do not move forbid
// none.
// Parameters: body_type, contacts, taken, fresh, i0, i1. Macros: DYNAMIC, SERIAL.
typedef unsigned long long Bits;
const int* const a = contacts.body_a.data;
const int* const b = contacts.body_b.data;
int* const color = contacts.color.data;
auto* const mask = taken.data;
auto asked = [&](int body) { return body_type.data[body] == DYNAMIC ? (Bits)mask[body] : 0; };
// the serial colour, the highest, blocks nobody
auto bit = [&](int k) { return k == SERIAL ? (Bits)0 : (Bits)1 << k; };
auto is_fresh = [&](int k) { return k < 0 || k == SERIAL; };
if (fresh > 0 && fresh < i1 - i0) {
    const Bits sought = (Bits)1 << SERIAL;
    for (int c = i0; c < i1; ++c) {
        if (!is_fresh(color[c])) continue;
        mask[a[c]] |= sought;
        mask[b[c]] |= sought;
    }
    for (int c = i0; c < i1; ++c) {
        if (!((mask[a[c]] | mask[b[c]]) & sought) || is_fresh(color[c])) continue;
        mask[a[c]] |= bit(color[c]);
        mask[b[c]] |= bit(color[c]);
    }
}
for (int c = i0; c < i1; ++c) {
    if (!is_fresh(color[c])) continue;
    const Bits open = ~(asked(a[c]) | asked(b[c])) & (((Bits)1 << SERIAL) - 1);
#if defined(__CUDA_ARCH__)
    const int free = open ? __ffsll(open) - 1 : SERIAL;
#else
    const int free = open ? __builtin_ctzll(open) : SERIAL;
#endif
    color[c] = free;
    mask[a[c]] |= bit(free);
    mask[b[c]] |= bit(free);
}
