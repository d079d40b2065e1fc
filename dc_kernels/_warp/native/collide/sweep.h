// Boxes of the shapes of world w, swept over the step, into pairs.swept; those that left their box with margin into
// pairs.left, in the order of their index. Returns how many. Parameters: w, model, state, motion, pairs.
const int first = model.shape_start.data[w], last = model.shape_start.data[w + 1];
const Real dt = motion.step_dt.data[w];
// half the speculative distance on each side: a pair closer than it is found
const Real pad = (Real)0.5 * motion.reach.data[w];
const auto* const outer = pairs.box.data;
auto* const boxes = pairs.swept.data;
int* const leaver = pairs.left.data + first;
int left = 0;
for (int shape = first; shape < last; ++shape) {
    const Quad box = swept(box_of(shape, radius_of[shape]), velocity_of(shape), dt, 1, arm_of(shape), pad);
    store(boxes + shape, box);
    leaver[left] = shape;
    left += !below(key(load(outer + shape)), key(box));
}
return left;
