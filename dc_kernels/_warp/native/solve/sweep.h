// Projected Gauss-Seidel on the blocks first .. last of a colour's rows; the largest impulse change [N s].
// Parameters: columns, row_body, bodies, impulse, change, first, last, omega. Stands behind prelude.h, bodies.h, row.h.
// vn, vt: speeds of B against A along the normal and the tangent [m/s]; ln0, lt0: impulses along them before the sweep,
// ln, lt: after it, dn, dt: their changes [N s].
#if defined(__CUDA_ARCH__)
return 0;  // a GPU solves row by row
#else
Vector most = zero;
for (int b = first; b < last; ++b) {
    const int* const index = row_body.data + (size_t)b * 2 * LANES;
    const Real* const block = columns.data + (size_t)b * COLUMNS * LANES;
    Bodies A = load_bodies(index), B = load_bodies(index + LANES);
    const Row row = load_row(block);
    Real* const x = impulse.data + (size_t)b * 2 * LANES;
    const Vector ln0 = load(x), lt0 = load(x + LANES);
    const Vector vn = normal_speed(row, A, B);
    const Vector ln = within(block, ln0 - (omega * load(block + AT_en)) * (vn + bias(block, ln0)));
    const Vector dn = ln - ln0;
    Real* const moved = change.data + (size_t)b * 2 * LANES;
#if OWN
    if (!(__builtin_reduce_max(load(block + AT_et)) > 0)) {  // joints alone have no tangent to wait for
        apply_normal(row, A, B, dn);
        store(x, ln);
        store(moved, dn);
        store(moved + LANES, zero);
        most = larger(most, magnitude(dn));
        store_bodies(index, A);
        store_bodies(index + LANES, B);
        continue;
    }
#endif
#if DISCS
    // a disc's normal impulse has no tangential effect: its tangent need not wait for it (8 % of a small world's sweep)
    const Vector vt = tangent_speed(row, A, B);
    apply_normal(row, A, B, dn);
#else
    apply_normal(row, A, B, dn);
    const Vector vt = tangent_speed(row, A, B);
#endif
    const Vector lt = clamp(lt0 - (omega * load(block + AT_et)) * vt, load(block + AT_mu) * ln);
    const Vector dt = lt - lt0;
    apply_tangent(row, A, B, dt);
    store(x, ln);
    store(x + LANES, lt);
    store(moved, dn);
    store(moved + LANES, dt);
    most = larger(most, larger(magnitude(dn), magnitude(dt)));
    store_bodies(index, A);
    store_bodies(index + LANES, B);
}
return largest(most);
#endif
