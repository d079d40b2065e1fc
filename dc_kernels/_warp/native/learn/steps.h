// Steps of the contacts of the k-th world read, LANES contacts side by side; their sums at the bodies; squares of the
// last two on a coarse grid; the extrapolation near each contact; and the scales of the world.
// Parameters: k, settings, model, state, contacts, rows, bodies, stats, reading. Macros: WIDTH, EN, ET, BIAS (of a
// block of rows), UNKNOWN. Behind learn/lanes.h, solve/bodies.h, side.h.
#if !defined(__CUDA_ARCH__)
const int base = reading.packed_start.data[k], count = reading.packed_start.data[k + 1] - base;
const int w = reading.active.data[k], first = contacts.contact_start.data[w];
const auto& now = stats.iteration.data[w];
const bool begins = settings.begin != 0;
const Real tiny = (Real)1e-20;
const int* const body_a = contacts.body_a.data + first;
const int* const body_b = contacts.body_b.data + first;
const int* const slot_of = rows.slot.data + first;
const Real* const impulse = (const Real*)contacts.impulse.data + 2 * (size_t)first;
const Real* const friction = contacts.friction.data + first;
const Real* const positions = (const Real*)state.position.data;
Real* const step = (Real*)reading.step.data + 2 * (size_t)base;
Real* const place = (Real*)reading.place.data + 2 * (size_t)base;
// Contacts i0, i0 + 1, ... of the world; a last one fills the lanes behind the end.
struct Block {
    int lanes, own[LANES], a[LANES], b[LANES], slot[LANES];
    Vector nx, ny, x, y;  // normal; impulse along it and along the tangent (ny, -nx)
};
auto pairs_of = [&](const void* all, const int* at, Vector& x, Vector& y) { pairs_at((const Real*)all, at, x, y); };
auto block_at = [&](int i0) {
    Block c;
    c.lanes = count - i0 < LANES ? count - i0 : LANES;
    for (int j = 0; j < LANES; ++j) {
        const int i = i0 + (j < c.lanes ? j : c.lanes - 1);
        c.own[j] = i;
        c.a[j] = body_a[i];
        c.b[j] = body_b[i];
        c.slot[j] = slot_of[i];
    }
    pairs_of((const Real*)contacts.normal.data + 2 * (size_t)first, c.own, c.nx, c.ny);
    pairs_of(impulse, c.own, c.x, c.y);
    return c;
};
struct Alone {
    Vector free_n, free_t, n, t;  // unprojected step of a contact alone, and the projected one
};
auto step_alone = [&](const Block& c, const Bodies& a, const Bodies& b) {
    int row[3][LANES];
    for (int j = 0; j < LANES; ++j) {
        const int at = c.slot[j] / (2 * LANES) * WIDTH + c.slot[j] % (2 * LANES);
        row[0][j] = at + EN;
        row[1][j] = at + ET;
        row[2][j] = at + BIAS;
    }
    Vector ax, ay, bx, by;
    pairs_of((const Real*)contacts.arm_a.data + 2 * (size_t)first, c.own, ax, ay);
    pairs_of((const Real*)contacts.arm_b.data + 2 * (size_t)first, c.own, bx, by);
    const Real* const column = rows.column.data;
    // speed of B against A at the contact
    const Vector vx = (b.x - b.w * by) - (a.x - a.w * ay), vy = (b.y + b.w * bx) - (a.y + a.w * ax);
    const Vector vn = c.nx * vx + c.ny * vy, vt = c.ny * vx - c.nx * vy;
    Alone s;
    s.free_n = -values_at(column, row[0]) * (vn + values_at(column, row[2]));
    s.free_t = -values_at(column, row[1]) * vt;
    const Vector n = larger(c.x + s.free_n, zero), limit = values_at(friction, c.own) * n;
    s.n = n - c.x;
    s.t = clamp(c.y + s.free_t, limit) - c.y;
    return s;
};
// the coarse grid: the lower left of four nodes around a place, moved into the grid, and its shares of the cell
const int coarse_rows = reading.squares.shape[2], coarse_columns = reading.squares.shape[3];
Real* const squares = reading.squares.data + 2 * (size_t)k * coarse_rows * coarse_columns;
Real* const squares_before = squares + (size_t)coarse_rows * coarse_columns;
const Real* const grid_origin = (const Real*)reading.grid_origin.data + 2 * (size_t)k;
struct Cell {
    Integers node;
    Vector weight[4];  // lower left, lower right, upper left, upper right
};
auto cell_at = [&](Vector px, Vector py) {
    const Vector u = larger((px - grid_origin[0]) / settings.rate_spacing, zero);
    const Vector v = larger((py - grid_origin[1]) / settings.rate_spacing, zero);
    const Vector i = smaller(__builtin_elementwise_floor(u), zero + (Real)(coarse_columns - 2));
    const Vector j = smaller(__builtin_elementwise_floor(v), zero + (Real)(coarse_rows - 2));
    const Vector x = smaller(u - i, zero + 1), y = smaller(v - j, zero + 1);
    const Integers node = __builtin_convertvector(j, Integers) * coarse_columns + __builtin_convertvector(i, Integers);
    return Cell{node, {(1 - x) * (1 - y), x * (1 - y), (1 - x) * y, x * y}};
};
const int corner[4] = {0, 1, coarse_columns, coarse_columns + 1};

