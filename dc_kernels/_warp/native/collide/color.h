// Colours of the contacts i0 .. i1, of which so many are fresh: others keep theirs, which the masks of bodies with a
// fresh one are told of first; a fresh one takes the lowest that is free at both bodies. Bodies that do not move forbid
// none. Masks are zero but for what `begun` says that others took before; without, they hold anything.
// Parameters: body_type, contacts, taken, begun, fresh, i0, i1, team. Macros: DYNAMIC, SERIAL. Stands behind
// runtime/ranges.h.
typedef unsigned long long Bits;
const int* const a = contacts.body_a.data;
const int* const b = contacts.body_b.data;
const int* const type = body_type.data;
int* const color = contacts.color.data;
auto* const mask = taken.data;
// the serial colour, the highest, blocks nobody
auto bit = [](int k) { return k == SERIAL ? (Bits)0 : (Bits)1 << k; };
auto is_fresh = [](int k) { return (k < 0) | (k == SERIAL); };
// Calls `visit` with the fresh ones of the contacts first .. last, which are mostly few, in their order.
auto each_fresh = [=](int first, int last, auto visit) {
    const int AT_ONCE = 32;
    for (int c = first; c < last;) {
        const int end = c + AT_ONCE < last ? c + AT_ONCE : last;
        int any = 0;
        for (int i = c; i < end; ++i) any |= is_fresh(color[i]);
        for (; any && c < end; ++c)
            if (is_fresh(color[c])) visit(c);
        c = end;
    }
};
// Bodies with a fresh contact, by their index up to a multiple of so many: a few others are told of what they need not
// know.
#if defined(__CUDA_ARCH__)
const int MOST = 1 << 10;
#else
const int MOST = 1 << 14;
#endif
unsigned char sought[MOST];
unsigned char* const is_sought = sought;
int places = 64;
while (places < MOST && places < 2 * (i1 - i0)) places *= 2;
const int within = places - 1;
auto seek = [=](int first, int last) {
    auto mark = [=](int body) {
        if (type[body] != DYNAMIC) return;
        is_sought[body & within] = 1;
        if (!begun) mask[body] = 0;
    };
    each_fresh(first, last, [=](int c) {
        mark(a[c]);
        mark(b[c]);
    });
};
auto tell = [=](int first, int last) {
    const int AT_ONCE = 16;
    auto take = [=](int body, int k) {
        if (!is_sought[body & within]) return;
#if defined(__CUDA_ARCH__)
        mask[body] |= bit(k);
#else
        __atomic_fetch_or(mask + body, bit(k), __ATOMIC_RELAXED);
#endif
    };
    for (int c = first; c < last;) {
        const int end = c + AT_ONCE < last ? c + AT_ONCE : last;
        int any = 0;
        for (int i = c; i < end; ++i) any |= is_sought[a[i] & within] | is_sought[b[i] & within];
        for (; any && c < end; ++c) {
            if (is_fresh(color[c])) continue;
            take(a[c], color[c]);
            take(b[c], color[c]);
        }
        c = end;
    }
};
for (int i = 0; i < places; ++i) sought[i] = 0;
take_range(team, i0, i1, 4096, seek);
if (fresh < i1 - i0) take_range(team, i0, i1, 4096, tell);
each_fresh(i0, i1, [=](int c) {
    auto asked = [=](int body) { return type[body] == DYNAMIC ? (Bits)mask[body] : 0; };
    const Bits open = ~(asked(a[c]) | asked(b[c])) & (((Bits)1 << SERIAL) - 1);
#if defined(__CUDA_ARCH__)
    const int free = open ? __ffsll(open) - 1 : SERIAL;
#else
    const int free = open ? __builtin_ctzll(open) : SERIAL;
#endif
    color[c] = free;
    mask[a[c]] |= bit(free);
    mask[b[c]] |= bit(free);
});
