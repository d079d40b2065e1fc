// The columns of one row: one base pointer and constant offsets, 8 ns a row less than array stores.
// Parameters: columns, r, row. Macros: those of row.h.
Real* const to = columns.data + r;
to[AT_nx] = row.normal[0];
to[AT_ny] = row.normal[1];
#if DISCS
to[AT_dA] = -row.tangent_arm_a;
to[AT_dB] = row.tangent_arm_b;
to[AT_kA] = -(row.inv_inertia_a * row.tangent_arm_a);
to[AT_kB] = row.inv_inertia_b * row.tangent_arm_b;
#else
to[AT_rAn] = row.normal_arm_a;
to[AT_rBn] = row.normal_arm_b;
to[AT_rAt] = row.tangent_arm_a;
to[AT_rBt] = row.tangent_arm_b;
to[AT_iA] = row.inv_inertia_a;
to[AT_iB] = row.inv_inertia_b;
#endif
to[AT_en] = row.normal_mass;
to[AT_et] = row.tangent_mass;
to[AT_bias] = row.bias;
to[AT_mu] = row.friction;
to[AT_gap] = row.gap;
#if JOINTS
to[AT_lo] = row.least;
#endif
#if OWN
to[AT_hi] = row.most;
to[AT_ax] = row.direction_a[0];
to[AT_ay] = row.direction_a[1];
to[AT_soft] = row.softness;
to[AT_held] = row.held;
#endif
#if SURFACES
to[AT_slip] = 0;
to[AT_roll] = row.roll;
#endif
