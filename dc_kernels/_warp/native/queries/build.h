// Sorts the shapes of each world along a curve through the plane, the large ones behind the small (Morton 1966), and
// puts boxes around 8 at a time, level by level. A box that is not finite is never met. Macros: LANES, ROUNDING.
#if !defined(__CUDA_ARCH__)
typedef unsigned Key;
auto spread = [](Key v) {
    v = (v | (v << 8)) & 0x00ff00ffu;
    v = (v | (v << 4)) & 0x0f0f0f0fu;
    v = (v | (v << 2)) & 0x33333333u;
    return (v | (v << 1)) & 0x55555555u;
};
auto cell = [](Real x, Real low, Real per_cell) -> Key {
    const Real c = (x - low) * per_cell;
    return c > 0 ? (c < 16383 ? (Key)c : 16383u) : 0u;
};
for (int w = world_offset; w < world_offset + worlds; ++w) {
    const int first = model.shape_start.data[w], n = model.shape_start.data[w + 1] - first;
    int level[MAX_LEVELS], children[MAX_LEVELS];
    const int levels = levels_of(w, level, children);
    if (levels == 0) continue;
    Real left = 0, right = 0, bottom = 0, top = 0;
    bool any = false;
    for (int s = first; s < first + n; ++s) {
        const Real x = (boxes.lower.data[s][0] + boxes.upper.data[s][0]) / 2;
        const Real y = (boxes.lower.data[s][1] + boxes.upper.data[s][1]) / 2;
        if (!(x - x == 0 && y - y == 0)) continue;
        left = !any || x < left ? x : left;
        right = !any || x > right ? x : right;
        bottom = !any || y < bottom ? y : bottom;
        top = !any || y > top ? y : top;
        any = true;
    }
    const Real wide = right - left > top - bottom ? right - left : top - bottom;
    const Real per_cell = wide > 0 ? 16384 / wide : 0;
    // two halves of the scratch: a key and a shape in each number
    unsigned long long *from = (unsigned long long*)scratch.data + 2 * (size_t)first, *to = from + n;
    for (int s = first; s < first + n; ++s) {
        const Real x = (boxes.lower.data[s][0] + boxes.upper.data[s][0]) / 2;
        const Real y = (boxes.lower.data[s][1] + boxes.upper.data[s][1]) / 2;
        const Real size = size_of(boxes.upper.data[s][0] - x) + size_of(boxes.upper.data[s][1] - y);
        Key key = spread(cell(x, left, per_cell)) | (spread(cell(y, bottom, per_cell)) << 1);
        key |= ((Key)(size * 64 > wide) + (Key)(size * 16 > wide) + (Key)(size * 4 > wide)) << 28;
        from[s - first] = ((unsigned long long)key << 32) | (unsigned)s;
    }
    if (n <= 64) {
        for (int i = 1; i < n; ++i) {
            const unsigned long long mine = from[i];
            int j = i;
            for (; j > 0 && from[j - 1] > mine; --j) from[j] = from[j - 1];
            from[j] = mine;
        }
    } else {
        for (int pass = 0; pass < 3; ++pass) {  // 10 bits at a time
            const int shift = 32 + 10 * pass;
            int count[1025] = {0};
            for (int i = 0; i < n; ++i) ++count[((from[i] >> shift) & 1023) + 1];
            for (int k = 0; k < 1024; ++k) count[k + 1] += count[k];
            for (int i = 0; i < n; ++i) to[count[(from[i] >> shift) & 1023]++] = from[i];
            unsigned long long* other = from;
            from = to;
            to = other;
        }
    }
    for (int l = 0; l < levels; ++l) {
        for (int child = 0; child < (children[l] + LANES - 1) / LANES * LANES; ++child) {
            Real a = 0, b = 0, c = -1, d = -1;  // an empty lane is left out by the number of children
            if (child < children[l] && l == 0) {
                const int s = (int)(unsigned)from[child];
                tree.sorted_shape.data[(size_t)level[0] * LANES + child] = s;
                a = boxes.lower.data[s][0];
                b = boxes.lower.data[s][1];
                c = boxes.upper.data[s][0];
                d = boxes.upper.data[s][1];
                const Real slack = ROUNDING * (size_of(a) + size_of(b) + size_of(c) + size_of(d));
                a -= slack;
                b -= slack;
                c += slack;
                d += slack;
            } else if (child < children[l]) {
                const Real* inner = tree.box.data + (size_t)(level[l - 1] + child) * 4 * LANES;
                const int rest = children[l - 1] - child * LANES;
                bool any = false;
                for (int q = 0; q < (rest < LANES ? rest : LANES); ++q) {
                    if (!(inner[q] <= inner[2 * LANES + q] && inner[LANES + q] <= inner[3 * LANES + q])) continue;
                    a = !any || inner[q] < a ? inner[q] : a;
                    b = !any || inner[LANES + q] < b ? inner[LANES + q] : b;
                    c = !any || inner[2 * LANES + q] > c ? inner[2 * LANES + q] : c;
                    d = !any || inner[3 * LANES + q] > d ? inner[3 * LANES + q] : d;
                    any = true;
                }
            }
            Real* box = tree.box.data + ((size_t)level[l] + child / LANES) * 4 * LANES + child % LANES;
            box[0] = a;
            box[LANES] = b;
            box[2 * LANES] = c;
            box[3 * LANES] = d;
        }
    }
}
#endif
