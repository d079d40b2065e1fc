// Projected Gauss-Seidel on the blocks of some colours; the largest impulse change [N s].
// Parameters: columns, row_body, bodies, impulse, change, ends, colors, omega. Stands behind prelude.h, bodies.h, row.h
// and take_blocks.h. vn: speed of B against A along the normal [m/s]; ln0, lt0: impulses before the sweep [N s].
#if defined(__CUDA_ARCH__)
return 0;  // a GPU solves row by row
#else
Vector most = zero;
take_blocks(ends, colors, [&](auto& some) {
    EACH_BLOCK {
        const Vector ln0 = load(impulse.data + of.at), vn = normal_speed(of.row, of.A, of.B);
        const Vector en = omega * load(of.column + AT_en);
        of.ln = within(of.column, ln0 - en * (vn + bias(of.column, ln0)));
        of.dn = of.ln - ln0;
    }
#if OWN
    bool joints = true;
    EACH_BLOCK joints = joints && !(__builtin_reduce_max(load(of.column + AT_et)) > 0);
    if (joints) {  // joints alone have no tangent to wait for
        EACH_BLOCK apply_normal(of.row, of.A, of.B, of.dn);
        EACH_BLOCK {
            store(impulse.data + of.at, of.ln);
            store(change.data + of.at, of.dn);
            store(change.data + of.at + LANES, zero);
            most = larger(magnitude(of.dn), most);
        }
        return;
    }
#endif
    EACH_BLOCK of.vt = tangent_speed_after(of.row, of.A, of.B, of.dn);
    EACH_BLOCK {
        const Vector lt0 = load(impulse.data + of.at + LANES), et = omega * load(of.column + AT_et);
        of.lt = clamp(lt0 - et * of.vt, load(of.column + AT_mu) * of.ln);
        of.dt = of.lt - lt0;
    }
    EACH_BLOCK apply_both(of.row, of.A, of.B, of.dn, of.dt);
    EACH_BLOCK {
        store(impulse.data + of.at, of.ln);
        store(impulse.data + of.at + LANES, of.lt);
        store(change.data + of.at, of.dn);
        store(change.data + of.at + LANES, of.dt);
        most = larger(magnitude(of.dn), larger(magnitude(of.dt), most));
    }
});
return largest(most);
#endif
