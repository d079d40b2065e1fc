// MOVING times the rows of the blocks first .. last that the last sweep still moved, and SCARCE times those that it
// moved by FAR times as much, less all rows that can move; ASTRAY where it moved one by FARTHEST times as much, one
// whose bodies are not ALIKE by FAR, or where the rest of the world cannot make up for them. Moved is a row whose speed
// it changed by more than span.still + share times what the impulses of the step have changed the velocity of the
// faster body by, beyond span.fall, most at most, or than span.still + least where that is more. Parameters: columns,
// row_body, bodies, predicted, change, first, last, span, shares: share, most, least and FARTHEST. Stands behind
// prelude.h, bodies.h.
#if defined(__CUDA_ARCH__)
return 0;  // a GPU counts row by row
#else
const Real* const before = (const Real*)predicted.data;
const Real share = shares[0], most = shares[1], least = shares[2], farthest_of_all = shares[3];
const int all = LANES * (span.last - span.first);
int count = 0;
for (int b = first; b < last; ++b) {
    const int* const index = row_body.data + (size_t)b * 2 * LANES;
    const Real* const block = columns.data + (size_t)b * COLUMNS * LANES;
    const Real* const d = change.data + (size_t)b * 2 * LANES;
    const Vector en = load(block + AT_en), et = load(block + AT_et);
    const Bodies A = load_bodies(index), B = load_bodies(index + LANES);
    auto pushed = [&](const Bodies& now, const int* i) {
        const Bodies then = load_from(before, i);
        return larger(magnitude(now.x - then.x), magnitude(now.y - then.y));
    };
    const Vector given = larger(pushed(A, index), pushed(B, index + LANES));
    const Vector part = smaller(share * (given - span.fall), zero + most);
    const Vector limit = span.still + larger(part, zero + least);
    const Vector dn = magnitude(load(d)), dt = magnitude(load(d + LANES));
    const Vector n = limit * en, t = limit * et;
    // NaN is moved, and farthest
    const auto moved = ~((dn <= n) & (dt <= t)), far = ~((dn <= (Real)FAR * n) & (dt <= (Real)FAR * t));
    const Vector heavier = smaller(A.m, B.m), lighter = larger(A.m, B.m);
    const auto unlike = (heavier > 0) & (lighter > (Real)ALIKE * heavier);
    const auto farthest = ~((dn <= farthest_of_all * n) & (dt <= farthest_of_all * t)) | (far & unlike);
    const auto moves = en > zero;
    int away = 0;
    for (int lane = 0; lane < LANES; ++lane) {
        count += (int)moves[lane] - MOVING * (int)moved[lane] - SCARCE * (int)far[lane];  // a true lane is -1
        away |= (int)farthest[lane];
    }
    if (away || count > all) return ASTRAY;
}
return count;
#endif
