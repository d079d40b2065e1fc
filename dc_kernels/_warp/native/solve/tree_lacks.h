// 1 where a row of the tree lacked more than still of its speed as the last sweep came to it, else 0.
// Parameters: tree, still, rows. Macros: those of solve/row.h.
for (int t = rows.tree_first.data[tree]; t < rows.tree_first.data[tree + 1]; ++t) {
    for (int i = 0; i < rows.tree_size.data[t]; ++i) {
        const int slot = rows.row_slot.data[rows.tree_row.data[t] + i];
        const size_t at = (size_t)(slot / (2 * LANES)) * COLUMNS * LANES + slot % (2 * LANES);
        const REAL change = rows.change.data[slot];
        if (!((change < 0 ? -change : change) <= still * rows.column.data[at + AT_en])) return 1;  // NaN is lacking
    }
}
return 0;
