// Sorts the points of each world by line, then column, then index. A record is a point with its number and column; the
// scratch holds two keys, a record, two numbers, a line and four counts for each point. A world whose box is not finite
// is left without lines. Macros: DIM, CELL_SLACK, MAX_CELLS, SPARE.
#if !defined(__CUDA_ARCH__)
typedef unsigned long long Unsigned;
struct Record {
    Real p[DIM];
    int number, column;
};
const size_t rows = scratch.shape[0], words = (sizeof(Record) + sizeof(Unsigned) - 1) / sizeof(Unsigned);
Unsigned* const key = (Unsigned*)scratch.data;
Record* const record = (Record*)(key + 2 * rows);
int* const value = (int*)(key + (2 + words) * rows);
int* const line = value + 2 * rows;
int* const count = line + rows;
const Long room = SPARE * (Long)rows;
const size_t stride = cells.place.shape[1];
// sorts key[..m] below 2^bits, with value; returns where in both the result begins
auto radix = [&](Long m, int bits) -> size_t {
    Unsigned* const k = key;
    int* const v = value;
    if (m <= 32) {
        for (Long i = 1; i < m; ++i) {
            const Unsigned ki = k[i];
            const int vi = v[i];
            Long j = i;
            for (; j > 0 && k[j - 1] > ki; --j) {
                k[j] = k[j - 1];
                v[j] = v[j - 1];
            }
            k[j] = ki;
            v[j] = vi;
        }
        return 0;
    }
    const int digit = m < 4096 ? 8 : 11;
    size_t from = 0;
    int digits[1 << 11];
    for (int shift = 0; shift < bits; shift += digit) {
        const Unsigned* k0 = k + from;
        const int* v0 = v + from;
        from = rows - from;
        Unsigned* k1 = k + from;
        int* v1 = v + from;
        const Unsigned mask = (1 << digit) - 1;
        for (int d = 0; d < 1 << digit; ++d) digits[d] = 0;
        for (Long i = 0; i < m; ++i) ++digits[(k0[i] >> shift) & mask];
        for (int d = 0, sum = 0; d < 1 << digit; ++d) {
            const int c = digits[d];
            digits[d] = sum;
            sum += c;
        }
        for (Long i = 0; i < m; ++i) {
            const int at = digits[(k0[i] >> shift) & mask]++;
            k1[at] = k0[i];
            v1[at] = v0[i];
        }
    }
    return from;
};
auto bits_of = [](Unsigned last) -> int { return last == 0 ? 1 : 64 - __builtin_clzll(last); };

for (int w = world_offset; w < world_offset + worlds; ++w) {
    const int first = cells.start.data[w];
    const Long m = cells.start.data[w + 1] - first;
    cells.line_count.data[w] = 0;
    cells.line_stride.data[w] = 0;
    bool bounded = m > 0;
    for (int a = 0; a < DIM; ++a)
        bounded &= upper.data[(size_t)w * DIM + a] - lower.data[(size_t)w * DIM + a] < __builtin_inf();
    if (!bounded) continue;
    double low[DIM], inverse[DIM];
    Long across[DIM];
    for (int a = 0; a < DIM; ++a) {
        const double extent = upper.data[(size_t)w * DIM + a] - lower.data[(size_t)w * DIM + a];
        const double side = reach * (1.0 + CELL_SLACK), least = extent / MAX_CELLS;
        low[a] = lower.data[(size_t)w * DIM + a];
        inverse[a] = 1.0 / (side > least ? side : least);
        across[a] = (Long)(extent * inverse[a]) + 1;
    }
    const Real* p = point.data + (size_t)first * DIM;
    auto cell = [&](Long i, int a) -> int { return (int)(((double)p[i * DIM + a] - low[a]) * inverse[a]); };
    // an empty row behind each layer: the neighbouring keys of a layer's end rows belong to nobody
    const Long layer = DIM == 3 ? across[1] + 1 : 0;
    auto line_of = [&](Long i) -> Long { return DIM == 3 ? cell(i, DIM - 1) * layer + cell(i, 1) : cell(i, 1); };
    const Long lines = DIM == 3 ? across[DIM - 1] * layer : across[1];
    Long* const keys = cells.line_key.data + first;
    int* const starts = cells.line_start.data + (size_t)first + w;
    int used = 0;
    if (lines <= room) {
        for (Long k = 0; k < lines; ++k) count[k] = 0;
        for (Long i = 0; i < m; ++i) {
            const int k = (int)line_of(i);
            line[i] = k;
            ++count[k];
        }
        for (Long k = 0, sum = 0; k < lines; ++k) {
            const int c = count[k];
            count[k] = (int)sum;
            if (c) {
                keys[used] = k;
                starts[used++] = first + (int)sum;
            }
            sum += c;
        }
    } else {
        for (Long i = 0; i < m; ++i) {
            key[i] = (Unsigned)line_of(i);
            value[i] = (int)i;
        }
        const size_t at = radix(m, bits_of((Unsigned)(lines - 1)));
        const Unsigned* k = key + at;
        const int* v = value + at;
        for (Long i = 0; i < m; ++i) {
            if (i == 0 || k[i] != k[i - 1]) {
                keys[used] = (Long)k[i];
                count[used] = (int)i;
                starts[used++] = first + (int)i;
            }
            line[v[i]] = used - 1;
        }
    }
    starts[used] = first + (int)m;
    cells.line_count.data[w] = used;
    cells.line_stride.data[w] = layer;

    for (Long i = 0; i < m; ++i) {
        Record& to = record[count[line[i]]++];
        for (int a = 0; a < DIM; ++a) to.p[a] = p[i * DIM + a];
        to.number = first + (int)i;
        to.column = cell(i, 0);
    }
    for (int l = 0; l < used; ++l) {
        const Long a = starts[l] - first, size = starts[l + 1] - starts[l];
        const Record* from = record + a;
        auto put = [&](Long at, const Record& q) {
            at += starts[l];
            for (int k = 0; k < DIM; ++k) cells.place.data[k * stride + at] = q.p[k];
            cells.number.data[at] = q.number;
            cells.column.data[at] = q.column;
        };
        int least = from[0].column, most = least;
        for (Long i = 1; i < size; ++i) {
            const int c = from[i].column;
            least = c < least ? c : least;
            most = c > most ? c : most;
        }
        const int columns = most - least + 1;
        if (size > 16 && columns <= SPARE * size && columns <= room) {
            for (int c = 0; c < columns; ++c) count[c] = 0;
            for (Long i = 0; i < size; ++i) ++count[from[i].column - least];
            for (int c = 0, sum = 0; c < columns; ++c) {
                const int n = count[c];
                count[c] = sum;
                sum += n;
            }
            for (Long i = 0; i < size; ++i) put(count[from[i].column - least]++, from[i]);
        } else {
            for (Long i = 0; i < size; ++i) {
                key[i] = (Unsigned)(from[i].column - least);
                value[i] = (int)i;
            }
            const int* v = value + radix(size, bits_of((Unsigned)(most - least)));
            for (Long i = 0; i < size; ++i) put(i, from[v[i]]);
        }
    }
}
// lanes behind the last point are masked, but they are read
if (world_offset + worlds == cells.start.shape[0] - 1) {
    for (int i = 0; i < LANES; ++i) {
        const size_t at = (size_t)cells.start.data[world_offset + worlds] + i;
        for (int a = 0; a < DIM; ++a) cells.place.data[a * stride + at] = 0;
        cells.number.data[at] = 0;
        cells.column.data[at] = 0;
    }
}
#endif