for (int body = model.body_start.data[w]; body < model.body_start.data[w + 1]; ++body)
    *((Quad*)reading.body_sum.data + body) = 0;
if (!begins)
    for (int i = 0; i < 2 * coarse_rows * coarse_columns; ++i) squares[i] = 0;
Vector squared = zero, carried = zero;
for (int i0 = 0; i0 < count; i0 += LANES) {
    const Block c = block_at(i0);
    Vector px, py, arm_x, arm_y, n, t;
    pairs_of(positions, c.a, px, py);
    pairs_of((const Real*)contacts.arm_a.data + 2 * (size_t)first, c.own, arm_x, arm_y);
    px += arm_x;
    py += arm_y;
    store_pairs(place + 2 * i0, px, py, c.lanes);
    Vector valid = zero;
    for (int j = 0; j < c.lanes; ++j) valid[j] = 1;
    if (begins) {
        const Alone s = step_alone(c, load_bodies(c.a), load_bodies(c.b));
        n = s.n;
        t = s.t;
    } else {
        int tangent[LANES];
        for (int j = 0; j < LANES; ++j) tangent[j] = c.slot[j] + LANES;
        n = values_at(rows.change.data, c.slot);
        t = values_at(rows.change.data, tangent);
        const Vector bn = values_at(rows.before.data, c.slot), bt = values_at(rows.before.data, tangent);
        const Vector square = n * n + t * t, then = bn * bn + bt * bt;
        const Cell cell = cell_at(px, py);
        for (int j = 0; j < c.lanes; ++j)
            for (int q = 0; q < 4; ++q) {
                squares[cell.node[j] + corner[q]] += cell.weight[q][j] * square[j];
                squares_before[cell.node[j] + corner[q]] += cell.weight[q][j] * then[j];
            }
    }
    store_pairs(step + 2 * i0, n, t, c.lanes);
    squared += valid * (n * n + t * t);
    carried += valid * (c.x * c.x + c.y * c.y);
    const Vector sx = n * c.nx + t * c.ny, sy = n * c.ny - t * c.nx;
    for (int j = 0; j < c.lanes; ++j) {
        *((Quad*)reading.body_sum.data + c.a[j]) += Quad{-sx[j], -sy[j], 1, 0};
        *((Quad*)reading.body_sum.data + c.b[j]) += Quad{sx[j], sy[j], 1, 0};
    }
}
const Real sigma = wp::sqrt(total(squared) / (Real)count) + tiny, size = wp::sqrt(total(carried) / (Real)count) + tiny;
const Real larger_size = sigma > size ? sigma : size;
if (larger_size < reading.least.data[w]) reading.least.data[w] = larger_size;
// A = r / (1 - r) of the ratio r of two steps, from their squares, up to a cap
auto extrapolation_of = [&](Vector last, Vector then) {
    const Vector ratio = root(last / (then + tiny));
    return ratio < settings.cap * (1 - ratio) ? ratio / (1 - ratio) : zero + settings.cap;
};
const Real world_rate = begins ? (Real)UNKNOWN : extrapolation_of(zero + now.step_last, zero + now.step_before)[0];
const Real wide = 1 + world_rate;
*((Quad*)reading.scale.data + k) = Quad{sigma, size, world_rate, sigma * wide};
for (int i0 = 0; i0 < count; i0 += LANES) {
    const int lanes = count - i0 < LANES ? count - i0 : LANES;
    Vector rate = zero + (Real)UNKNOWN;
    if (!begins) {
        Vector px, py;
        int own[LANES];
        for (int j = 0; j < LANES; ++j) own[j] = i0 + (j < lanes ? j : lanes - 1);
        pairs_of(place, own, px, py);
        const Cell cell = cell_at(px, py);
        Vector last = zero, then = zero;
        for (int q = 0; q < 4; ++q) {
            int node[LANES];
            *(Integers*)node = cell.node + corner[q];
            last += cell.weight[q] * values_at(squares, node);
            then += cell.weight[q] * values_at(squares_before, node);
        }
        rate = extrapolation_of(last, then);
    }
    if (lanes == LANES)
        store(reading.rate.data + base + i0, rate);
    else
        for (int j = 0; j < lanes; ++j) reading.rate.data[base + i0 + j] = rate[j];
}
#endif
