// Types of the neighbour search, after the common prelude.
#if !defined(__CUDA_ARCH__)
typedef long long Long;
typedef int Integers __attribute__((ext_vector_type(LANES), aligned(4)));
typedef bool Booleans __attribute__((ext_vector_type(LANES)));
#endif
