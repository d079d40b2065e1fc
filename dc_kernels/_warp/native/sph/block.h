// A block of a query's neighbours, weighed in vectors. gather(x, list, n) takes a query's coordinates and n neighbours:
// it fills `at` (their indices, and the first one's up to a whole vector), e0, e1, e2 (offset over h) and q2s, and
// returns the number of vectors. weigh(term, n, vectors) then fills s0 with a term of each neighbour (s1 too for the
// Hessian), and with 0 from n on. run(term, add) does both for all queries and blocks; add(q, vectors) sees one block.
// Macros: BLOCK (a multiple of LANES), the codes POLY6 ... WENDLAND and TERM_W ... TERM_LAPLACIAN_SLOPE.
#if !defined(__CUDA_ARCH__)
const Real inv_h = 1 / sum.h;
const int dim = (int)point.shape[1];
const Real* const places = (const Real*)point.data;
int at[BLOCK];
Real e0[BLOCK], e1[BLOCK], e2[BLOCK], q2s[BLOCK], s0[BLOCK], s1[BLOCK];
for (int j = 0; j < BLOCK; ++j) e2[j] = 0;
auto gather = [&](const Real* x, const int* list, int n) {
    const int vectors = (n + LANES - 1) / LANES;
    for (int j = 0; j < n; ++j) at[j] = list[j];
    for (int j = n; j < LANES * vectors; ++j) at[j] = list[0];
    if (dim == 2) {
        for (int j = 0; j < LANES * vectors; ++j) {
            const Real* p = places + 2 * (size_t)at[j];
            e0[j] = p[0];
            e1[j] = p[1];
        }
    } else {
        for (int j = 0; j < LANES * vectors; ++j) {
            const Real* p = places + 3 * (size_t)at[j];
            e0[j] = p[0];
            e1[j] = p[1];
            e2[j] = p[2];
        }
    }
    for (int j = 0; j < LANES * vectors; j += LANES) {
        const Vector a = (x[0] - load(e0 + j)) * inv_h, b = (x[1] - load(e1 + j)) * inv_h;
        Vector r2 = a * a + b * b;
        store(e0 + j, a);
        store(e1 + j, b);
        if (dim == 3) {
            const Vector c = (x[2] - load(e2 + j)) * inv_h;
            r2 += c * c;
            store(e2 + j, c);
        }
        // the list decides who is within reach; round-off must not
        store(q2s + j, smaller(r2, zero + 1));
    }
    return vectors;
};
auto weigh = [&](int term, int n, int vectors) {
    auto fill = [&](auto w, auto f, auto g, auto k) {
        auto each = [&](auto weight) {
            for (int j = 0; j < LANES * vectors; j += LANES) store(s0 + j, weight(load(q2s + j)));
        };
        switch (term) {
            case TERM_W:
                each([&](Vector q2) { return w(q2); });
                break;
            case TERM_F:
                each([&](Vector q2) { return f(q2); });
                break;
            case TERM_LAPLACIAN:
                each([&](Vector q2) { return (Real)dim * f(q2) + q2 * g(q2); });
                break;
            case TERM_LAPLACIAN_SLOPE:
                each([&](Vector q2) { return (Real)(dim + 2) * g(q2) + q2 * k(q2); });
                break;
            default:
                each([&](Vector q2) { return f(q2); });
                for (int j = 0; j < LANES * vectors; j += LANES) store(s1 + j, g(load(q2s + j)));
                for (int j = n; j < LANES * vectors; ++j) s1[j] = 0;
        }
    };
    switch (sum.kernel) {
        case POLY6:
            fill(poly6_w, poly6_f, poly6_g, poly6_k);
            break;
        case SPIKY:
            fill(spiky_w, spiky_f, spiky_g, spiky_k);
            break;
        case GAUSSIAN:
            fill(gaussian_w, gaussian_f, gaussian_g, gaussian_k);
            break;
        case CUBIC:
            fill(cubic_w, cubic_f, cubic_g, cubic_k);
            break;
        case WENDLAND:
            fill(wendland_w, wendland_f, wendland_g, wendland_k);
            break;
    }
    for (int j = n; j < LANES * vectors; ++j) s0[j] = 0;
};
auto run = [&](int term, auto add) {
    const Real* from = (const Real*)query.data;
    for (int q = first; q < last; ++q) {
        const int64_t end = lists.start.data[q + 1];
        for (int64_t b = lists.start.data[q]; b < end; b += BLOCK) {
            const int n = end - b < BLOCK ? (int)(end - b) : BLOCK;
            const int vectors = gather(from + (size_t)q * dim, lists.index.data + b, n);
            weigh(term, n, vectors);
            add(q, vectors);
        }
    }
};
const Real* const values = (const Real*)value.data;
const int width = (int)value.shape[1], out_width = (int)out.shape[1];
Real* const sums = (Real*)out.data;
for (size_t i = (size_t)first * out_width; i < (size_t)last * out_width; ++i) sums[i] = 0;
// column c of the values of LANES neighbours
auto column = [&](int j, int c) {
    auto of = [&](int lane) { return values[(size_t)at[j + lane] * width + c]; };
    return Vector{of(0), of(1), of(2), of(3), of(4), of(5), of(6), of(7)};
};
const Real* const offsets[3] = {e0, e1, e2};
#endif
