// Where meet_again.h and meet_discs.h leave the manifolds of a chunk of pairs for take_met.h, in the scratch memory of
// the launch: ``met``, FIELDS numbers each, LANES of them side by side, and ``place`` of each pair, and behind those
// how many places of manifolds are used. Arrays of the kernel's own would be set to zero in each world, twice: 4 % of a
// step of a world of ten boxes. Parameters: scratch. Macros: CHUNK, FIELDS, LANES, SCRATCH.
#if !defined(__CUDA_ARCH__)
static_assert((CHUNK + LANES) * FIELDS * sizeof(REAL) + (CHUNK + 1) * sizeof(int) <= SCRATCH, "too little scratch");
REAL* const met = (REAL*)scratch;
int* const place = (int*)(met + (CHUNK + LANES) * FIELDS);
#endif
