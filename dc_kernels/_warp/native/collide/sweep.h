// Boxes of the shapes of world w, but for its empty slots at the end, swept over the step, into pairs.swept. Where one
// has left its box with margin, those that have, and those that come closer to its sides than `spare`, into pairs.left,
// in the order of their index: what would soon leave does so at once. Returns how many. Parameters: w, spare, model,
// state, motion, pairs, team. Stands behind runtime/ranges.h.
const int first = model.shape_start.data[w], last = model.shape_start.data[w + 1] - pairs.empty_shapes.data[w];
const Real dt = motion.step_dt.data[w];
// half the speculative distance on each side: a pair closer than it is found
const Real pad = (Real)0.5 * motion.reach.data[w];
const auto* const outer = pairs.box.data;
auto* const boxes = pairs.swept.data;
int* const leaver = pairs.left.data + first;
Real* const turn = (Real*)pairs.turn.data;
// the shape of a slot that was emptied keeps the boxes that it has been given since, as it rests and meets nothing
const int attic = pairs.valid.data[w] ? pairs.attic.data[w] - 1 : -1;
const Real parked = (Real)1e30;
const bool keeps = pairs.turn.shape[0] > 0;
int left = add_range(team, first, last, 1024, [=](int from, int to) {
    Turned turned;
    int gone = 0;
    for (int shape = from; shape < to; ++shape) {
        if (body_of[shape] == attic && ((const Real*)(outer + shape))[0] < parked) continue;
        const Quad box = swept(box_of(shape, radius_of[shape], turned), velocity_of(shape), dt, 1, arm_of(shape), pad);
        if (keeps && turned.body == body_of[shape]) {
            turn[2 * turned.body] = turned.cosine;
            turn[2 * turned.body + 1] = turned.sine;
        }
        store(boxes + shape, box);
        gone += !below(key(load(outer + shape)), key(box));
    }
    return gone;
});
if (left == 0) return 0;
left = 0;
for (int shape = first; shape < last; ++shape) {
    leaver[left] = shape;
    left += !below(key(load(outer + shape)) + quad(spare, spare, spare, spare), key(load(boxes + shape)));
}
return left;
