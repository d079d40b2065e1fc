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
const int n = problem.mu.shape[0];
const int* const start = problem.row_start.data;
const int* const column = problem.column.data;
const REAL* const w = (const REAL*)problem.block.data;
const REAL* const q = (const REAL*)problem.q.data;
const REAL* const mu = problem.mu.data;
const REAL* const low = problem.low.data;
const REAL* const inverse = (const REAL*)problem.inverse.data;
const REAL* const couple = problem.couple.data;
REAL* const x = (REAL*)search.impulse.data;
REAL* const step = (REAL*)search.step.data;
const REAL none = 0;
REAL total = 0;
int k = start[0];
for (int c = 0; c < n; ++c) {
    REAL un = q[2 * c], ut = q[2 * c + 1], vn = 0, vt = 0;
    for (const int end = start[c + 1]; k < end; ++k) {
        const REAL* const b = w + 4 * (size_t)k;
        const REAL xn = x[2 * column[k]], xt = x[2 * column[k] + 1];
        un += b[0] * xn;
        vn += b[1] * xt;
        ut += b[2] * xn;
        vt += b[3] * xt;
    }
    un += vn;
    ut += vt;
    const REAL rn = x[2 * c], rt = x[2 * c + 1];
    const REAL n1 = LARGER(rn - omega * inverse[2 * c] * un, low[c]);
    const REAL limit = LARGER(mu[c] * n1, none);
    const REAL dn = n1 - rn;
    ut += couple[c] * dn;
    const REAL free = rt - omega * inverse[2 * c + 1] * ut;
    const REAL t1 = SMALLER(LARGER(free, -limit), limit);
    const REAL dt = t1 - rt;
    x[2 * c] = n1;
    x[2 * c + 1] = t1;
    step[2 * c] = dn;
    step[2 * c + 1] = dt;
    total += dn * dn + dt * dt;
}
return total;
#undef LARGER
#undef SMALLER
