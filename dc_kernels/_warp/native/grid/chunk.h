// A chunk of a world's points and its image, to gather from. Macro: CHUNK.
#if !defined(__CUDA_ARCH__)
const int channels = value.shape[1];
const size_t row_stride = columns, channel_stride = (size_t)rows * columns;
const Real* const base = image.data + (size_t)world * image.shape[1] * channel_stride;
const int begin = points.start.data[world] + chunk * CHUNK;
const int last = points.start.data[world] + points.count.data[world];
const int end = begin + CHUNK < last ? begin + CHUNK : last;
auto item = [](int k) { return k; };
auto image_of = [&](int i) {
    return base + (size_t)(channel_offset + (bins > 1 ? points.bin.data[i] * channels : 0)) * channel_stride;
};
#endif
