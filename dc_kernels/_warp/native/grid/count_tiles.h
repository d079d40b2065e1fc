// Counts the points of a world's chunk that reach each tile.
#if !defined(__CUDA_ARCH__)
each_visit([](int& slot, int) { ++slot; });
#endif
