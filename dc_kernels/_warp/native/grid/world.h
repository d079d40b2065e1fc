// A world's whole image as the target of a splat, after the bands that the call before touched are cleared.
// Macro: BAND.
#if !defined(__CUDA_ARCH__)
const int channels = value.shape[1];
const int bands = touched.shape[1];
int* const marks = touched.data + (size_t)world * bands;
const size_t row_stride = columns, channel_stride = (size_t)rows * columns;
Real* const base = image.data + (size_t)world * image.shape[1] * channel_stride;
const int row_low = 0, row_high = rows, column_low = 0, column_high = columns, left = 0;
const int begin = points.start.data[world], end = begin + points.count.data[world];
for (int b = 0; b < bands; ++b) {
    if (!marks[b]) continue;
    marks[b] = 0;
    const size_t from = (size_t)b * BAND * columns;
    const size_t until = (b + 1) * BAND < rows ? from + (size_t)BAND * columns : channel_stride;
    for (int c = channel_offset; c < channel_offset + bins * channels; ++c)
        for (size_t n = from; n < until; ++n) base[c * channel_stride + n] = 0;
}
auto mark = [&](int from, int until) {
    for (int b = from / BAND; b <= until / BAND; ++b) marks[b] = 1;
};
auto item = [](int k) { return k; };
#endif
