// Blocks of each colour of a world's contacts, joints and own rows, which are given room by `fill`: the colours used,
// or -1 without room; then no row is of any colour yet. Where rows are made one by one, the empty lanes of a colour's
// last block are zero and point at the padding body. Rows of rolling resistance have the colours from ROLLING_COLOR on,
// which are not counted, or the serial one where the others have more than so many.
// Threads of a team count the contacts of their parts, and keep for pack/contacts.h what they have found.
// Parameters: w, padding_body, model, joints, contacts, rows, team. Macros: those of solve/row.h, ROLLING_COLOR. Stands
// behind runtime/ranges.h, and surface.h where SURFACES is 1.
const int i0 = contacts.contact_start.data[w], i1 = i0 + contacts.contact_count.data[w];
// two counts at a time, as neighbours often have one colour and would wait for each other
int of[2][COLORS] = {};
const int* const color = contacts.color.data;
#if defined(__CUDA_ARCH__)
for (int c = i0; c < i1; ++c) ++of[c & 1][color[c]];
#else
const int SHARED = 2048;  // contacts from which threads share them
Team* const members = (Team*)team;
if (members) members->counted = 0;
if (i1 - i0 < SHARED || !is_helped(members)) {
    for (int c = i0; c < i1; ++c) ++of[c & 1][color[c]];
} else {
    const int parts = members->counted = members->size;
    Phases phases;
    phases.first[0] = 0;
    phases.add(parts, parts, 1);
    take_phases(members, phases, [=](int first, int last) {
        for (int p = first; p < last; ++p) {
            int found[2][COLORS] = {};
            const int end = Share::begin(members, i0, i1, p + 1, parts);
            for (int c = Share::begin(members, i0, i1, p, parts); c < end; ++c) ++found[c & 1][color[c]];
            for (int k = 0; k < COLORS; ++k) members->count[p][k] = found[0][k] + found[1][k];
        }
        return 0.0;
    });
    for (int p = 0; p < parts; ++p)
        for (int k = 0; k < COLORS; ++k) of[0][k] += members->count[p][k];
}
#endif
#if JOINTS
for (int j = rows.line_start.data[w]; j < rows.line_start.data[w + 1]; ++j) ++of[0][joints.joint_color.data[j]];
#endif
#if OWN
for (int k = rows.row_start.data[w]; k < rows.row_start.data[w + 1]; ++k)
    of[0][rows.row_color.data[k]] += rows.row_lower.data[k] != 0 || rows.row_upper.data[k] != 0;
#endif
int* const fill = rows.color_fill.data + (size_t)w * COLORS;
int* const ends = rows.color_block.data + (size_t)w * (COLORS + 1);
const int first = rows.block_start.data[w];
int block = first, used = 0;
auto find_used = [&]() {
    for (int k = 0; k < COLORS; ++k) used = of[0][k] + of[1][k] > 0 ? k + 1 : used;
};
#if SURFACES
find_used();
const int colors = used;
for (int c = i0; c < i1 && rows.roll_slot.shape[0] > 0; ++c)
    if (resistance_of(c) > 0) ++of[0][used <= ROLLING_COLOR ? color[c] + ROLLING_COLOR : COLORS - 1];
#endif
find_used();
for (int k = 0; k < used; ++k) {
    const int count = of[0][k] + of[1][k];
    fill[k] = count;
    ends[k] = block;
    block += (unsigned)(count + LANES - 1) / LANES;
}
for (int k = used; k < COLORS; ++k) {
    fill[k] = 0;
    ends[k] = block;
}
ends[COLORS] = block;
rows.block_needed.data[w] = block - first;
if (block > rows.block_start.data[w + 1]) return -1;
for (int k = 0; k < used; ++k) fill[k] = 0;
#if JOINTS || defined(__CUDA_ARCH__)
for (int k = 0; k < used; ++k) {
    if ((of[0][k] + of[1][k]) % LANES == 0) continue;
    const size_t last = ends[k + 1] - 1;
    for (size_t i = last * COLUMNS * LANES; i < (last + 1) * COLUMNS * LANES; ++i) rows.column.data[i] = 0;
    for (size_t i = last * 2 * LANES; i < (last + 1) * 2 * LANES; ++i) rows.body.data[i] = padding_body;
}
#endif
#if SURFACES
for (size_t i = (size_t)first * LANES; i < (size_t)block * LANES; ++i) rows.limit_slot.data[i] = -1;
return colors;
#endif
return used;
