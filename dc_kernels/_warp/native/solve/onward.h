// Momentum: x <- x + beta (x - before), before <- x. Parameters: x, before, at, i0, i1, beta.
for (int i = i0; i < i1; ++i) {
    const Real v = x.data[i];
    Real* const last = before.data + at + (i - i0);
    x.data[i] = v + beta * (v - last[0]);
    last[0] = v;
}
