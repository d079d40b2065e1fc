// The box of each shape of world w, larger by boxes.margin on each side. Parameters: w, model, state, boxes.
Turned turned;
for (int shape = model.shape_start.data[w]; shape < model.shape_start.data[w + 1]; ++shape) {
    const Quad box = box_of(shape, model.shape_radius.data[shape] + boxes.margin, turned);
    Real* const lower = (Real*)(boxes.lower.data + shape);
    Real* const upper = (Real*)(boxes.upper.data + shape);
    lower[0] = box.x;
    lower[1] = box.y;
    upper[0] = box.z;
    upper[1] = box.w;
}
