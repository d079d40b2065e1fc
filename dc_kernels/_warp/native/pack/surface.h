// What the surfaces of contact c are like. Parameters: w, model, contacts. Macros: SHAPE_BITS and FEATURE_BITS of a
// key.
auto shapes_of = [&](int c, int& a, int& b) {
    const long long key = contacts.key.data[c], mask = (1ll << SHAPE_BITS) - 1;
    const int first = model.shape_start.data[w];
    a = first + (int)((key >> (SHAPE_BITS + FEATURE_BITS)) & mask);
    b = first + (int)((key >> FEATURE_BITS) & mask);
};
// Tangential speed of the surface of B against that of A where the bodies rest [m/s].
auto slip_of = [&](int c) {
    int a, b;
    shapes_of(c, a, b);
    return -(model.shape_surface_speed.data[a] + model.shape_surface_speed.data[b]);
};
// Radius of what rolls, the larger of two [m].
auto radius_of = [&](int c) {
    int a, b;
    shapes_of(c, a, b);
    const REAL of_a = model.shape_radius.data[a], of_b = model.shape_radius.data[b];
    return of_a > of_b ? of_a : of_b;
};
// Rolling resistance, the larger of two; 0 where nothing rolls.
auto resistance_of = [&](int c) {
    int a, b;
    shapes_of(c, a, b);
    const REAL of_a = model.shape_rolling_resistance.data[a], of_b = model.shape_rolling_resistance.data[b];
    const REAL turns =
        model.inv_inertia.data[contacts.body_a.data[c]] + model.inv_inertia.data[contacts.body_b.data[c]];
    return radius_of(c) > 0 && turns > 0 ? (of_a > of_b ? of_a : of_b) : (REAL)0;
};
