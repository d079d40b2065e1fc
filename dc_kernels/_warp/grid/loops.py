"""The loops over points of ``transfer`` and ``tiles``, as C++ text around the weights of ``stencil``."""

from dc_kernels._warp.grid.stencil import each_point
from dc_kernels.grid.layout import BAND, CHUNK

# Points item(k), k = begin .. end - 1, are added to rows row_lo .. row_hi - 1 of `base`, whose first column is `left`.
# `lost`: how many reach no node, of those whose nearest node lies in these rows and columns col_lo .. col_hi - 1.
ADD_RUN = each_point("""
const int i = at[j];
const S px = xs[j], py = ys[j];
const bool out = separable && outside(px, py);
const S* A = value.data + (size_t)i * C;
S* to = base + (size_t)(channel_offset + (bins > 1 ? point_bin.data[i] * C : 0)) * channel_stride;
if (place(j)) {
    const int from = r0 < row_lo ? row_lo : r0, until = r1 < row_hi ? r1 : row_hi - 1;
    if (one) {
        V kept[ROW_LIMIT], sum = zero;
        for (int r = r0; r <= r1; ++r) {
            kept[r - r0] = first_weight(r);
            sum += kept[r - r0];
        }
        const S t = separable ? 1 : total(sum);
        if (t > tiny) {
            const S factor = constant == 0 ? 1 / t : constant;
            S* row = to + (size_t)(from - row_lo) * row_stride + (a - left);
            if (C == 4) {
                const V a0 = A[0] * factor, a1 = A[1] * factor, a2 = A[2] * factor, a3 = A[3] * factor;
                for (int r = from; r <= until; ++r, row += row_stride) {
                    const V w = kept[r - r0];
                    S *p0 = row, *p1 = row + channel_stride, *p2 = p1 + channel_stride, *p3 = p2 + channel_stride;
                    *(V*)p0 += w * a0; *(V*)p1 += w * a1; *(V*)p2 += w * a2; *(V*)p3 += w * a3;
                }
            } else {
                for (int c = 0; c < C; ++c) {
                    const V scaled = A[c] * factor;
                    S* p = row + c * channel_stride;
                    for (int r = from; r <= until; ++r, p += row_stride) *(V*)p += kept[r - r0] * scaled;
                }
            }
            mark(r0, r1);
            if (out) lost += home(px, py);
            continue;
        }
    } else {
        V sum = zero;
        if (!separable)
            for (int r = r0; r <= r1; ++r)
                for (int v = 0; v < nv; ++v) sum += weight(r, v);
        const S t = separable ? 1 : total(sum);
        if (t > tiny) {
            const S factor = constant == 0 ? 1 / t : constant;
            for (int r = from; r <= until; ++r)
                for (int v = 0; v < nv; ++v) {
                    const V w = weight(r, v);
                    S* p = to + (size_t)(r - row_lo) * row_stride + (a - left) + v * L;
                    for (int c = 0; c < C; ++c, p += channel_stride) store(p, v, load(p, v) + w * (A[c] * factor));
                }
            mark(r0, r1);
            if (out) lost += home(px, py);
            continue;
        }
    }
}
if (!home(px, py)) continue;
++lost;
if (is_finite(px, py) && nearest && normalize) {
    const int r = nearest_node(py, R);
    S* p = to + (size_t)(r - row_lo) * row_stride + (nearest_node(px, K) - left);
    for (int c = 0; c < C; ++c, p += channel_stride) *p += A[c];
    mark(r, r);
}
""")

LOST = """
const int C = value.shape[1];
int lost = 0;
"""
HOME = """
auto home = [&](S px, S py) {
    const bool valid = is_finite(px, py);
    const int c = valid ? nearest_node(px, K) : 0, r = valid ? nearest_node(py, R) : 0;
    return r >= row_lo && r < row_hi && c >= col_lo && c < col_hi;
};
"""
WORLD = f"""
const int bands = touched.shape[1];
int* const marks = touched.data + (size_t)world * bands;
const size_t row_stride = K, channel_stride = (size_t)R * K;
S* const base = image.data + (size_t)world * image.shape[1] * channel_stride;
const int row_lo = 0, row_hi = R, col_lo = 0, col_hi = K, left = 0;
const int begin = point_start.data[world], end = begin + point_count.data[world];
for (int b = 0; b < bands; ++b) {{
    if (!marks[b]) continue;
    marks[b] = 0;
    const size_t first = (size_t)b * {BAND} * K;
    const size_t last = (b + 1) * {BAND} < R ? first + (size_t){BAND} * K : channel_stride;
    for (int c = channel_offset; c < channel_offset + bins * value.shape[1]; ++c)
        for (size_t n = first; n < last; ++n) base[c * channel_stride + n] = 0;
}}
auto mark = [&](int first, int last) {{ for (int b = first / {BAND}; b <= last / {BAND}; ++b) marks[b] = 1; }};
auto item = [](int k) {{ return k; }};
"""

