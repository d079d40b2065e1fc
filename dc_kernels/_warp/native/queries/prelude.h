// Rounded convex polygons, counter-clockwise, and what a query asks of one. Macros: REAL, LANES, SEGMENT,
// MAX_CORNERS (of the sum of two shapes), MAX_LEVELS, ROUNDING (slack, of a coordinate), MOST (the largest
// number), FLAT (of a size: what counts as one side).
#if !defined(__CUDA_ARCH__)
typedef bool Booleans __attribute__((ext_vector_type(LANES)));
struct Hull {
    int corners;
    Real radius, x[MAX_CORNERS], y[MAX_CORNERS];
};
auto root = [](Real a) { return (Real)__builtin_sqrt(a); };
auto size_of = [](Real a) { return a < 0 ? -a : a; };
// The core of a shape in its body's frame: a disc has one corner, a capsule and a segment two.
auto core_of = [&](int s, Hull& hull) {
    const int first = model.vertex_start.data[s];
    hull.corners = model.shape_type.data[s] == SEGMENT ? 2 : model.vertex_start.data[s + 1] - first;
    hull.radius = model.shape_radius.data[s];
    for (int k = 0; k < hull.corners; ++k) {
        hull.x[k] = model.vertices.data[first + k][0];
        hull.y[k] = model.vertices.data[first + k][1];
    }
};
// Signed distance of a point to the core, negative within, and the unit vector along which it is taken.
auto distance_to = [&](const Hull& hull, Real px, Real py, Real& nx, Real& ny) -> Real {
    const int n = hull.corners;
    if (n == 1) {
        const Real rx = px - hull.x[0], ry = py - hull.y[0], r = root(rx * rx + ry * ry);
        nx = r > 0 ? rx / r : 0;
        ny = r > 0 ? ry / r : 1;
        return r;
    }
    Real least = -1, best_x = 0, best_y = 0, deepest = -MOST, deep_x = 0, deep_y = 1;
    bool within = n > 2;
    for (int k = 0; k < n; ++k) {
        const int next = k + 1 < n ? k + 1 : 0;
        const Real ex = hull.x[next] - hull.x[k], ey = hull.y[next] - hull.y[k], square = ex * ex + ey * ey;
        if (!(square > 0)) continue;
        const Real rx = px - hull.x[k], ry = py - hull.y[k], out = ey * rx - ex * ry;
        if (out > 0) within = false;
        if (within) {
            const Real length = root(square);
            if (out / length > deepest) {
                deepest = out / length;
                deep_x = ey / length;
                deep_y = -ex / length;
            }
        }
        Real along = (ex * rx + ey * ry) / square;
        along = along < 0 ? 0 : along > 1 ? 1 : along;
        const Real cx = rx - along * ex, cy = ry - along * ey, far = cx * cx + cy * cy;
        if (least < 0 || far < least) {
            least = far;
            best_x = cx;
            best_y = cy;
            if (!within && far == 0) {  // on the edge itself
                const Real length = root(square);
                deep_x = ey / length;
                deep_y = -ex / length;
            }
        }
    }
    if (within || !(least > 0)) {
        nx = deep_x;
        ny = deep_y;
        return within ? deepest : 0;
    }
    const Real r = root(least);
    nx = best_x / r;
    ny = best_y / r;
    return r;
};
// The shape in its body's frame as a point of shape A sees it: the Minkowski sum of it and A turned around.
auto add_reversed = [&](const Hull& b, const Hull& a, Hull& sum) {
    sum.radius = a.radius + b.radius;
    sum.corners = 0;
    const int m = a.corners, n = b.corners;
    int i0 = 0, j0 = 0;
    for (int i = 1; i < n; ++i)
        if (b.y[i] < b.y[i0] || (b.y[i] == b.y[i0] && b.x[i] < b.x[i0])) i0 = i;
    for (int j = 1; j < m; ++j)
        if (a.y[j] > a.y[j0] || (a.y[j] == a.y[j0] && a.x[j] > a.x[j0])) j0 = j;
    int i = n == 1 ? 1 : 0, j = m == 1 ? 1 : 0;
    do {
        const int bi = (i0 + (n == 1 ? 0 : i)) % n, aj = (j0 + (m == 1 ? 0 : j)) % m;
        sum.x[sum.corners] = b.x[bi] - a.x[aj];
        sum.y[sum.corners++] = b.y[bi] - a.y[aj];
        if (i >= n && j >= m) break;
        const int bn = (bi + 1) % n, an = (aj + 1) % m;
        const Real ex = b.x[bn] - b.x[bi], ey = b.y[bn] - b.y[bi], fx = a.x[aj] - a.x[an], fy = a.y[aj] - a.y[an];
        const Real turn = ex * fy - ey * fx;
        const bool first = i < n && (j >= m || turn >= 0), second = j < m && (i >= n || turn <= 0);
        i += first;
        j += second;
    } while ((i < n || j < m) && sum.corners < MAX_CORNERS);
};
// Where along a translation, in parts of it, a point meets a hull, at most `most`; -1 where it does not. The normal is
// zero where it is within from the beginning.
auto cast = [&](const Hull& hull, Real ox, Real oy, Real dx, Real dy, Real most, Real& nx, Real& ny) -> Real {
    const int n = hull.corners;
    const Real r = hull.radius;
    if (r > 0 || n > 2) {
        Real ux, uy;
        if (distance_to(hull, ox, oy, ux, uy) <= r) {
            nx = ny = 0;
            return 0;
        }
    }
    if (n > 2 && !(r > 0)) {  // Cyrus and Beck 1978: no ray slips between two edges
        Real lower = 0, upper = most;
        int entered = -1;
        for (int k = 0; k < n; ++k) {
            const int next = k + 1 < n ? k + 1 : 0;
            const Real fx = hull.y[next] - hull.y[k], fy = hull.x[k] - hull.x[next];
            const Real ahead = fx * (hull.x[k] - ox) + fy * (hull.y[k] - oy), speed = fx * dx + fy * dy;
            if (speed == 0) {
                if (ahead < 0) return -1;
            } else if (speed < 0) {
                if (ahead < lower * speed) {
                    lower = ahead / speed;
                    entered = k;
                }
            } else if (ahead < upper * speed) {
                upper = ahead / speed;
            }
            if (upper < lower) return -1;
        }
        if (entered < 0) return -1;
        const int next = entered + 1 < n ? entered + 1 : 0;
        const Real fx = hull.y[next] - hull.y[entered], fy = hull.x[entered] - hull.x[next];
        const Real length = root(fx * fx + fy * fy);
        nx = fx / length;
        ny = fy / length;
        return lower;
    }
    Real best = most;
    bool met = false;
    for (int k = 0; k < n && n > 1; ++k) {  // sides, moved out by the radius
        const int next = k + 1 < n ? k + 1 : 0;
        const Real ex = hull.x[next] - hull.x[k], ey = hull.y[next] - hull.y[k], square = ex * ex + ey * ey;
        const Real speed = ey * dx - ex * dy;
        if (!(speed < 0)) continue;
        const Real length = root(square);
        const Real t = (ey * (hull.x[k] - ox) - ex * (hull.y[k] - oy) + r * length) / speed;
        if (!(t >= 0 && t <= best)) continue;
        const Real along = ex * (ox + t * dx - hull.x[k]) + ey * (oy + t * dy - hull.y[k]);
        const Real slack = r > 0 ? 0 : ROUNDING * square;
        if (!(along >= -slack && along <= square + slack)) continue;
        best = t;
        met = true;
        nx = ey / length;
        ny = -ex / length;
    }
    const Real square = dx * dx + dy * dy;
    for (int k = 0; k < n && r > 0 && square > 0; ++k) {  // corners
        const Real mx = ox - hull.x[k], my = oy - hull.y[k], nearest = -(mx * dx + my * dy) / square;
        const Real miss = mx * dy - my * dx, half = r * r - miss * miss / square;
        if (!(half >= 0)) continue;
        const Real t = nearest - root(half / square);
        if (!(t >= 0 && t <= best)) continue;
        best = t;
        met = true;
        nx = mx + t * dx;
        ny = my + t * dy;
        const Real length = root(nx * nx + ny * ny);  // of a far ray not r itself
        nx = length > 0 ? nx / length : -dx / root(square);
        ny = length > 0 ? ny / length : -dy / root(square);
    }
    return met ? best : (Real)-1;
};
// The levels of a world's tree: where the nodes of each begin, and how many children they have, 8 a node. The last
// level is the root.
auto levels_of = [&](int w, int* level, int* children) -> int {
    int at = tree.node_start.data[w], n = model.shape_start.data[w + 1] - model.shape_start.data[w], levels = 0;
    while (n > 0) {
        children[levels] = n;
        level[levels++] = at;
        n = (n + LANES - 1) / LANES;
        at += n;
        if (n == 1) break;
    }
    return levels;
};
struct Visit {
    int node, level;
    Real key;
};
// Visits the shapes of a world whose boxes `look` wants, the least key first, while keys are not above `limit`.
auto walk = [&](int w, auto&& look, auto&& limit, auto&& visit) {
    int level[MAX_LEVELS], children[MAX_LEVELS];
    const int levels = levels_of(w, level, children);
    if (levels == 0) return;
    Visit stack[MAX_LEVELS * LANES];
    stack[0] = {level[levels - 1], levels - 1, limit()};
    int size = 1;
    while (size > 0) {
        const Visit at = stack[--size];
        if (at.key > limit()) continue;
        const int rest = children[at.level] - (at.node - level[at.level]) * LANES;
        Vector key;
        unsigned bits = look(tree.box.data + (size_t)at.node * 4 * LANES, key);
        if (rest < LANES) bits &= (1u << rest) - 1;
        const int bottom = size;
        for (; bits; bits &= bits - 1) {
            const int i = __builtin_ctz(bits);
            if (at.level == 0) {
                if (key[i] <= limit()) visit(tree.sorted_shape.data[(size_t)at.node * LANES + i]);
                continue;
            }
            const int child = level[at.level - 1] + (at.node - level[at.level]) * LANES + i;
            int to = size++;
            for (; to > bottom && stack[to - 1].key < key[i]; --to) stack[to] = stack[to - 1];
            stack[to] = {child, at.level - 1, key[i]};
        }
    }
};
auto bits_of = [](auto test) -> unsigned {
    return __builtin_bit_cast(unsigned char, __builtin_convertvector(test, Booleans));
};
// How far a hull reaches along a unit vector, and from where to where its front does along the tangent (ny, -nx).
auto front_of = [&](const Hull& hull, Real nx, Real ny, Real* span) -> Real {
    Real front = -MOST, size = 0;
    for (int k = 0; k < hull.corners; ++k) {
        const Real out = hull.x[k] * nx + hull.y[k] * ny, far = size_of(hull.x[k]) + size_of(hull.y[k]);
        front = out > front ? out : front;
        size = far > size ? far : size;
    }
    span[0] = MOST;
    span[1] = -MOST;
    for (int k = 0; k < hull.corners; ++k) {
        if (hull.x[k] * nx + hull.y[k] * ny < front - FLAT * size) continue;
        const Real along = hull.x[k] * ny - hull.y[k] * nx;
        span[0] = along < span[0] ? along : span[0];
        span[1] = along > span[1] ? along : span[1];
    }
    return front + hull.radius;
};
#endif
