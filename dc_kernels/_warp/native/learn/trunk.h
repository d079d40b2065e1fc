// Image and trunk of a ContactNet of the k-th world read, in scratch memory: contacts are splatted by a cubic B-spline
// with all channels of a node side by side; each scale is a convolution of 3 x 3 of the mean of 2 x 2 nodes of the one
// before; on the way back a convolution reads the finer scale beside the coarser one, which is repeated 2 x 2 times. Of
// that a pixel sees 2 x 2 nodes, whose weights are sums of the 3 x 3, nine sets of them: by whether row and column are
// even, odd, or even and the last.
// Macros: CHANNELS, SCALES. Parameters: k, slot, network, reading. Behind prelude.h, grid/axis.h and learn/layers.h.
#if !defined(__CUDA_ARCH__)
const int scales = network.width.shape[0];
struct Map {
    Real* at;  // of pixel (0, 0)
    int rows, columns, pitch, row_pitch;
};
Real* memory = network.scratch.data + (size_t)slot * network.scratch.shape[1];
auto map_of = [&](int rows, int columns, int channels) {
    const int pitch = padded(channels), row_pitch = (columns + 2) * pitch;
    const Map map = {memory + row_pitch + pitch, rows, columns, pitch, row_pitch};
    memory += (size_t)(rows + 2) * row_pitch;
    return map;
};
const int image_rows = network.rows, image_columns = network.columns;
const Map image = map_of(image_rows, image_columns, CHANNELS);
const Real* weight = network.weight.data;

const int begin = reading.packed_start.data[k], end = reading.packed_start.data[k + 1];
const Real origin_x = ((const Real*)reading.grid_origin.data)[2 * k];
const Real origin_y = ((const Real*)reading.grid_origin.data)[2 * k + 1];
const Real per_spacing = 1 / network.spacing;
const int image_vectors = image.pitch / LANES;
for (int y = 0; y < image_rows; ++y) {
    Real* const row = image.at + (size_t)y * image.row_pitch;
    for (int i = 0; i < image_columns * image.pitch; i += LANES) *(Vector*)(row + i) = zero;
}
for (int m = begin; m < end; ++m) {
    const Real* const place = (const Real*)reading.place.data + 2 * (size_t)m;
    const Real u = (place[0] - origin_x) * per_spacing, v = (place[1] - origin_y) * per_spacing;
    if (!(u - u == 0 && v - v == 0)) continue;
    Real wx[4], wy[4], slope[4];
    int column, columns, row, rows;
    spline(u, image_columns, column, columns, wx, slope);
    spline(v, image_rows, row, rows, wy, slope);
    Vector value[CHANNELS / LANES + 1];
    const Real* const own = reading.image_value.data + (size_t)m * CHANNELS;
#pragma unroll
    for (int i = 0; i < CHANNELS / LANES; ++i) value[i] = load(own + i * LANES);
    value[CHANNELS / LANES] = zero;
#pragma unroll
    for (int c = CHANNELS / LANES * LANES; c < CHANNELS; ++c) value[CHANNELS / LANES][c % LANES] = own[c];
    for (int j = 0; j < rows; ++j) {
        Real* to = image.at + (size_t)(row + j) * image.row_pitch + column * image.pitch;
        for (int i = 0; i < columns; ++i, to += image.pitch)
#pragma unroll
            for (int n = 0; n < (CHANNELS + LANES - 1) / LANES; ++n)
                *(Vector*)(to + n * LANES) += value[n] * (wx[i] * wy[j]);
    }
}

// `bias`, then weights: one block of outputs after the other, two vectors wide where there are two
auto each_block = [&](int channels, auto run) {
    for (int v = 0; v < padded(channels) / LANES;) {
        const int vectors = (v + 1) * LANES < channels ? 2 : 1;
        run(vectors, v * LANES);
        v += vectors;
    }
};
auto around = [&](Source& source, const Map& map) {
    source.places = 9;
    for (int t = 0; t < 9; ++t) source.place[t] = (t / 3 - 1) * map.row_pitch + (t % 3 - 1) * map.pitch;
};
auto halved = [&](const Map& fine, int channels) {
    const Map map = map_of((fine.rows + 1) / 2, (fine.columns + 1) / 2, channels);
    for (int y = 0; y < map.rows; ++y) {
        const Real* above = fine.at + (size_t)2 * y * fine.row_pitch;
        const Real* below = 2 * y + 1 < fine.rows ? above + fine.row_pitch : above;
        Real* to = map.at + (size_t)y * map.row_pitch;
        for (int x = 0; x < map.columns; ++x, above += 2 * fine.pitch, below += 2 * fine.pitch) {
            const int right = 2 * x + 1 < fine.columns ? fine.pitch : 0;
            for (int c = 0; c < map.pitch; c += LANES, to += LANES)
                store(to, (load(above + c) + load(above + c + right) + load(below + c) + load(below + c + right)) *
                              (Real)0.25);
        }
    }
    return map;
};
Map kept[SCALES];
int coming = CHANNELS;
for (int l = 0; l < scales; ++l) {
    const int channels = network.width.data[l];
    const Map input = l == 0 ? image : halved(kept[l - 1], coming);
    const Map map = kept[l] = map_of(input.rows, input.columns, channels);
    each_block(channels, [&](int vectors, int first) {
        Source source;
        source.weight = weight + vectors * LANES;
        source.step = input.pitch;
        source.channels = coming;
        around(source, input);
        for (int y = 0; y < map.rows; ++y) {
            source.from = input.at + (size_t)y * input.row_pitch;
            sum_row(vectors, map.columns, &source, 1, weight, map.at + (size_t)y * map.row_pitch + first, map.pitch, 0);
        }
        weight += (1 + 9 * coming) * vectors * LANES;
    });
    coming = channels;
}
Map trunk = kept[scales - 1];
for (int l = scales - 2; l >= 0; --l) {
    const int channels = network.width.data[l];
    const Map fine = kept[l], coarse = trunk, map = map_of(fine.rows, fine.columns, channels);
    each_block(channels, [&](int vectors, int first) {
        Source source[2];
        source[0].weight = weight + vectors * LANES;
        source[0].step = 2 * fine.pitch;
        source[0].channels = channels;
        around(source[0], fine);
        source[1].step = coarse.pitch;
        source[1].channels = coming;
        source[1].places = 4;
        for (int t = 0; t < 4; ++t) source[1].place[t] = t / 2 * coarse.row_pitch + t % 2 * coarse.pitch;
        const int set = 4 * coming * vectors * LANES;
        const Real* const sets = weight + (1 + 9 * channels) * vectors * LANES;
        const bool odd_row = map.rows % 2, odd_column = map.columns % 2;
        for (int y = 0; y < map.rows; ++y) {
            const int down = y % 2 ? 1 : (odd_row && y == map.rows - 1 ? 2 : 0);
            for (int across = 0; across < 2 + odd_column; ++across) {
                const int x = across < 2 ? across : map.columns - 1;
                const int count = across < 2 ? map.columns / 2 : 1;
                source[0].from = fine.at + (size_t)y * fine.row_pitch + x * fine.pitch;
                source[1].from = coarse.at + ((y + 1) / 2 - 1) * coarse.row_pitch + ((x + 1) / 2 - 1) * coarse.pitch;
                source[1].weight = sets + (down * 3 + across) * set;
                sum_row(vectors, count, source, 2, weight, map.at + (size_t)y * map.row_pitch + x * map.pitch + first,
                        2 * map.pitch, 0);
            }
        }
        weight = sets + 9 * set;
    });
    coming = channels;
    trunk = map;
}
#endif
