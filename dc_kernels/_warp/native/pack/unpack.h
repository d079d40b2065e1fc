// Impulses of rows back to the contacts i0 .. i1. Parameters: impulse, slot, solved, i0, i1, team. Stands behind
// prelude.h and runtime/ranges.h.
const int* const at = slot.data;
const Real* const x = impulse.data;
Real* const to = (Real*)solved.data;
take_range(team, i0, i1, 2048, [=](int first, int last) {
    for (int i = first; i < last; ++i) {
        const Real along = x[at[i]], across = x[at[i] + LANES];
        to[2 * i] = along;
        to[2 * i + 1] = across;
    }
});