GATHER = f"""
const int C = value.shape[1];
const size_t row_stride = K, channel_stride = (size_t)R * K;
const S* const base = image.data + (size_t)world * image.shape[1] * channel_stride;
const int first = point_start.data[world] + chunk * {CHUNK};
const int last = point_start.data[world] + point_count.data[world];
auto item = [](int k) {{ return k; }};
const int begin = first, end = first + {CHUNK} < last ? first + {CHUNK} : last;
"""
GATHER_RUN = each_point("""
const int i = at[j];
S* A = value.data + (size_t)i * C;
const S* from = base + (size_t)(channel_offset + (bins > 1 ? point_bin.data[i] * C : 0)) * channel_stride;
bool hit = place(j);
if (hit && one) {
    V sum = zero, f0 = zero, f1 = zero, f2 = zero, f3 = zero;
    const S* row = from + (size_t)r0 * K + a;
    const int d1 = C > 1, d2 = C > 2 ? 2 : 0, d3 = C > 3 ? 3 : 0;
    for (int r = r0; r <= r1; ++r, row += K) {
        const V w = first_weight(r);
        sum += w;
        f0 += w * *(const V*)row;
        f1 += w * *(const V*)(row + d1 * channel_stride);
        f2 += w * *(const V*)(row + d2 * channel_stride);
        f3 += w * *(const V*)(row + d3 * channel_stride);
    }
    const S t = separable ? 1 : total(sum);
    hit = t > tiny;
    const S factor = hit ? (constant == 0 ? 1 / t : constant) : 0;
    A[0] = total(f0) * factor;
    if (C > 1) A[1] = total(f1) * factor;
    if (C > 2) A[2] = total(f2) * factor;
    if (C > 3) A[3] = total(f3) * factor;
    for (int c = 4; c < C; ++c) {
        V f = zero;
        const S* p = from + c * channel_stride + (size_t)r0 * K + a;
        for (int r = r0; r <= r1; ++r, p += K) f += first_weight(r) * *(const V*)p;
        A[c] = total(f) * factor;
    }
} else if (hit) {
    for (int c = 0; c < C; ++c) {
        V sum = zero, f = zero;
        for (int r = r0; r <= r1; ++r)
            for (int v = 0; v < nv; ++v) {
                const V w = weight(r, v);
                sum += w;
                f += w * load(from + c * channel_stride + (size_t)r * K + a + v * L, v);
            }
        const S t = separable ? 1 : total(sum);
        hit = t > tiny;
        A[c] = hit ? total(f) * (constant == 0 ? 1 / t : constant) : 0;
    }
}
if (!hit) {
    const S px = xs[j], py = ys[j];
    const bool valid = is_finite(px, py);
    const S* p = from + (valid ? (size_t)nearest_node(py, R) * K + nearest_node(px, K) : 0);
    for (int c = 0; c < C; ++c) A[c] = valid && nearest && normalize ? p[c * channel_stride] : 0;
}
""")
# Bilinear alone: places and weights of LANES points at once, then four nodes of each, two channels at a time. On large
# images the nodes are fetched while the points before them are at work: 1e6 points on 64 MB took 21 and take 12 ns by
# place, 103 and 73 in random order, where every node is a cache line of its own.
BILINEAR_RUN = """
typedef int I __attribute__((ext_vector_type(L), aligned(4)));
const size_t step = bins > 1 ? C * channel_stride : 0;
typedef long long J __attribute__((ext_vector_type(L), aligned(8)));
typedef S D __attribute__((ext_vector_type(2), aligned(sizeof(S))));
typedef S Q __attribute__((ext_vector_type(4)));
const bool far = (size_t)R * K * C * sizeof(S) > 1 << 20;  // beyond the cache of a core
const S* const origin = base + channel_offset * channel_stride;
long long at[2][L];
S low[2][2 * L], high[2][2 * L];  // weights of the two nodes of a row, point by point
for (int i = begin, k = 0; i < end + L; i += L, k ^= 1) {
    const int ahead = end - i < L ? end - i : L;
    if (ahead > 0) {
        S xy[2 * L] = {0};
        const S* q = P + 2 * (size_t)i;
        if (ahead < L) {
            for (int j = 0; j < 2 * ahead; ++j) xy[j] = q[j];
            q = xy;
        }
        const V a = *(const V*)q, b = *(const V*)(q + L);
        V u = (__builtin_shufflevector(a, b, 0, 2, 4, 6, 8, 10, 12, 14) - ox) * inv;
        V v = (__builtin_shufflevector(a, b, 1, 3, 5, 7, 9, 11, 13, 15) - oy) * inv;
        const auto valid = (u - u == 0) & (v - v == 0);
        u = __builtin_elementwise_min(__builtin_elementwise_max(valid ? u : zero, zero), (V)(S)(K - 1));
        v = __builtin_elementwise_min(__builtin_elementwise_max(valid ? v : zero, zero), (V)(S)(R - 1));
        const I ix = __builtin_elementwise_min(__builtin_convertvector(u, I), (I)(K - 2));
        const I iy = __builtin_elementwise_min(__builtin_convertvector(v, I), (I)(R - 2));
        const V tx = u - __builtin_convertvector(ix, V), ty = v - __builtin_convertvector(iy, V);
        const V w00 = (1 - tx) * (1 - ty) * (valid ? (V)(S)1 : zero), w01 = tx * (1 - ty);
        const V w10 = (1 - tx) * ty, w11 = tx * ty;
        *(V*)low[k] = __builtin_shufflevector(w00, w01, 0, 8, 1, 9, 2, 10, 3, 11);
        *(V*)(low[k] + L) = __builtin_shufflevector(w00, w01, 4, 12, 5, 13, 6, 14, 7, 15);
        *(V*)high[k] = __builtin_shufflevector(w10, w11, 0, 8, 1, 9, 2, 10, 3, 11);
        *(V*)(high[k] + L) = __builtin_shufflevector(w10, w11, 4, 12, 5, 13, 6, 14, 7, 15);
        *(J*)at[k] = __builtin_convertvector(iy, J) * K + __builtin_convertvector(ix, J);
        if (step)
            for (int j = 0; j < ahead; ++j) at[k][j] += point_bin.data[i + j] * step;
        for (int j = 0; j < ahead && far; ++j) {
            const S* p = origin + at[k][j];
            for (int c = 0; c < C; ++c, p += channel_stride) {
                __builtin_prefetch(p);
                __builtin_prefetch(p + K);
            }
        }
    }
    const int first = i - L, n = end - first < L ? end - first : L;
    if (first < begin) continue;
    for (int j = 0; j < n; ++j) {
        S* A = value.data + (size_t)(first + j) * C;
        const S* p = origin + at[k ^ 1][j];
        const D l = *(const D*)(low[k ^ 1] + 2 * j), h = *(const D*)(high[k ^ 1] + 2 * j);
        int c = 0;
        for (; c + 1 < C; c += 2, p += 2 * channel_stride) {
            const S* q = p + channel_stride;
            const Q sum = Q{p[0], p[1], q[0], q[1]} * l.xyxy + Q{p[K], p[K + 1], q[K], q[K + 1]} * h.xyxy;
            *(D*)(A + c) = sum.even + sum.odd;
        }
        if (c < C) A[c] = (l.x * p[0] + h.x * p[K]) + (l.y * p[1] + h.y * p[K + 1]);
    }
}
"""

