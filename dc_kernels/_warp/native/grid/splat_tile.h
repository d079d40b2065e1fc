// Adds the points of a tile in its buffer, and copies it to the image.
#if !defined(__CUDA_ARCH__)
each_stencil(add);
tiles.lost.data[tile] = lost;
for (int c = 0; c < all_channels; ++c)
    for (int r = row_low; r < row_high; ++r) {
        const Real* from = buffer + c * channel_stride + (size_t)(r - row_low) * row_stride + pad;
        Real* to = target + c * nodes + (size_t)r * columns + column_low;
        // past the cache where the row is aligned: a sixteenth of the whole
        typedef Real Aligned __attribute__((ext_vector_type(LANES)));
        int n = 0;
        if (((unsigned long long)to & (sizeof(Aligned) - 1)) == 0)
            for (; n + LANES <= column_high - column_low; n += LANES)
                __builtin_nontemporal_store((Aligned) * (const Vector*)(from + n), (Aligned*)(to + n));
        for (; n < column_high - column_low; ++n) to[n] = from[n];
    }
#endif
