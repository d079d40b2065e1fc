// A tile's buffer as the target of a splat; clears a tile that no point reaches now and one did at the call before.
// Macros: TILE_ROWS, TILE_COLUMNS, AHEAD (points that are fetched ahead of their use).
#if !defined(__CUDA_ARCH__)
const int channels = value.shape[1];
const int within_world = tile - world * world_tiles;
const int row_low = within_world / across * TILE_ROWS, column_low = within_world % across * TILE_COLUMNS;
const int row_high = row_low + TILE_ROWS < rows ? row_low + TILE_ROWS : rows;
const int column_high = column_low + TILE_COLUMNS < columns ? column_low + TILE_COLUMNS : columns;
const int begin = tiles.start.data[tile], end = tiles.start.data[tile + 1];
const size_t nodes = (size_t)rows * columns;
const int all_channels = bins * channels;
Real* const target = image.data + ((size_t)world * image.shape[1] + channel_offset) * nodes;
tiles.lost.data[tile] = 0;
if (begin == end) {
    if (tiles.touched.data[tile])
        for (int c = 0; c < all_channels; ++c)
            for (int r = row_low; r < row_high; ++r)
                for (int n = column_low; n < column_high; ++n) target[c * nodes + (size_t)r * columns + n] = 0;
    tiles.touched.data[tile] = 0;
    return;
}
tiles.touched.data[tile] = 1;
// a window reaches into the tile from no farther away than its own width
const int pad = stencil.kernel > WENDLAND ? LANES : ((int)(2 * hs) / LANES + 1) * LANES;
const int left = column_low - pad, row_stride = TILE_COLUMNS + 2 * pad;
const size_t channel_stride = (size_t)row_stride * TILE_ROWS;
Real* const buffer = tiles.scratch.data + (size_t)slot * tiles.scratch.shape[1];
Real* const base = buffer - channel_offset * channel_stride;
for (size_t n = 0; n < all_channels * channel_stride; ++n) buffer[n] = 0;
auto mark = [](int, int) {};
auto item = [&](int k) {
    const size_t next = tiles.order.data[k + AHEAD];
    __builtin_prefetch(places + pitch * next);
    __builtin_prefetch(value.data + next * channels);
    return tiles.order.data[k];
};
#endif