# S = w / sum w:  sum_i dS_i a_i = (sum dw a - (sum w a) (sum dw) / sum w) / sum w, with a_i = sum_c value_c image_ci
GRADIENT_RUN = each_point("""
const int i = at[j];
const S* A = value.data + (size_t)i * C;
S gx = 0, gy = 0;
if (place(j)) {
    const S* from = base + (size_t)(channel_offset + (bins > 1 ? point_bin.data[i] * C : 0)) * channel_stride;
    V sum = zero, wa = zero, dx = zero, dy = zero, dxa = zero, dya = zero;
    for (int r = r0; r <= r1; ++r) {
        for (int v = 0; v < nv; ++v) {
            V field = zero, wx, wy;
            const S* row = from + (size_t)r * K + a + v * L;
            for (int c = 0; c < C; ++c) field += load(row + c * channel_stride, v) * A[c];
            const V w = weight(r, v);
            gradient(r, v, wx, wy);
            sum += w; wa += w * field;
            dx += wx; dy += wy;
            dxa += wx * field; dya += wy * field;
        }
    }
    const S t = separable ? 1 : total(sum);
    if (t > tiny) {
        if (constant == 0) {
            const S mean = total(wa) / t;
            gx = (total(dxa) - mean * total(dx)) / t;
            gy = (total(dya) - mean * total(dy)) / t;
        } else {
            gx = total(dxa) * constant;
            gy = total(dya) * constant;
        }
    }
}
S* G = (S*)gradient_out.data + 2 * (size_t)i;
G[0] = gx * inv;
G[1] = gy * inv;
""")

DIVIDE = """
#if !defined(__CUDA_ARCH__)
const size_t nodes = (size_t)image.shape[2] * image.shape[3];
const int bins = weight.shape[1], C = image.shape[1] / bins;
for (int b = 0; b < bins; ++b) {
    auto* w = weight.data + ((size_t)world * bins + b) * nodes;
    for (int c = 0; c < C; ++c) {
        auto* p = image.data + ((size_t)world * image.shape[1] + b * C + c) * nodes;
        for (size_t n = 0; n < nodes; ++n) p[n] = w[n] > 0 ? p[n] / w[n] : 0;
    }
}
#endif
"""
