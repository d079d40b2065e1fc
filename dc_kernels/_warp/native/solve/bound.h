// Bounds of the rows of rolling resistance in the blocks b0 .. b1 follow the normal impulses of their contacts.
// Parameters: columns, limit_slot, impulse, b0, b1. Macros: those of row.h.
for (int b = b0; b < b1; ++b) {
    REAL* const block = columns.data + (size_t)b * COLUMNS * LANES;
    for (int lane = 0; lane < LANES; ++lane) {
        const int from = limit_slot.data[(size_t)b * LANES + lane];
        if (from < 0) continue;
        const REAL most = block[AT_roll + lane] * impulse.data[from];
        block[AT_lo + lane] = -most;
        block[AT_hi + lane] = most;
    }
}
