// Rows of the tree that lacked more than still of their speed as the last sweep came to them, counted until there are
// enough. Parameters: tree, still, enough, rows. Macros: those of solve/row.h.
int count = 0;
for (int t = rows.tree_first.data[tree]; t < rows.tree_first.data[tree + 1]; ++t) {
    for (int i = 0; i < rows.tree_size.data[t]; ++i) {
        const unsigned slot = rows.row_slot.data[rows.tree_row.data[t] + i];
        const size_t at = (size_t)(slot / (2 * LANES)) * COLUMNS * LANES + slot % (2 * LANES);
        const REAL change = rows.change.data[slot];
        // NaN is lacking
        if (!((change < 0 ? -change : change) <= still * rows.column.data[at + AT_en]) && ++count >= enough)
            return count;
    }
}
return count;
