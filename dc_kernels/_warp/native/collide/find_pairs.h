// Pairs of boxes pairs.box that overlap, of a world w: those of its `left` shapes in pairs.left, in the order of their
// index, with all shapes. Into pairs.temp_a and temp_b, as far as there is room; returns how many.
// Parameters: w, left, model, pairs.
// Macros: LANES (8), DYNAMIC, STATIC, ROUNDING, MAX_LEVEL, LARGE_LEVEL, MAX_LARGE, FILTER_BITS.
const int first = model.shape_start.data[w], last = model.shape_start.data[w + 1], shapes = last - first;
const int start = pairs.start.data[w], capacity = pairs.start.data[w + 1] - start;
const int* const leaver = pairs.left.data + first;
int* const bucket = pairs.bucket.data + pairs.bucket_start.data[w];
const auto* const boxes = pairs.box.data;
auto* const cells = pairs.cell.data;
auto box = [&](int shape) -> Quad { return load(boxes + shape); };
auto cell = [&](int shape) -> int* { return cells[shape].c; };
auto level_of = [&](int shape) -> int& { return cells[shape].c[2]; };

// Cells of the finest level are as wide to high as the boxes are on average.
Real wide = 0, high = 0;
for (int i = 0; i < left; ++i) {
    const Quad q = box(leaver[i]);
    const Real x = q.z - q.x, y = q.w - q.y, extent = x < y ? y : x;
    if (!(extent > 0 && extent - extent == 0)) continue;
    const Real part = 1 / extent;
    wide += x * part;
    high += y * part;
}
Real aspect = wide > 0 && high > 0 ? wide / high : (Real)1;
aspect = aspect < (Real)0.125 ? (Real)0.125 : aspect > 8 ? (Real)8 : aspect;
auto extent_of = [&](Quad q) -> Real {
    const Real x = q.z - q.x, y = (q.w - q.y) * aspect, extent = x < y ? y : x;
    return extent > 0 && extent - extent == 0 ? extent : (Real)0;
};
// They are the smallest box's up to twice as large, so that the doubling of cells wastes little area with most boxes.
Real smallest = 0;
for (int i = 0; i < left; ++i) {
    const Real extent = extent_of(box(leaver[i]));
    if (extent > 0 && (smallest == 0 || extent < smallest)) smallest = extent;
}
const Real per_smallest = smallest > 0 ? 1 / smallest : 0;
const int PARTS = 8;  // of an octave
int extents[PARTS] = {0, 0, 0, 0, 0, 0, 0, 0};
for (int i = 0; i < left; ++i) {
    Real ratio = extent_of(box(leaver[i])) * per_smallest;
    for (int level = 0; level < MAX_LEVEL && ratio >= 2; ++level) ratio *= (Real)0.5;
    if (ratio >= 1 && ratio < 2) ++extents[(int)((ratio - 1) * PARTS)];
}
Real side_x = 1, least_waste = -1;
for (int part = 0; part < PARTS && smallest > 0; ++part) {
    Real waste = 0;
    for (int other = 0; other < PARTS; ++other) {
        const Real ratio = (Real)(PARTS + 1 + part) / (Real)(PARTS + 1 + other) * (Real)(other > part ? 2 : 1);
        waste += (Real)extents[other] * ratio * ratio;
    }
    if (least_waste >= 0 && least_waste <= waste) continue;
    least_waste = waste;
    side_x = smallest * (Real)(PARTS + 1 + part) / (Real)PARTS;
}
// sides of the cells of each level, and their inverses
Real sides_x[MAX_LEVEL + 1], sides_y[MAX_LEVEL + 1], inverses_x[MAX_LEVEL + 1], inverses_y[MAX_LEVEL + 1];
sides_x[0] = side_x;
sides_y[0] = side_x / aspect;
for (int i = 0; i < MAX_LEVEL; ++i) {
    sides_x[i + 1] = sides_x[i] * 2;
    sides_y[i + 1] = sides_y[i] * 2;
}
for (int i = 0; i <= MAX_LEVEL; ++i) {
    inverses_x[i] = 1 / sides_x[i];
    inverses_y[i] = 1 / sides_y[i];
}

// The cells of a level are at least as large as its boxes; the level of a shape that stays is -1.
if (left < shapes)
    for (int shape = first; shape < last; ++shape) level_of(shape) = -1;
