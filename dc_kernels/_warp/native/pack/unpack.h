// Impulses of rows back to the contacts i0 .. i1. Parameters: impulse, slot, solved, i0, i1.
const int* const at = slot.data;
const Real* const x = impulse.data;
Real* const to = (Real*)solved.data;
for (int i = i0; i < i1; ++i) {
    const Real along = x[at[i]], across = x[at[i] + LANES];
    to[2 * i] = along;
    to[2 * i + 1] = across;
}
