// Columns of Feature and Channel of the contacts of a world, LANES contacts side by side, and where they are read.
// Macros: the names of LOCAL and IMAGE with FEATURE_ and CHANNEL_, LOCAL, IMAGE (columns),
// ON_CONE, NETWORK (code of an answer). Behind learn/steps.h.
#if !defined(__CUDA_ARCH__)
const Real inverse = 1 / sigma;
const Real whole_world[] = {wp::log(wide) * (Real)0.5,
                            settings.begin ? (Real)1 : (Real)0,
                            wp::log(1 + (Real)now.sweeps) * (Real)0.25,
                            wp::log(sigma / size) * (Real)0.25,
                            wp::log(sigma / (settings.tolerance + tiny)) * (Real)0.25,
                            settings.accelerated ? (Real)1 : (Real)0,
                            wp::log((Real)count) * (Real)0.25};
const int until = reading.answer.data[k] == NETWORK ? count : 0;
for (int i0 = 0; i0 < until; i0 += LANES) {
    const Block c = block_at(i0);
    const Bodies a = load_bodies(c.a), b = load_bodies(c.b);
    const Vector one = zero + 1;
    Vector local[LOCAL], picture[IMAGE], px, py, sn, st, kn, kt;
    pairs_of(place, c.own, px, py);
    pairs_of(step, c.own, sn, st);
    pairs_of((const Real*)reading.known.data + 2 * (size_t)first, c.own, kn, kt);
    sn *= inverse;
    st *= inverse;
    const Vector none = zero + (begins ? (Real)0 : inverse);
    const Vector since_n = (c.x - kn) * none, since_t = (c.y - kt) * none;
    const Alone alone = step_alone(c, a, b);
    const Vector xn = c.x * inverse, xt = c.y * inverse;
    const Vector limit = values_at(friction, c.own) * c.x;
    const Vector used = limit > 0 ? c.y / (limit > 0 ? limit : one) : zero;
    const Vector closed = c.x > 0 ? one : zero, sliding = magnitude(used) > (Real)ON_CONE ? one : zero;
    Vector fresh = zero;
    for (int j = 0; j < LANES; ++j) fresh[j] = contacts.age.data[first + c.own[j]] == 0;
    const Vector double_cos = c.nx * c.nx - c.ny * c.ny, double_sin = 2 * c.nx * c.ny;
    local[FEATURE_STEP_N] = squash(sn);
    local[FEATURE_STEP_T] = squash(st);
    local[FEATURE_LOCAL_N] = squash(alone.n * inverse);
    local[FEATURE_LOCAL_T] = squash(alone.t * inverse);
    local[FEATURE_SINCE_N] = squash(since_n) * (Real)0.5;
    local[FEATURE_SINCE_T] = squash(since_t) * (Real)0.5;
    local[FEATURE_IMPULSE_N] = squash(xn) * (Real)0.25;
    local[FEATURE_IMPULSE_T] = squash(xt) * (Real)0.25;
    local[FEATURE_CONE] = used;
    local[FEATURE_CLOSED] = closed;
    local[FEATURE_SLIDING] = sliding;
    local[FEATURE_NEW] = fresh;
    local[FEATURE_NORMAL_COS] = double_cos;
    local[FEATURE_NORMAL_SIN] = double_sin;
    local[FEATURE_FREE_N] = squash(alone.free_n * inverse);
    local[FEATURE_FREE_T] = squash(alone.free_t * inverse);
    // the steps that act on a body, and how many they are; 0 where it does not move
    auto at_body = [&](const int* index, Vector mass, int n, int degree) {
        const Bodies sum = load_from((const Real*)reading.body_sum.data, index);
        const Vector moving = mass > 0 ? one : zero;
        local[n] = squash((sum.x * c.nx + sum.y * c.ny) * inverse * moving);
        local[n + 1] = squash((sum.x * c.ny - sum.y * c.nx) * inverse * moving);
        local[degree] = sum.w * moving * (Real)0.25;
    };
    at_body(c.a, a.m, FEATURE_BODY_A_N, FEATURE_DEGREE_A);
    at_body(c.b, b.m, FEATURE_BODY_B_N, FEATURE_DEGREE_B);
    local[FEATURE_SHARE_A] = a.m / (a.m + b.m + tiny);
    for (int i = FEATURE_RATE; i <= FEATURE_CONTACTS; ++i) local[i] = zero + whole_world[i - FEATURE_RATE];
    int rated[LANES];
    for (int j = 0; j < LANES; ++j) rated[j] = base + c.own[j];
    local[FEATURE_RATE_NEAR] = logarithm(1 + values_at(reading.rate.data, rated)) * (Real)0.5;
    // outer product of p and the normal, which does not depend on which body is A: p is a vector of these components
    // along normal and tangent, its length squashed and weighted
    auto pass_on = [&](int column, Vector n, Vector t, Real weight) {
        const Vector x = n * c.nx + t * c.ny, y = n * c.ny - t * c.nx, length = root(x * x + y * y) + tiny;
        const Vector factor = squash(length) / length * weight;
        picture[column] = x * factor * c.nx;
        picture[column + 1] = x * factor * c.ny;
        picture[column + 2] = y * factor * c.nx;
        picture[column + 3] = y * factor * c.ny;
    };
    pass_on(CHANNEL_STEP_XX, sn, st, 1);
    pass_on(CHANNEL_SINCE_XX, since_n, since_t, (Real)0.5);
    pass_on(CHANNEL_IMPULSE_XX, xn, xt, (Real)0.25);
    picture[CHANNEL_CONTACTS] = one;
    picture[CHANNEL_NORMAL_COS] = double_cos;
    picture[CHANNEL_NORMAL_SIN] = double_sin;
    picture[CHANNEL_NEW] = fresh;
    picture[CHANNEL_CLOSED] = closed;
    picture[CHANNEL_SLIDING] = sliding;
    Real* const row = reading.local.data + (size_t)(base + i0) * LOCAL;
    for (int f = 0; f < LOCAL; f += LANES) {
        const int from = f < LOCAL - LANES ? f : LOCAL - LANES;
        store_rows(local + from, row + from, LOCAL, c.lanes);
    }
    Real* const values = reading.image_value.data + (size_t)(base + i0) * IMAGE;
    for (int f = 0; f < IMAGE; f += LANES) {
        const int from = f < IMAGE - LANES ? f : IMAGE - LANES;
        store_rows(picture + from, values + from, IMAGE, c.lanes);
    }
    // the centre of what does not move says nothing of the contact
    auto put_center = [&](const int* index, Vector mass, void* all) {
        Vector x, y;
        pairs_of(positions, index, x, y);
        store_pairs((Real*)all + 2 * (size_t)(base + i0), mass > 0 ? x : px, mass > 0 ? y : py, c.lanes);
    };
    put_center(c.a, a.m, reading.place_a.data);
    put_center(c.b, b.m, reading.place_b.data);
}
#endif
