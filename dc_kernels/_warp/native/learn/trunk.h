// Trunk of a network, on its image: each scale is a convolution of 3 x 3 of the mean of 2 x 2 nodes of the one before;
// on the way back a convolution reads the finer scale beside the coarser one, which is repeated 2 x 2 times. Of that a
// pixel sees 2 x 2 nodes, whose weights are sums of the 3 x 3, nine sets of them: by whether row and column are even,
// odd, or even and the last. Macros: CHANNELS, SCALES. Parameters: network. Behind learn/maps.h.
#if !defined(__CUDA_ARCH__)
const int scales = network.width.shape[0];
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
