// Image of the contacts of the k-th world read, all channels of a node side by side.
// Macros: CHANNELS. Parameters: k, network, reading. Behind learn/maps.h.
#if !defined(__CUDA_ARCH__)
const int begin = reading.packed_start.data[k], end = reading.packed_start.data[k + 1];
const Real origin_x = ((const Real*)reading.grid_origin.data)[2 * k];
const Real origin_y = ((const Real*)reading.grid_origin.data)[2 * k + 1];
const Real per_spacing = 1 / network.spacing;
for (int m = begin; m < end; ++m) {
    const Real* const place = (const Real*)reading.place.data + 2 * (size_t)m;
    Vector value[CHANNELS / LANES + 1];
    const Real* const own = reading.image_value.data + (size_t)m * CHANNELS;
#pragma unroll
    for (int i = 0; i < CHANNELS / LANES; ++i) value[i] = load(own + i * LANES);
    value[CHANNELS / LANES] = zero;
#pragma unroll
    for (int c = CHANNELS / LANES * LANES; c < CHANNELS; ++c) value[CHANNELS / LANES][c % LANES] = own[c];
    splat((place[0] - origin_x) * per_spacing, (place[1] - origin_y) * per_spacing, value);
}
#endif
