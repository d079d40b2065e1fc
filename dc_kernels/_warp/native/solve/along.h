// Scalar product of a change with the move before it, change . (x - before). Parameters: change, x, before, at, i0, i1.
#if defined(__CUDA_ARCH__)
Real sum = 0;
for (int i = i0; i < i1; ++i) sum += change.data[i] * (x.data[i] - before.data[at + (i - i0)]);
return sum;
#else
Vector sum = zero;
for (int i = i0; i < i1; i += LANES)
    sum += load(change.data + i) * (load(x.data + i) - load(before.data + at + (i - i0)));
return total(sum);
#endif
