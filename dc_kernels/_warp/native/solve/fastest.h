// The largest speed along x or y of the bodies b0 .. b1. Parameters: bodies, b0, b1, team. Stands behind
// runtime/ranges.h.
const Real* const velocity = (const Real*)bodies.data;
struct Most {
    Real speed;
    Most& operator+=(const Most& other) {
        if (other.speed > speed) speed = other.speed;
        return *this;
    }
};
const int few = 2048;  // bodies: 1 us
const Most most = add_range(team, b0, b1, few, [=](int first, int last) {
    Most part = {0};
    for (int i = 4 * first; i < 4 * last; i += 4) {
        const Real x = fabs(velocity[i]), y = fabs(velocity[i + 1]);
        part += Most{x > y ? x : y};
    }
    return part;
});
return most.speed;
