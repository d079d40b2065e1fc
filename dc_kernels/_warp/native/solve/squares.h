// Sum of squares of x[i0 .. i1], a multiple of LANES long. Parameters: x, i0, i1.
#if defined(__CUDA_ARCH__)
Real sum = 0;
for (int i = i0; i < i1; ++i) sum += x.data[i] * x.data[i];
return sum;
#else
Vector sum = zero;
for (int i = i0; i < i1; i += LANES) {
    const Vector d = load(x.data + i);
    sum += d * d;
}
return total(sum);
#endif
