// All arrays of one contact, from slot i of one group to slot k of another. Parameters: source, i, target, k. Macro:
// ROLLS, 1 where both groups have its impulse of rolling resistance.
target.key.data[k] = source.key.data[i];
target.body_a.data[k] = source.body_a.data[i];
target.body_b.data[k] = source.body_b.data[i];
target.normal.data[k] = source.normal.data[i];
target.arm_a.data[k] = source.arm_a.data[i];
target.arm_b.data[k] = source.arm_b.data[i];
target.gap.data[k] = source.gap.data[i];
target.friction.data[k] = source.friction.data[i];
target.restitution.data[k] = source.restitution.data[i];
target.impulse.data[k] = source.impulse.data[i];
target.color.data[k] = source.color.data[i];
target.age.data[k] = source.age.data[i];
#if ROLLS
target.rolling_impulse.data[k] = source.rolling_impulse.data[i];
#endif
