// Which of the bodies b0 .. b1 contacts move, and how many have masses out of range.
// Parameters: inv_mass, inv_inertia, body_type, b0, b1. Macros: REAL, FIXED, MOVABLE, LARGEST.
int bad = 0;
for (int i = b0; i < b1; ++i) {
    const REAL mass = inv_mass.data[i], inertia = inv_inertia.data[i];
    // NaN compares with nothing
    bad += !((mass >= 0) & (mass <= (REAL)LARGEST) & (inertia >= 0) & (inertia <= (REAL)LARGEST));
    body_type.data[i] = mass > 0 || inertia > 0 ? MOVABLE : FIXED;
}
return bad;
