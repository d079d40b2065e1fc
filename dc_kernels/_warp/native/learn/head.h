// Head of a ContactNet at the contacts of the k-th world read: it reads the trunk at the contact and at the centres of
// both its bodies, bilinearly, and the contact's own features; CHUNK contacts at a time.
// Macros: LOCAL, OUTPUT, STEPS (leading outputs, to which the share is added), CHUNK. Parameters: network, reading,
// output. Behind learn/trunk.h.
#if !defined(__CUDA_ARCH__)
const int inputs = 3 * trunk.pitch + LOCAL, input_pitch = padded(inputs);
int hidden_pitch = LANES;
for (int l = 0; l < network.hidden.shape[0]; ++l) {
    const int pitch = padded(network.hidden.data[l]);
    if (pitch > hidden_pitch) hidden_pitch = pitch;
}
Real* const given = memory;
Real* const first_half = given + (size_t)CHUNK * input_pitch;
Real* const second_half = first_half + (size_t)CHUNK * hidden_pitch;
const Real* const head_weight = weight;
const Real* const places[3] = {(const Real*)reading.place.data, (const Real*)reading.place_a.data,
                               (const Real*)reading.place_b.data};
for (int from = begin; from < end; from += CHUNK) {
    const int count = end - from < CHUNK ? end - from : CHUNK;
    for (int i = 0; i < count; ++i) {
        Real* const row = given + (size_t)i * input_pitch;
        for (int p = 0; p < 3; ++p) {
            const Real* const place = places[p] + 2 * (size_t)(from + i);
            Real u = (place[0] - origin_x) * per_spacing, v = (place[1] - origin_y) * per_spacing;
            const bool valid = u - u == 0 && v - v == 0;
            u = clip(valid ? u : 0, 0, image_columns - 1);
            v = clip(valid ? v : 0, 0, image_rows - 1);
            const int x = u < image_columns - 2 ? (int)u : image_columns - 2;
            const int y = v < image_rows - 2 ? (int)v : image_rows - 2;
            const Real tx = u - x, ty = v - y, whole = valid ? 1 : 0;
            const Real* const q = trunk.at + (size_t)y * trunk.row_pitch + x * trunk.pitch;
            for (int c = 0; c < trunk.pitch; c += LANES) {
                const Vector low = load(q + c) * ((1 - tx) * (1 - ty)) + load(q + c + trunk.pitch) * (tx * (1 - ty));
                const Real* const r = q + c + trunk.row_pitch;
                const Vector high = load(r) * ((1 - tx) * ty) + load(r + trunk.pitch) * (tx * ty);
                store(row + p * trunk.pitch + c, (low + high) * whole);
            }
        }
        const Real* const own = reading.local.data + (size_t)(from + i) * LOCAL;
        for (int c = 0; c < LOCAL; ++c) row[3 * trunk.pitch + c] = own[c];
    }
    weight = head_weight;
    Real *now = given, *next = first_half;
    int channels = inputs, pitch = input_pitch;
    const int layers = network.hidden.shape[0];
    for (int l = 0; l <= layers; ++l) {
        const int width = l < layers ? network.hidden.data[l] : OUTPUT;
        each_block(width, [&](int vectors, int first) {
            Source source;
            source.from = now;
            source.weight = weight + vectors * LANES;
            source.step = pitch;
            source.channels = channels;
            source.places = 1;
            source.place[0] = 0;
            // contacts that are not there fill the last block
            const int wide = vectors == 2 ? 6 : 8;
            sum_row(vectors, (count + wide - 1) / wide * wide, &source, 1, weight, next + first, hidden_pitch,
                    l < layers ? (Real)0 : no_least);
            weight += (1 + channels) * vectors * LANES;
        });
        channels = width;
        pitch = hidden_pitch;
        now = next;
        next = next == first_half ? second_half : first_half;
    }
    for (int i = 0; i < count; ++i) {
        Real* const to = output.data + (size_t)(from + i) * OUTPUT;
        for (int c = 0; c < OUTPUT; ++c) to[c] = now[(size_t)i * hidden_pitch + c] + (c < STEPS ? network.share : 0);
    }
}
#endif
