// W = J M^-1 J^T in rows of 2x2 blocks, from rows of two bodies each: a row's blocks are with the rows of its bodies,
// merged in their order.
// Parameters: body, jacobian, inverse, body_first, body_row, row_start, column, block.
const int n = (int)(body.shape[0] / 2), bodies = (int)body_first.shape[0] - 1;
const double* const j = jacobian.data;
const double* const m = inverse.data;
int* const first = body_first.data;
int* const rows = body_row.data;
auto moves = [&](int end) { return m[3 * end] != 0 || m[3 * end + 1] != 0 || m[3 * end + 2] != 0; };
// the ends (2 row + side) at each body that moves, in their order
for (int b = 0; b <= bodies; ++b) first[b] = 0;
for (int e = 0; e < 2 * n; ++e)
    if (moves(e)) ++first[body.data[e] + 1];
for (int b = 0; b < bodies; ++b) first[b + 1] += first[b];
for (int e = 0; e < 2 * n; ++e)
    if (moves(e)) rows[first[body.data[e]]++] = e;
for (int b = bodies; b > 0; --b) first[b] = first[b - 1];
first[0] = 0;
int blocks = 0;
row_start.data[0] = 0;
for (int i = 0; i < n; ++i) {
    int at[2], end[2];
    double scaled[2][6];
    for (int side = 0; side < 2; ++side) {
        const int e = 2 * i + side, b = body.data[e];
        const bool any = moves(e);
        at[side] = any ? first[b] : 0;
        end[side] = any ? first[b + 1] : 0;
        for (int k = 0; k < 6; ++k) scaled[side][k] = j[6 * e + k] * m[3 * e + k % 3];
    }
    while (at[0] < end[0] || at[1] < end[1]) {
        const int left = at[0] < end[0] ? rows[at[0]] / 2 : n, right = at[1] < end[1] ? rows[at[1]] / 2 : n;
        const int other = left < right ? left : right;
        double sum[4] = {0, 0, 0, 0};
        for (int side = 0; side < 2; ++side) {
            while (at[side] < end[side] && rows[at[side]] / 2 == other) {
                const double* const to = j + 6 * rows[at[side]++];
                const double* const from = scaled[side];
                for (int r = 0; r < 2; ++r)
                    for (int c = 0; c < 2; ++c)
                        sum[2 * r + c] +=
                            from[3 * r] * to[3 * c] + from[3 * r + 1] * to[3 * c + 1] + from[3 * r + 2] * to[3 * c + 2];
            }
        }
        column.data[blocks] = other;
        for (int k = 0; k < 4; ++k) block.data[4 * (size_t)blocks + k] = sum[k];
        ++blocks;
    }
    row_start.data[i + 1] = blocks;
}
