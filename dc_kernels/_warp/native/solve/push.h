// Position correction of the blocks of some colours: displacements that remove a share of what overlaps; the largest
// push. Parameters: columns, row_body, bodies (displacements), ends, colors, factor, limit. Stands behind prelude.h,
// bodies.h, row.h, take_blocks.h.
#if defined(__CUDA_ARCH__)
return 0;  // a GPU solves row by row
#else
Vector most = zero;
take_blocks(ends, colors, [&](auto& some) {
    EACH_BLOCK {
        const Real* const column = of.column;
        Vector step = larger(factor * (normal_speed(of.row, of.A, of.B) + load(column + AT_gap)), zero - limit);
#if JOINTS
        step = smaller(step, zero + limit);
#endif
#if SURFACES
        step = load(column + AT_roll) > zero ? zero : step;  // what rolls is where it should be
#endif
#if OWN
        of.dn = load(column + AT_held) * within(column, -(load(column + AT_en) * step));
#else
        of.dn = larger(-(load(column + AT_en) * step), least(column));
#endif
        most = larger(magnitude(of.dn), most);
    }
    EACH_BLOCK apply_normal(of.row, of.A, of.B, of.dn);
});
return largest(most);
#endif
