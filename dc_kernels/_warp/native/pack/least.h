// The least of 0 and x[i0 .. i1]. Parameters: x, i0, i1.
Real least = 0;
int i = i0;
#if !defined(__CUDA_ARCH__)
Vector lowest = zero;
for (; i + LANES <= i1; i += LANES) lowest = smaller(load(x.data + i), lowest);
for (int k = 0; k < LANES; ++k) least = lowest[k] < least ? lowest[k] : least;
#endif
for (; i < i1; ++i) least = x.data[i] < least ? x.data[i] : least;
return least;
