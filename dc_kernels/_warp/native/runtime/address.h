// Where the compiled functions of Lead are that a team calls by their addresses. Stands behind lead.h. Parameter:
// which.
#if defined(__CUDA_ARCH__)
return 0;
#else
return which == 0 ? (wp::uint64)&Lead::take : which == 1 ? (wp::uint64)&Lead::is_there : (wp::uint64)&Lead::find_plan;
#endif
