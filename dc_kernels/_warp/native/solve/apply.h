// Velocities after given impulses on the blocks first .. last: V += M^-1 J^T delta.
// Parameters: columns, row_body, bodies, delta, first, last.
#if !defined(__CUDA_ARCH__)
for (int b = first; b < last; ++b) {
    const int* const index = row_body.data + (size_t)b * 2 * LANES;
    Bodies A = load_bodies(index), B = load_bodies(index + LANES);
    const Row row = load_row(columns.data + (size_t)b * COLUMNS * LANES);
    const Real* const x = delta.data + (size_t)b * 2 * LANES;
    apply_normal(row, A, B, load(x));
    apply_tangent(row, A, B, load(x + LANES));
    store_bodies(index, A);
    store_bodies(index + LANES, B);
}
#endif
