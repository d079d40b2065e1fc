// New boxes with margin for the `left` shapes of world w in pairs.left, or for all where `left` is that many.
// Parameters: w, left, margin, model, state, motion, pairs. Macros: PREDICT_STEPS, FAST_STEPS.
const int first = model.shape_start.data[w], shapes = model.shape_start.data[w + 1] - first;
const Real dt = motion.step_dt.data[w], reach = motion.reach.data[w];
int* const leaver = pairs.left.data + first;
Turned turned;
for (int i = 0; i < left; ++i) {
    if (left == shapes) leaver[i] = first + i;
    const int shape = leaver[i];
    const Real* const v = velocity_of(shape);
    const bool fast = (v[0] * v[0] + v[1] * v[1]) * dt * dt > (Real)1.1 * reach * reach;
    const Quad box = box_of(shape, radius_of[shape], turned);
    store(pairs.box.data + shape, swept(box, v, dt, fast ? FAST_STEPS : PREDICT_STEPS, arm_of(shape), margin));
}
