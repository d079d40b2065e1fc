// Adds all points of a world, and says how many reach no node.
#if !defined(__CUDA_ARCH__)
each_stencil(add);
missed.data[world] = lost;
#endif
