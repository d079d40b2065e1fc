// Images of the k-th world at work in scratch memory, what points add to them and read of them, and layers whose
// weights are read one after the other. Macros: CHANNELS (of the network's image). Parameters: slot, network. Behind
// prelude.h, grid/axis.h and learn/layers.h.
#if !defined(__CUDA_ARCH__)
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
const int image_vectors = (CHANNELS + LANES - 1) / LANES;
const Map image = map_of(network.rows, network.columns, CHANNELS);
for (int y = 0; y < image.rows; ++y) {
    Real* const row = image.at + (size_t)y * image.row_pitch;
    for (int i = 0; i < image.columns * image.pitch; i += LANES) *(Vector*)(row + i) = zero;
}
// Adds values to the image, by a cubic B-spline at a point in spacings; one that is no number adds nothing.
auto splat = [&](Real u, Real v, const Vector* value) {
    if (!(u - u == 0 && v - v == 0)) return;
    Real wx[4], wy[4], slope[4];
    int column, columns, row, rows;
    spline(u, image.columns, column, columns, wx, slope);
    spline(v, image.rows, row, rows, wy, slope);
    for (int j = 0; j < rows; ++j) {
        Real* to = image.at + (size_t)(row + j) * image.row_pitch + column * image.pitch;
        for (int i = 0; i < columns; ++i, to += image.pitch)
#pragma unroll
            for (int n = 0; n < image_vectors; ++n) *(Vector*)(to + n * LANES) += value[n] * (wx[i] * wy[j]);
    }
};
// Reads what a map has at a point in spacings, bilinearly; zeros at one that is no number.
auto gather = [&](const Map& map, Real u, Real v, Real* to) {
    const bool valid = u - u == 0 && v - v == 0;
    u = clip(valid ? u : 0, 0, map.columns - 1);
    v = clip(valid ? v : 0, 0, map.rows - 1);
    const int x = u < map.columns - 2 ? (int)u : map.columns - 2;
    const int y = v < map.rows - 2 ? (int)v : map.rows - 2;
    const Real tx = u - x, ty = v - y, whole = valid ? 1 : 0;
    const Real* const q = map.at + (size_t)y * map.row_pitch + x * map.pitch;
    for (int c = 0; c < map.pitch; c += LANES) {
        const Vector low = load(q + c) * ((1 - tx) * (1 - ty)) + load(q + c + map.pitch) * (tx * (1 - ty));
        const Real* const r = q + c + map.row_pitch;
        const Vector high = load(r) * ((1 - tx) * ty) + load(r + map.pitch) * (tx * ty);
        store(to + c, (low + high) * whole);
    }
};
const Real* weight = network.weight.data;
// `bias`, then weights: one block of outputs after the other, two vectors wide where there are two
auto each_block = [&](int channels, auto run) {
    for (int v = 0; v < padded(channels) / LANES;) {
        const int vectors = (v + 1) * LANES < channels ? 2 : 1;
        run(vectors, v * LANES);
        v += vectors;
    }
};
// A layer of what lies at `from`, `step` numbers from one point to the next, for up to CHUNK points; there is room for
// CHUNK, as points that are not there fill the last block.
auto layer = [&](int count, const Real* from, int step, int inputs, int outputs, Real* to, int to_step, Real least) {
    each_block(outputs, [&](int vectors, int first) {
        Source source;
        source.from = from;
        source.weight = weight + vectors * LANES;
        source.step = step;
        source.channels = inputs;
        source.places = 1;
        source.place[0] = 0;
        const int wide = vectors == 2 ? 6 : 8;
        sum_row(vectors, (count + wide - 1) / wide * wide, &source, 1, weight, to + first, to_step, least);
        weight += (1 + inputs) * vectors * LANES;
    });
};
#endif
