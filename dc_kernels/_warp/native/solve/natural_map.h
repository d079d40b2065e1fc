// The sum and the squared natural maps of the rows of the blocks first .. last [(N s)^2], row after row, as laws.py has
// it. Parameters: columns, row_body, bodies, impulse, first, last, sum. Stands behind prelude.h, bodies.h and row.h.
#if defined(__CUDA_ARCH__)
return 0;  // a GPU sums row by row
#else
const Vector one = (Real)1;
for (int b = first; b < last; ++b) {
    const int* const index = row_body.data + (size_t)b * 2 * LANES;
    const Real* const block = columns.data + (size_t)b * COLUMNS * LANES;
    const Bodies A = load_bodies(index), B = load_bodies(index + LANES);
    const Row row = load_row(block);
    const Real* const x = impulse.data + (size_t)b * 2 * LANES;
    const Vector xn = load(x), xt = load(x + LANES), mu = load(block + AT_mu), mass = load(block + AT_en);
    const Vector un = normal_speed(row, A, B) + bias(block, xn), ut = tangent_speed(row, A, B);
    const Vector zn = xn - mass * (un + mu * magnitude(ut)), zt = xt - mass * ut, size = magnitude(zt);
    // the nearest point in Coulomb's cone: z itself inside, the apex behind it, else on the cone's edge
    const Vector edge = (zn + mu * size) / (one + mu * mu), along = mu * edge;
    const auto behind = mu * size <= -zn;
    const auto outside = (zn < zero) | (size > mu * zn);
    const Vector pn = outside ? (behind ? zero : edge) : zn;
    const Vector pt = outside ? (behind ? zero : (zt < zero ? -along : along)) : zt;
    Vector square = (xn - pn) * (xn - pn) + (xt - pt) * (xt - pt);
#if OWN
    const Vector off = xn - within(block, xn - mass * un);
    const auto bounded = (load(block + AT_lo) != zero) | (load(block + AT_hi) < Vector((Real)__builtin_inf()));
    square = bounded ? off * off : square;
#elif JOINTS
    square = load(block + AT_lo) < zero ? (mass * un) * (mass * un) : square;
#endif
    for (int lane = 0; lane < LANES; ++lane) sum += square[lane];
}
return sum;
#endif