int large = 0;
for (int i = 0; i < left; ++i) {
    const Quad q = box(leaver[i]);
    const Real x = q.z - q.x, y = q.w - q.y;
    int level = 0;
    for (; level < MAX_LEVEL && !(x <= sides_x[level] && y <= sides_y[level]); ++level) {
    }
    level_of(leaver[i]) = level;
    large += level >= LARGE_LEVEL;
}
// Shapes on this level and above are compared with all, one by one: few large ones, few at all, any without bound.
const int apart = left <= MAX_LARGE ? 0 : large <= MAX_LARGE ? LARGE_LEVEL : MAX_LEVEL;

// A box lies in the cell of its centre; boxes are sorted by the buckets of cells, then by index.
int mask = 1;
while (mask < left) mask *= 2;
mask -= 1;
auto cell_of = [](Real x, Real inverse) -> int {
    const Real place = wp::floor(x * inverse), most = (Real)(1 << 29);
    return place > -most ? place < most ? (int)place : 1 << 29 : -(1 << 29);
};
// Neighbouring cells of a row lie in neighbouring buckets; rows and levels are spread by odd strides.
auto bucket_of = [&](int x, int y, int level) -> int {
    return (int)(((unsigned)x + (unsigned)y * 7919u + (unsigned)level * 104729u) & (unsigned)mask);
};
unsigned long long levels = 0;
int sorted = 0, top = 0;
for (int i = 0; i <= mask + 1; ++i) bucket[i] = 0;
for (int i = 0; i < left; ++i) {
    int* const c = cell(leaver[i]);
    if (c[2] >= apart) continue;
    const Quad q = box(leaver[i]);
    c[0] = cell_of((Real)0.5 * (q.x + q.z), inverses_x[c[2]]);
    c[1] = cell_of((Real)0.5 * (q.y + q.w), inverses_y[c[2]]);
    levels |= 1ull << c[2];
    top = c[2] > top ? c[2] : top;
    ++bucket[bucket_of(c[0], c[1], c[2]) + 1];
    ++sorted;
}
for (int i = 0; i <= mask; ++i) bucket[i + 1] += bucket[i];
// filled from the back: bucket[i + 1] then is the first entry of bucket i
int* const entry = pairs.sorted_shape.data + first;
Real* const low_x = (Real*)(pairs.sorted_box.data + first);
Real *const low_y = low_x + shapes, *const high_x = low_y + shapes, *const high_y = high_x + shapes;
for (int i = left - 1; i >= 0; --i) {
    const int* const c = cell(leaver[i]);
    if (c[2] >= apart) continue;
    const int slot = --bucket[bucket_of(c[0], c[1], c[2]) + 1];
    const Quad q = box(leaver[i]);
    entry[slot] = leaver[i];
    low_x[slot] = q.x;
    low_y[slot] = q.y;
    high_x[slot] = q.z;
    high_y[slot] = q.w;
}

// Where few have left, most boxes meet none of them: a bit is set for each cell of the highest level that one covers.
const bool filter = left < shapes && 8 * left <= FILTER_BITS;
unsigned long long covered[FILTER_BITS / 64];
const Real inverse_x = inverses_x[top], inverse_y = inverses_y[top];
// whether a visit of the cells that a box covers ends; `most` of them at most along an axis
auto any_cell = [&](Quad q, int most, auto visit) -> bool {
    const int x0 = cell_of(q.x, inverse_x), x1 = cell_of(q.z, inverse_x);
    const int y0 = cell_of(q.y, inverse_y), y1 = cell_of(q.w, inverse_y);
    if (x1 - x0 >= most || y1 - y0 >= most) return true;
    for (int y = y0; y <= y1; ++y)
        for (int x = x0; x <= x1; ++x) {
            const unsigned bit = ((unsigned)x + (unsigned)y * 7919u) % FILTER_BITS;
            if (visit(covered[bit / 64], 1ull << bit % 64)) return true;
        }
    return false;
};
if (filter) {
    for (int i = 0; i < FILTER_BITS / 64; ++i) covered[i] = 0;
    for (int i = 0; i < left; ++i)
        if (level_of(leaver[i]) < apart)
            any_cell(box(leaver[i]), 3, [](unsigned long long& word, unsigned long long bit) -> bool {
                word |= bit;
                return false;
            });
}

