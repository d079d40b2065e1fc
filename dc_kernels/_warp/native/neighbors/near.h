// Tests of LANES sorted points at once. Macros: DIM, LANES (16, as a lane is a bit of an unsigned short).
#if !defined(__CUDA_ARCH__)
#ifdef __AVX512F__
auto pack = [](Integers v, unsigned bits) -> Integers {
    return (Integers)__builtin_ia32_compresssi512_mask(v, (Integers)0, (unsigned short)bits);
};
#endif
// bits of the lanes j .. j + LANES, those from `last` on left out, that are near the point
auto near = [&](const Real* at, size_t stride, Long j, Long last, const Real* own) -> unsigned {
    Vector d = *(const Vector*)(at + j) - own[0];
    Vector square = d * d;
    for (int a = 1; a < DIM; ++a) {
        d = *(const Vector*)(at + a * stride + j) - own[a];
        square = square + d * d;
    }
    const unsigned bits = __builtin_bit_cast(unsigned short, __builtin_convertvector(square <= limit, Booleans));
    return last - j < LANES ? bits & ((1u << (last - j)) - 1) : bits;
};
// the first point from j on whose column is not below `least`
auto skip = [&](const int* col, Long j, Long last, int least) -> Long {
    while (j < last) {
        const Integers c = *(const Integers*)(col + j);
        const unsigned below = __builtin_bit_cast(unsigned short, __builtin_convertvector(c < least, Booleans));
        const int more = __builtin_ctz(~below);
        j += more;
        if (more < LANES) break;
    }
    return j < last ? j : last;
};
#endif
