// Whether masses and inertias do not fit the types of bodies or their inverses, a shape is not of the body that it
// stands among, or a segment moves. Macros: REAL, INVERSE_TOLERANCE, STATIC, DYNAMIC, SEGMENT.
#if !defined(__CUDA_ARCH__)
int wrong = 0;
const int n = body_type.shape[0];
const REAL off = (REAL)(INVERSE_TOLERANCE);
for (int b = 0; b < n; ++b) {
    const REAL m = mass.data[b], i = inertia.data[b], per_m = inv_mass.data[b], per_i = inv_inertia.data[b];
    const int heavy = m != 0, turns = i != 0;
    wrong |= (heavy != (body_type.data[b] == DYNAMIC)) | (turns & !heavy);
    wrong |= ((per_m != 0) != heavy) | ((per_i != 0) != turns);
    const REAL one = m * per_m - (REAL)heavy, other = i * per_i - (REAL)turns;
    wrong |= (int)!(one <= off) | (int)!(one >= -off) | (int)!(other <= off) | (int)!(other >= -off);
}
for (int b = 0; b < n; ++b) {
    for (int s = body_shape_start.data[b]; s < body_shape_start.data[b + 1]; ++s)
        wrong |= (shape_body.data[s] != b) | (shape_type.data[s] == SEGMENT && body_type.data[b] != STATIC);
}
return wrong;
#else
return 1;
#endif
