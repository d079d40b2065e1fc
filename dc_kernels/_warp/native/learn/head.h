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
            gather(trunk, (place[0] - origin_x) * per_spacing, (place[1] - origin_y) * per_spacing,
                   row + p * trunk.pitch);
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
        layer(count, now, pitch, channels, width, next, hidden_pitch, l < layers ? (Real)0 : no_least);
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
