// One sweep of projected Gauss-Seidel over all contacts of a problem, the normal of each before its friction; returns
// the squared norm of its step. A store and the next row's load of it are what a sweep waits for: plain pointers, no
// strides, two sums a direction. Macro: REAL.
#if defined(__CUDA_ARCH__)
#define LARGER(a, b) ((a) > (b) ? (a) : (b))
#define SMALLER(a, b) ((a) < (b) ? (a) : (b))
#else
#define LARGER __builtin_elementwise_max
#define SMALLER __builtin_elementwise_min
#endif
const int* const start = block_start.data;
const int* const col = block_col.data;
const REAL* const w = (const REAL*)block.data;
const REAL* const given = (const REAL*)q.data;
const REAL* const inv = (const REAL*)inverse.data;
REAL* const x = (REAL*)impulse.data;
REAL* const moved = (REAL*)step.data;
const REAL none = 0;
REAL total = 0;
int k = start[0];
for (int c = 0; c < n; ++c) {
    REAL un = given[2 * c], ut = given[2 * c + 1], vn = 0, vt = 0;
    for (const int end = start[c + 1]; k < end; ++k) {
        const REAL* const b = w + 4 * (size_t)k;
        const REAL xn = x[2 * col[k]], xt = x[2 * col[k] + 1];
        un += b[0] * xn;
        vn += b[1] * xt;
        ut += b[2] * xn;
        vt += b[3] * xt;
    }
    un += vn;
    ut += vt;
    const REAL rn = x[2 * c], rt = x[2 * c + 1];
    const REAL n1 = LARGER(rn - omega * inv[2 * c] * un, low.data[c]);
    const REAL limit = LARGER(mu.data[c] * n1, none);
    const REAL dn = n1 - rn;
    ut += couple.data[c] * dn;
    const REAL free = rt - omega * inv[2 * c + 1] * ut;
    const REAL t1 = SMALLER(LARGER(free, -limit), limit);
    const REAL dt = t1 - rt;
    x[2 * c] = n1;
    x[2 * c + 1] = t1;
    moved[2 * c] = dn;
    moved[2 * c + 1] = dt;
    total += dn * dn + dt * dt;
}
return total;
#undef LARGER
#undef SMALLER