int found = 0;
int *const temp_a = pairs.temp_a.data + start, *const temp_b = pairs.temp_b.data + start;
const int* const body_of = model.shape_body.data;
const int* const kind_of = model.body_type.data;
const auto* const category = model.shape_category.data;
const auto* const accepts = model.shape_mask.data;
auto emit = [&](int shape, int other) {
    const int i = body_of[shape], j = body_of[other], kind = kind_of[i], other_kind = kind_of[j];
    if (i == j || (kind != DYNAMIC && other_kind != DYNAMIC)) return;
    if (!(category[shape] & accepts[other]) || !(category[other] & accepts[shape])) return;
    if (found < capacity) {
        // A is static, else the lower index
        const bool swap = shape < other ? other_kind == STATIC : kind != STATIC;
        temp_a[found] = swap ? other : shape;
        temp_b[found] = swap ? shape : other;
    }
    ++found;
};
// those of the sorted boxes from .. to that overlap q and whose index is below `until`
auto each_near = [&](int from, int to, Quad q, int until, auto visit) {
#if !defined(__CUDA_ARCH__)
    typedef Real Vector __attribute__((ext_vector_type(LANES), aligned(4)));
    typedef int Integers __attribute__((ext_vector_type(LANES), aligned(4)));
    typedef bool Booleans __attribute__((ext_vector_type(LANES)));
    for (int k = from; k < to; k += LANES) {
        const int at = k <= shapes - LANES ? k : shapes - LANES;  // nothing is read behind the last one
        auto lanes = [&](const Real* p) -> Vector { return *(const Vector*)(p + at); };
        const auto meets =
            (lanes(low_x) <= q.z) & (lanes(low_y) <= q.w) & (lanes(high_x) >= q.x) & (lanes(high_y) >= q.y);
        unsigned bits = __builtin_bit_cast(unsigned char, __builtin_convertvector(meets, Booleans));
        bits &= __builtin_bit_cast(unsigned char,
                                   __builtin_convertvector(*(const Integers*)(entry + at) < until, Booleans));
        bits &= ~0u << (k - at);
        if (to - at < LANES) bits &= (1u << (to - at)) - 1;
        for (; bits; bits &= bits - 1) visit(entry[at + __builtin_ctz(bits)]);
    }
#else
    for (int k = from; k < to; ++k)
        if (low_x[k] <= q.z && low_y[k] <= q.w && high_x[k] >= q.x && high_y[k] >= q.y && entry[k] < until)
            visit(entry[k]);
#endif
};
for (int shape = first; shape < last && sorted > 0; ++shape) {
    const int own_level = level_of(shape);
    if (own_level >= apart) continue;
    const Quad q = box(shape);
    auto is_covered = [](unsigned long long& word, unsigned long long bit) -> bool { return word & bit; };
    if (filter && own_level < 0 && !any_cell(q, 3, is_covered)) continue;
    // two that left are met by the one with the higher index
    const int until = own_level < 0 ? last : shape;
    const Real far_x = -q.x < q.z ? q.z : -q.x, far_y = -q.y < q.w ? q.w : -q.y;
    unsigned long long rest = levels;
    for (int level = 0; rest; ++level, rest >>= 1) {
        if (!(rest & 1)) continue;
        // cells whose boxes may reach this one, where centres are rounded
        const Real sx = sides_x[level], sy = sides_y[level], ix = inverses_x[level], iy = inverses_y[level];
        const Real reach_x = (Real)0.5 * sx + (Real)ROUNDING * (far_x + sx);
        const Real reach_y = (Real)0.5 * sy + (Real)ROUNDING * (far_y + sy);
        const int x0 = cell_of(q.x - reach_x, ix), columns = cell_of(q.z + reach_x, ix) - x0 + 1;
        const int y0 = cell_of(q.y - reach_y, iy), rows = cell_of(q.w + reach_y, iy) - y0 + 1;
        if ((double)columns * (double)rows > (double)sorted) {
            // more cells than boxes
            const Quad limit = bound(q);
            for (int i = 0; i < left && leaver[i] < until; ++i) {
                const int other = leaver[i];
                if (level_of(other) == level && other != shape && below(key(box(other)), limit)) emit(shape, other);
            }
            continue;
        }
        for (int y = y0; y < y0 + rows; ++y) {
            auto visit = [&](int from, int to) {
                const int end = to <= mask ? bucket[to + 1] : sorted;
                each_near(bucket[from + 1], end, q, until, [&](int other) {
                    const int* const c = cell(other);
                    // a bucket holds other cells, too
                    if (c[2] == level && c[1] == y && c[0] >= x0 && c[0] < x0 + columns) emit(shape, other);
                });
            };
            const int from = bucket_of(x0, y, level), to = from + (columns <= mask ? columns : mask + 1);
            visit(from, to <= mask + 1 ? to : mask + 1);
            if (to > mask + 1) visit(0, to - mask - 1);
        }
    }
}
for (int i = 0; i < left; ++i) {
    const int shape = leaver[i];
    if (level_of(shape) < apart) continue;
    const Quad limit = bound(box(shape));
    for (int other = first; other < last; ++other) {
        if (!below(key(box(other)), limit)) continue;
        if (other != shape && (level_of(other) < apart || other < shape)) emit(shape, other);
    }
}
return found;
