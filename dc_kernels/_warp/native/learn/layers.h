// Layers of a small network: sums over inputs times weights, for several pixels or contacts side by side and up to two
// vectors of outputs. Numbers of a pixel lie side by side, padded with zeros to whole vectors; an image has a border of
// zeros around it. Weights lie in the order in which they are read. Behind prelude.h.
#if !defined(__CUDA_ARCH__)
// What a sum reads of one image: `channels` numbers at each of some places, `step` from one pixel to the next.
struct Source {
    const Real *from, *weight;
    int step, channels, places;
    int place[9];
};
// Outputs of ROWS pixels, VECTORS vectors each; shape is a char (*)[ROWS][VECTORS].
auto sum_block = [&](auto shape, const Source* source, int sources, const Real* bias, Real* to, int to_step, Real least)
                     __attribute__((always_inline)) {
#pragma clang fp contract(fast)
                         const int VECTORS = sizeof((*shape)[0]), ROWS = sizeof(*shape) / sizeof((*shape)[0]);
                         Vector sum[sizeof(*shape) / sizeof((*shape)[0])][sizeof((*shape)[0])];
#pragma unroll
                         for (int r = 0; r < ROWS; ++r)
#pragma unroll
                             for (int v = 0; v < VECTORS; ++v) sum[r][v] = *(const Vector*)(bias + v * LANES);
                         for (int s = 0; s < sources; ++s) {
                             const Real* weight = source[s].weight;
                             const size_t step = source[s].step;
                             const int channels = source[s].channels;
                             for (int t = 0; t < source[s].places; ++t) {
                                 const Real* p = source[s].from + source[s].place[t];
                                 for (int c = 0; c < channels; ++c, ++p, weight += VECTORS * LANES) {
                                     Vector w[sizeof((*shape)[0])];
#pragma unroll
                                     for (int v = 0; v < VECTORS; ++v) w[v] = *(const Vector*)(weight + v * LANES);
#pragma unroll
                                     for (int r = 0; r < ROWS; ++r) {
                                         const Vector x = p[r * step];
#pragma unroll
                                         for (int v = 0; v < VECTORS; ++v) sum[r][v] = sum[r][v] + x * w[v];
                                     }
                                 }
                             }
                         }
#pragma unroll
                         for (int r = 0; r < ROWS; ++r)
#pragma unroll
                             for (int v = 0; v < VECTORS; ++v)
                                 *(Vector*)(to + (size_t)r * to_step + v * LANES) =
                                     sum[r][v] < least ? zero + least : sum[r][v];  // NaN stays
                     };
const Real no_least = sizeof(Real) == 4 ? (Real)-3e38 : (Real)-1e308;
typedef char (*Wide)[6][2];
typedef char (*Some)[4][2];
typedef char (*One)[1][2];
typedef char (*WideHalf)[8][1];
typedef char (*SomeHalf)[4][1];
typedef char (*OneHalf)[1][1];
// `count` pixels side by side; the last block begins early enough to be whole, and makes some pixels once more.
auto sum_row = [&](int vectors, int count, const Source* source, int sources, const Real* bias, Real* to, int to_step,
                   Real least) __attribute__((noinline)) {
    const int wide = vectors == 2 ? 6 : 8, rows = count >= wide && count % wide == 0 ? wide
                                                  : count >= 4 ? (vectors == 1 && count > 8 ? 8 : 4)
                                                               : 1;
    Source moved[2];
    for (int first = 0; first < count; first += rows) {
        const int at = first + rows <= count ? first : count - rows;
        for (int s = 0; s < sources; ++s) {
            moved[s] = source[s];
            moved[s].from += (size_t)at * source[s].step;
        }
        Real* const here = to + (size_t)at * to_step;
        if (vectors == 2) {
            if (rows == 6)
                sum_block((Wide) nullptr, moved, sources, bias, here, to_step, least);
            else if (rows == 4)
                sum_block((Some) nullptr, moved, sources, bias, here, to_step, least);
            else
                sum_block((One) nullptr, moved, sources, bias, here, to_step, least);
        } else {
            if (rows == 8)
                sum_block((WideHalf) nullptr, moved, sources, bias, here, to_step, least);
            else if (rows == 4)
                sum_block((SomeHalf) nullptr, moved, sources, bias, here, to_step, least);
            else
                sum_block((OneHalf) nullptr, moved, sources, bias, here, to_step, least);
        }
    }
};
auto padded = [](int channels) { return (channels + LANES - 1) / LANES * LANES; };
#endif
