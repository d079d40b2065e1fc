// How many of the contacts i0 .. i1 are to be coloured: those without a colour, and those of the serial one.
// Parameters: color, i0, i1, team. Macros: SERIAL. Stands behind runtime/ranges.h.
const int* const of = color.data;
return add_range(team, i0, i1, 4096, [=](int first, int last) {
    int fresh = 0;
    for (int c = first; c < last; ++c) fresh += (of[c] < 0) | (of[c] == SERIAL);
    return fresh;
});
