// How many of the contacts i0 .. i1 are to be coloured: those without a colour, and those of the serial one.
// Parameters: color, i0, i1. Macros: SERIAL.
int fresh = 0;
for (int c = i0; c < i1; ++c) fresh += (color.data[c] < 0) | (color.data[c] == SERIAL);
return fresh;
