// Sets `wrong` of each array in which a value is NaN or outside [low, high], or the square of a vector's length is.
// Macros: REAL, NUMBERS, INTEGERS, UNITS (what the elements are).
#if !defined(__CUDA_ARCH__)
for (int f = 0; f < kind.shape[0]; ++f) {
    int bad = 0;
    const size_t n = count.data[f];
    if (kind.data[f] == INTEGERS) {
        const int* v = (const int*)address.data[f];
        const int least = (int)low.data[f], most = (int)high.data[f];
        for (size_t i = 0; i < n; ++i) bad |= (v[i] < least) | (v[i] > most);
    } else {
        const REAL* v = (const REAL*)address.data[f];
        const REAL least = (REAL)low.data[f], most = (REAL)high.data[f];
        if (kind.data[f] == NUMBERS) {
            for (size_t i = 0; i < n; ++i) bad |= (int)!(v[i] >= least) | (int)!(v[i] <= most);
        } else {
            for (size_t i = 0; i < n; ++i) {
                const REAL square = v[2 * i] * v[2 * i] + v[2 * i + 1] * v[2 * i + 1];
                bad |= (int)!(square >= least) | (int)!(square <= most);
            }
        }
    }
    wrong.data[f] = bad;
}
#endif
