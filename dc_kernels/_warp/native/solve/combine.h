// Anderson's update into change, -(a e1 + b e2), and the latest iterate remembered.
// Parameters: x, change, history, at, i0, i1, kept, a, b.
const int stride = i1 - i0;
for (int i = i0; i < i1; ++i) {
    Real* const past = history.data + at + (i - i0);
    const Real v = x.data[i], d = change.data[i];
    Real move = a * (v - past[0]);
    if (kept > 1) move += b * (v - past[2 * stride]);
    past[2 * stride] = past[0];
    past[3 * stride] = past[stride];
    past[0] = v;
    past[stride] = d;
    change.data[i] = -move;
}
