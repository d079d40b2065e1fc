// Boxes of shapes that move. Parameters: model, motion. Macro: DISC.
const auto* const predicted = motion.predicted.data;
const Real* const extents = model.shape_extent.data;
auto velocity_of = [=](int shape) -> const Real* { return (const Real*)(predicted + body_of[shape]); };
// bound on how far a rotation by one radian moves a point of the shape
auto arm_of = [=](int shape) -> Real {
    const Real* const center = (const Real*)(centers + shape);
    const Real arm = wp::abs(center[0]) + wp::abs(center[1]);
    return kind_of[shape] == DISC ? arm : arm + extents[shape];
};
// What a box covers that moves by v (x, y, spin) for some steps, the last of them as far as a gap may lie that the step
// closes along its normal: such gaps end on the circle whose diameter is the way. Larger by `grow` on each side.
auto swept = [=](Quad box, const Real* v, Real dt, Real steps, Real arm, Real grow) -> Quad {
    const Real x = v[0] * dt, y = v[1] * dt, way = wp::sqrt(x * x + y * y), half = (Real)0.5, before = steps - 1;
    const Quad circle = quad(half * (x - way), half * (y - way), half * (x + way), half * (y + way));
    const Quad zero = quad(0, 0, 0, 0);
    const Quad low = least(quad(x * before, y * before, 0, 0), zero),
               high = most(quad(0, 0, x * before, y * before), zero);
    const Real turn = wp::abs(v[2] * dt) * steps;
    grow += (turn < 2 ? turn : (Real)2) * arm;
    return box + circle + low + high + quad(-grow, -grow, grow, grow);
};
