// Whether a key does not rise within its world, or names a shape that is not of it or not of the body given, or a
// dynamic body has a colour below SERIAL twice. Macros: SHAPE_BITS, FEATURE_BITS, SERIAL, DYNAMIC.
#if !defined(__CUDA_ARCH__)
typedef long long Long;
typedef unsigned long long Bits;
int wrong = 0;
const bool given = body_a.shape[0] > 0, colored = color.shape[0] > 0;
const Long mask = (1ll << SHAPE_BITS) - 1;
for (int w = 0; w < shape_start.shape[0] - 1; ++w) {
    const int low = body_start.data[w], bodies = body_start.data[w + 1] - low;
    const int* owner = shape_body.data + shape_start.data[w];
    const Long shapes = shape_start.data[w + 1] - shape_start.data[w];
    // a colour is a bit at each body; the highest one says that it may come twice there, as the body is not dynamic
    const int* type = body_type.data + low;
    for (int b = 0; b < bodies; ++b) taken.data[b] = type[b] == DYNAMIC ? 0 : 1ull << 63;
    Long last = -1;
    Bits twice = 0;
    auto take = [&](const int body, const Bits bit) {
        const Bits before = taken.data[body];
        twice |= bit & before & ~(Bits)((Long)before >> 63);
        taken.data[body] = before | bit;
    };
    for (Long c = contact_start.data[w]; c < contact_start.data[w + 1]; ++c) {
        const Long k = key.data[c], a = k >> (SHAPE_BITS + FEATURE_BITS) & mask, b = k >> FEATURE_BITS & mask;
        wrong |= k <= last;
        last = k;
        if (a >= shapes || b >= shapes) return 1;
        const int one = owner[a], other = owner[b];
        if (given) wrong |= (body_a.data[c] != one) | (body_b.data[c] != other);
        if (!colored) continue;
        const int own = color.data[c];
        const Bits bit = own >= 0 && own < SERIAL ? 1ull << own : 0;
        take(one - low, bit);
        take(other - low, bit);
    }
    wrong |= twice != 0;
}
return wrong;
#else
return 1;
#endif
