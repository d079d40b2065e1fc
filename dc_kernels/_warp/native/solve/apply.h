// Velocities after given impulses on the blocks of some colours: V += M^-1 J^T delta.
// Parameters: columns, row_body, bodies, delta, ends, colors. Stands behind prelude.h, bodies.h, row.h, take_blocks.h.
#if !defined(__CUDA_ARCH__)
take_blocks(ends, colors, [&](auto& some) {
    EACH_BLOCK apply_both(of.row, of.A, of.B, load(delta.data + of.at), load(delta.data + of.at + LANES));
});
#endif
