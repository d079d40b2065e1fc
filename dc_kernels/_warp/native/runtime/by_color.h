// Blocks of rows colour by colour, each colour by all threads of a team. Stands behind team.h and `part`, which takes
// the ends of some colours, or of a part of one.
// Parameters: colors (first block of each colour of all worlds), at (of the world's first colour), team. Macros:
// SERIAL.
#if defined(__CUDA_ARCH__)
return 0;  // a GPU solves row by row
#else
if (!team) return part(colors.data + at, SERIAL);
Phases phases;
phases.first[0] = colors.data[at];
const int fewest = 8;  // blocks of a part: half a microsecond
for (int k = 0; k < SERIAL; ++k)
    phases.add(colors.data[at + k + 1], ((Team*)team)->size, fewest, ((Team*)team)->split[k]);
return take_phases((Team*)team, phases, [=](int first, int last) {
    const int ends[] = {first, last};
    return part(ends, 1);
});
#endif
