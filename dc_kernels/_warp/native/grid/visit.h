// Calls visit(slot, i) for each tile that a point i of a world's chunk reaches.
#if !defined(__CUDA_ARCH__)
int* const slots = tiles.slot.data + (size_t)chunk * tiles.slot.shape[1] + (size_t)world * world_tiles;
auto each_visit = [&](auto visit) {
    const int from = points.start.data[world];
    const long long count = points.count.data[world];
    const int begin = from + (int)(count * chunk / chunks), end = from + (int)(count * (chunk + 1) / chunks);
    const bool separable = stencil.kernel > WENDLAND;
    auto range = [&](Real u, int nodes, int& low, int& high) {
        if (separable) {
            low = (int)clip(u, 0, nodes - 1) - 1;
            high = low + 3;
        } else {
            u = clip(u, -hs - 2, nodes + hs + 1);
            low = (int)__builtin_elementwise_ceil(u - hs);
            high = (int)__builtin_elementwise_floor(u + hs);
            if (low > high) low = high = nearest_node(u, nodes);
        }
        low = low < 0 ? 0 : (low > nodes - 1 ? nodes - 1 : low);
        high = high < 0 ? 0 : (high > nodes - 1 ? nodes - 1 : high);
    };
    for (int i = begin; i < end; ++i) {
        int c0 = 0, c1 = 0;
        r0 = r1 = 0;
        if (finite(i)) {
            range(x, columns, c0, c1);
            range(y, rows, r0, r1);
        }
        for (int r = r0 / TILE_ROWS; r <= r1 / TILE_ROWS; ++r)
            for (int c = c0 / TILE_COLUMNS; c <= c1 / TILE_COLUMNS; ++c) visit(slots[r * across + c], i);
    }
};
#endif
