// Position correction of the blocks first .. last: displacements that remove a share of what overlaps; the largest
// push. Parameters: columns, row_body, bodies (displacements), first, last, factor, limit.
#if defined(__CUDA_ARCH__)
return 0;  // a GPU solves row by row
#else
Vector most = zero;
for (int b = first; b < last; ++b) {
    const int* const index = row_body.data + (size_t)b * 2 * LANES;
    const Real* const block = columns.data + (size_t)b * COLUMNS * LANES;
    Bodies A = load_bodies(index), B = load_bodies(index + LANES);
    const Row row = load_row(block);
    Vector step = larger(factor * (normal_speed(row, A, B) + load(block + AT_gap)), zero - limit);
#if JOINTS
    step = smaller(step, zero + limit);
#endif
#if SURFACES
    step = load(block + AT_roll) > zero ? zero : step;  // what rolls is where it should be
#endif
#if OWN
    const Vector dn = load(block + AT_held) * within(block, -(load(block + AT_en) * step));
#else
    const Vector dn = larger(-(load(block + AT_en) * step), least(block));
#endif
    apply_normal(row, A, B, dn);
    most = larger(most, magnitude(dn));
    store_bodies(index, A);
    store_bodies(index + LANES, B);
}
return largest(most);
#endif
