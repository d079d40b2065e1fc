// Head of a StepNet: what bodies read of the trunk, then rounds along the contacts. In each a contact sees how its
// bodies move, what the trunk and the other contacts say at both, and changes its impulse, which stays on its cone and
// moves the bodies; CHUNK contacts at a time. Macros: MOTION, ANSWER (numbers), CHUNK, and those of learn/step_image.h.
// Parameters: network, state, contacts, motion, asking. Behind learn/trunk.h.
#if !defined(__CUDA_ARCH__)
const int inputs = 2 * near_pitch + 3 * hidden_pitch + MOTION, input_pitch = padded(inputs);
int pitch = padded(network.kept + ANSWER);
if (pitch < padded(network.wide)) pitch = padded(network.wide);
if (pitch < near_pitch) pitch = near_pitch;
Real* const given = memory;
Real* const middle = given + (size_t)CHUNK * (input_pitch > trunk.pitch ? input_pitch : trunk.pitch);
Real* const found = middle + (size_t)CHUNK * pitch;
const Real* const near_weight = weight;
for (int from = 0; from < bodies; from += CHUNK) {
    const int most = bodies - from < CHUNK ? bodies - from : CHUNK;
    for (int i = 0; i < most; ++i) {
        const wp::vec_t<2, Real> place = state.position.data[first_body + from + i];
        gather(trunk, across(0, place[0]), across(1, place[1]), given + (size_t)i * trunk.pitch);
    }
    weight = near_weight;
    layer(most, given, trunk.pitch, network.width.data[0], network.near, middle, pitch, no_least);
    for (int i = 0; i < most; ++i) {
        Real* const own = body_at(first_body + from + i);
        for (int c = 0; c < near_pitch; c += LANES)
            store(own + BODY_SEEN + c, own[BODY_MASS] > 0 ? load(middle + (size_t)i * pitch + c) : zero);
    }
}
// How a contact moves, and what it carries.
auto moving = [&](int i, Real* to) {
    const Real* const own = contact_at(i);
    const Real *const a = body_at(contacts.body_a.data[first + i]), *const b = body_at(contacts.body_b.data[first + i]);
    const Pair moves = relative(own, a + BODY_NOW, b + BODY_NOW);
    const Real left = moves.n + own[CONTACT_GAP], give = own[CONTACT_GIVE];
    to[0] = left;
    to[1] = left > 0 ? 0 : left;
    to[2] = moves.t;
    to[3] = own[CONTACT_IMPULSE] * give;
    to[4] = own[CONTACT_IMPULSE + 1] * own[CONTACT_GIVE + 1];
    to[5] = own[CONTACT_GAP];
    to[6] = moves.n;
    to[7] = a[BODY_MASS] / give;
    to[8] = b[BODY_MASS] / give;
    to[9] = contacts.friction.data[first + i];
};
const Real* const first_weight = weight;
for (int from = 0; from < count; from += CHUNK) {
    const int most = count - from < CHUNK ? count - from : CHUNK;
    for (int i = 0; i < most; ++i) moving(from + i, given + (size_t)i * input_pitch);
    weight = first_weight;
    layer(most, given, input_pitch, MOTION, network.kept, found, pitch, 0);
    for (int i = 0; i < most; ++i)
        for (int c = 0; c < hidden_pitch; c += LANES)
            store(contact_at(from + i) + CONTACT_HIDDEN + c, load(found + (size_t)i * pitch + c));
}
const int heard = BODY_SEEN + near_pitch;
for (int round = 0; round < network.rounds; ++round) {
    for (int b = first_body; b < first_body + bodies; ++b)
        for (int c = 0; c < hidden_pitch; c += LANES) store(body_at(b) + heard + c, zero);
    for (int i = 0; i < count; ++i) {
        const Real* const hidden = contact_at(i) + CONTACT_HIDDEN;
        for (int side = 0; side < 2; ++side) {
            Real* const own = body_at((side == 0 ? contacts.body_a : contacts.body_b).data[first + i]);
            if (own[BODY_MASS] > 0)
                for (int c = 0; c < hidden_pitch; c += LANES)
                    store(own + heard + c, load(own + heard + c) + load(hidden + c));
        }
    }
    const Real* const round_weight = weight;
    for (int from = 0; from < count; from += CHUNK) {
        const int most = count - from < CHUNK ? count - from : CHUNK;
        for (int i = 0; i < most; ++i) {
            Real* row = given + (size_t)i * input_pitch;
            const int m = first + from + i;
            const Real* const bodies_of[2] = {body_at(contacts.body_a.data[m]), body_at(contacts.body_b.data[m])};
            const Real* const hidden = contact_at(from + i) + CONTACT_HIDDEN;
            for (const Real* body : bodies_of)
                for (int c = 0; c < near_pitch; c += LANES, row += LANES) store(row, load(body + BODY_SEEN + c));
            for (int c = 0; c < hidden_pitch; c += LANES, row += LANES) store(row, load(hidden + c));
            for (const Real* body : bodies_of)
                for (int c = 0; c < hidden_pitch; c += LANES, row += LANES)
                    store(row, load(body + heard + c) - load(hidden + c));
            moving(from + i, row);
        }
        weight = round_weight;
        layer(most, given, input_pitch, inputs, network.wide, middle, pitch, 0);
        layer(most, middle, pitch, network.wide, network.kept + ANSWER, found, pitch, no_least);
        for (int i = 0; i < most; ++i) {
            Real *const own = contact_at(from + i), *const said = found + (size_t)i * pitch;
            const Real *const seen = given + (size_t)i * input_pitch + inputs - MOTION, *const by = said + network.kept;
            const Real friction = contacts.friction.data[first + from + i];
            const Real step = by[2] - seen[0] / (1 + wp::exp(-by[0])), slip = by[3] - seen[2] / (1 + wp::exp(-by[1]));
            Real n = own[CONTACT_IMPULSE] + step / own[CONTACT_GIVE];
            Real t = own[CONTACT_IMPULSE + 1] + slip / own[CONTACT_GIVE + 1];
            n = n < 0 ? 0 : n;  // NaN stays
            const Real limit = friction * n;
            t = t > limit ? limit : (t < -limit ? -limit : t);
            own[CONTACT_IMPULSE] = n;
            own[CONTACT_IMPULSE + 1] = t;
            for (int c = 0; c < network.kept; ++c) own[CONTACT_HIDDEN + c] = said[c] < 0 ? 0 : said[c];
        }
    }
    for (int b = first_body; b < first_body + bodies; ++b) {
        Real* const own = body_at(b);
        for (int i = 0; i < 3; ++i) own[BODY_NOW + i] = own[BODY_WAY + i];
    }
    for (int i = 0; i < count; ++i) {
        const Real* const own = contact_at(i);
        Real *const a = body_at(contacts.body_a.data[first + i]), *const b = body_at(contacts.body_b.data[first + i]);
        const Real n = own[CONTACT_IMPULSE], t = own[CONTACT_IMPULSE + 1];
        const Real nx = own[CONTACT_NORMAL], ny = own[CONTACT_NORMAL + 1], x = n * nx + t * ny, y = n * ny - t * nx;
        a[BODY_NOW] -= x * a[BODY_MASS];
        a[BODY_NOW + 1] -= y * a[BODY_MASS];
        a[BODY_NOW + 2] -= (n * own[CONTACT_TURN_A] + t * own[CONTACT_SPIN_A]) * a[BODY_INERTIA];
        b[BODY_NOW] += x * b[BODY_MASS];
        b[BODY_NOW + 1] += y * b[BODY_MASS];
        b[BODY_NOW + 2] += (n * own[CONTACT_TURN_B] + t * own[CONTACT_SPIN_B]) * b[BODY_INERTIA];
    }
}
for (int b = first_body; b < first_body + bodies; ++b) {
    const Real* const own = body_at(b);
    for (int i = 0; i < 3; ++i)
        asking.velocity.data[b][i] = own[BODY_MASS] > 0 ? own[BODY_NOW + i] * speed : motion.predicted.data[b][i];
}
for (int i = 0; i < count; ++i)
    for (int c = 0; c < 2; ++c) contacts.impulse.data[first + i][c] = contact_at(i)[CONTACT_IMPULSE + c] * speed;
#endif
