// The latest iterate and its step go in front of the remembered ones. Parameters: x, change, history, at, i0, i1.
const int stride = i1 - i0;
for (int i = i0; i < i1; ++i) {
    Real* const past = history.data + at + (i - i0);
    past[2 * stride] = past[0];
    past[3 * stride] = past[stride];
    past[0] = x.data[i];
    past[stride] = change.data[i];
}
