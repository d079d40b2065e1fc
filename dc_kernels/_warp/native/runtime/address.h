// Where the compiled Lead::take is. Stands behind lead.h.
#if defined(__CUDA_ARCH__)
return 0;
#else
return (wp::uint64)&Lead::take;
#endif
