// A step along the conjugate direction, which is then beta direction + change.
// Parameters: x, change, direction, beta, colors, first_color, team. Stands behind runtime/ranges.h.
Real *const now = x.data, *const move = change.data, *const along = direction.data;
take_rows(team, colors.data + first_color, [=](int first, int last) {
    for (int i = first; i < last; ++i) {
        const Real step = beta > 0 ? beta * along[i] : (Real)0;  // it may hold NaN of the solve before
        along[i] = step + move[i];
        now[i] += step;
        move[i] = step;
    }
});
