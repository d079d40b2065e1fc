// Which of the bodies b0 .. b1 contacts move, and how many have masses out of range.
// Parameters: inv_mass, inv_inertia, body_type, b0, b1. Macros: REAL, FIXED, MOVABLE.
int bad = 0;
for (int i = b0; i < b1; ++i) {
    const REAL mass = inv_mass.data[i], inertia = inv_inertia.data[i];
    // 0 x is 0 for a finite x, NaN for inf and NaN
    bad += ((REAL)0 * mass + (REAL)0 * inertia != 0) | (mass < 0) | (inertia < 0);
    body_type.data[i] = mass > 0 || inertia > 0 ? MOVABLE : FIXED;
}
return bad;
