// Whether what a full test of the chunk's pair i finds is to be kept: not where LANES of such pairs are not worth it.
// Parameters: i, scratch. Stands behind recycle/scratch.h.
#if defined(__CUDA_ARCH__)
return 0;
#else
return place[i] == -1;
#endif
