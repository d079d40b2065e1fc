// Of the pairs that are kept those whose boxes, swept over the step, overlap: candidates, a function of the state
// alone. Parameters: w, pairs.
const int start = pairs.start.data[w], end = start + pairs.near_count.data[w];
const int *const near_a = pairs.near_a.data, *const near_b = pairs.near_b.data;
int *const shape_a = pairs.shape_a.data, *const shape_b = pairs.shape_b.data;
int* const near_of = pairs.temp_b.data;
const auto* const swept = pairs.swept.data;
int n = start;
for (int i = start; i < end; ++i) {
    const int a = near_a[i], b = near_b[i];
    shape_a[n] = a;
    shape_b[n] = b;
    near_of[n] = i;
    n += below(key(load(swept + a)), bound(load(swept + b)));
}
pairs.count.data[w] = n - start;
