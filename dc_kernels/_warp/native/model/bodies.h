// Whether masses and inertias do not fit the types of bodies or their inverses, or a shape is not of a body of its
// world. Macros: REAL, INVERSE_TOLERANCE, DYNAMIC.
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
for (int w = 0; w < shape_start.shape[0] - 1; ++w) {
    const int low = body_start.data[w], high = body_start.data[w + 1];
    for (int s = shape_start.data[w]; s < shape_start.data[w + 1]; ++s) {
        const int b = shape_body.data[s];
        if (b < low || b >= high) return 1;
    }
}
return wrong;
#else
return 1;
#endif
