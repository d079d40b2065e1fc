// Lists the points of a world's chunk by tile, from the slots on.
#if !defined(__CUDA_ARCH__)
each_visit([&](int& slot, int i) { tiles.order.data[slot++] = i; });
#endif
