// Takes the blocks of colours ends[0] .. ends[colors] in order, two of a colour at a time where there are two: they
// share no body that moves, so that one computes while the other waits for what it has just computed, which is most of
// what a block takes. A sweep of hulls takes 25 % less for it with AVX-512 and 12 % less with AVX2, one of discs 15 and
// 4 %; three or four blocks gain no more. ``take`` changes the velocities of an array of blocks, which are stored then.
// In it EACH_BLOCK is a loop over them, ``of``. Parameters: columns, row_body, bodies. Stands behind prelude.h,
// bodies.h and row.h.
#if !defined(__CUDA_ARCH__)
#define EACH_BLOCK _Pragma("unroll") for (Block& of : some)  // else they would not stay in registers
struct Block {
    const int* index;
    const Real* column;
    size_t at;  // of its impulses
    Bodies A, B;
    Row row;
    Vector vt;              // speed of B against A along the tangent [m/s]
    Vector ln, lt, dn, dt;  // impulses along normal and tangent, and their changes [N s]
};
auto take_blocks = [&](const int* ends, int colors, auto take) {
    auto take_some = [&](auto& some, int b) {
        EACH_BLOCK {
            of.at = (size_t)b * 2 * LANES;
            of.index = row_body.data + of.at;
            of.column = columns.data + (size_t)b * COLUMNS * LANES;
            of.A = load_bodies(of.index);
            of.B = load_bodies(of.index + LANES);
            of.row = load_row(of.column);
            ++b;
        }
        take(some);
        EACH_BLOCK {
            store_bodies(of.index, of.A);
            store_bodies(of.index + LANES, of.B);
        }
    };
    // where the processor's own prefetching begins anew, as each block is short: behind its first lines it follows by
    // itself. Four blocks ahead a sweep of 100 000 discs takes 12 % less for it, and one of a tumbler 5 %; of bodies it
    // would cost more than it gains
    auto prefetch = [&](size_t b) {
        __builtin_prefetch(row_body.data + b * 2 * LANES);
        for (int line = 0; line < 3; ++line)
            __builtin_prefetch((char*)(columns.data + b * COLUMNS * LANES) + 64 * line);
    };
    for (int k = 0; k < colors && ends[k] < ends[colors]; ++k) {
        int b = ends[k];
        for (; b + 2 <= ends[k + 1]; b += 2) {
            Block two[2];
            prefetch(b + 4);
            prefetch(b + 5);
            take_some(two, b);
        }
        if (b < ends[k + 1]) {
            Block one[1];
            take_some(one, b);
        }
    }
};
#endif
