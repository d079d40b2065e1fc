// Divides an image by the weights that it was added with: 0 where there are none.
#if !defined(__CUDA_ARCH__)
const size_t nodes = (size_t)image.shape[2] * image.shape[3];
const int bins = weight.shape[1], channels = image.shape[1] / bins;
for (int b = 0; b < bins; ++b) {
    const REAL* w = weight.data + ((size_t)world * bins + b) * nodes;
    for (int c = 0; c < channels; ++c) {
        REAL* p = image.data + ((size_t)world * image.shape[1] + b * channels + c) * nodes;
        for (size_t n = 0; n < nodes; ++n) p[n] = w[n] > 0 ? p[n] / w[n] : 0;
    }
}
#endif
