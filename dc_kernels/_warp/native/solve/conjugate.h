// A step along the conjugate direction, which is then beta direction + change.
// Parameters: x, change, direction, i0, i1, beta.
for (int i = i0; i < i1; ++i) {
    const Real step = beta > 0 ? beta * direction.data[i] : (Real)0;  // it may hold NaN of the solve before
    direction.data[i] = step + change.data[i];
    x.data[i] += step;
    change.data[i] = step;
}
