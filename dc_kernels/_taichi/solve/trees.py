"""The direct solve of joints whose bodies form trees, beside the sweeps: exact whatever the masses, in linear time.

Sweeps alone converge badly where a light chain carries a heavy load. Contacts, limits, motors, rods, and joints that
close a loop, stay with the sweeps. Everything here is in float64, whatever the scalar: of a light link between heavy
bodies little is left of large numbers. A joint has SIZE rows at most, its parent is the body nearer to the root, its
child the other one, -1 if that is fixed.
"""

from functools import cache
from types import SimpleNamespace

from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels.solve.joints import TREE_JOINT, TREE_MOVES
from dc_kernels.solve.rows import COLUMNS, LANES

SIZE = 3
LEAST = 1e-9  # a pivot below this share of its row's own mass is that of a row that others hold already
# What is kept of a joint: D^-1; G, three numbers of each row; Jacobians at the parent and at the child; what a row is
# off by without its bodies' velocities; softness; inverse inertia of parent and child.
GAIN, PARENT, CHILD, OFF, SOFT, INERTIA = 9, 18, 27, 36, 39, 42
# Of a body six numbers of its mobility (xx, yy, ww, xy, xw, yw), three of what it moves by, three of the impulse on it.
MOVED, PUSHED = 6, 9
f64, i32 = ti.f64, ti.i32
vec3 = ti.types.vector(3, ti.f64)


@ti.func
def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@ti.func
def load(numbers: ti.template(), at):
    """Three numbers that follow each other."""
    return vec3(numbers[at], numbers[at + 1], numbers[at + 2])


@ti.func
def store(numbers: ti.template(), at, v):
    for n in ti.static(range(3)):
        numbers[at + n] = v[n]


@ti.func
def times(numbers: ti.template(), at, v):
    """A mobility times an impulse."""
    xx = numbers[at]
    yy = numbers[at + 1]
    ww = numbers[at + 2]
    xy = numbers[at + 3]
    xw = numbers[at + 4]
    yw = numbers[at + 5]
    return vec3(
        xx * v[0] + xy * v[1] + xw * v[2],
        xy * v[0] + yy * v[1] + yw * v[2],
        xw * v[0] + yw * v[1] + ww * v[2],
    )


@cache
def tree_functions(dtype: str, variant: str) -> SimpleNamespace:
    """``factor`` and ``solve`` a tree; how many of its rows ``lack`` more than ``still`` of their speed.

    ``bodies`` are velocities, or with ``places`` 1 displacements, of which a ``share`` of what is off, up to ``limit``,
    is removed.
    """
    t = group_types(dtype)
    real, vec4 = t.real, t.vec4
    columns = COLUMNS[variant]
    width = len(columns)
    NX, NY, RAN, RBN, IA, IB = (columns.index(c) for c in ("nx", "ny", "rAn", "rBn", "iA", "iB"))
    EN, BIAS, GAP, AX, AY, SOFTNESS, HELD = (
        columns.index(c) for c in ("en", "bias", "gap", "ax", "ay", "soft", "held")
    )

    @ti.func
    def place_of(q, i, rows: t.Rows):
        """Of row i of joint q: its block's first column, its block's first bodies, its lane."""
        slot = rows.row_slot[rows.tree_row[q] + i]
        return slot // (2 * LANES) * width, slot // LANES, slot % LANES

    @ti.func
    def jacobian(k, lane, second, rows: t.Rows):
        """The Jacobian of a row at its body B where ``second`` is 1, else at A."""
        at = vec3(
            f64(rows.column[k + AX][lane]) * -1.0,
            f64(rows.column[k + AY][lane]) * -1.0,
            f64(rows.column[k + RAN][lane]) * -1.0,
        )
        if second == 1:
            at = vec3(f64(rows.column[k + NX][lane]), f64(rows.column[k + NY][lane]), f64(rows.column[k + RBN][lane]))
        return at

    @ti.func
    def counts(k, lane, places, rows: t.Rows):
        """Whether a row is solved: not if nothing can move along it, nor where the position phase leaves it alone."""
        return rows.column[k + EN][lane] > 0.0 and not (places == 1 and rows.column[k + HELD][lane] == 0.0)

    @ti.func
    def velocity_of(bodies: ti.template(), body):
        return vec3(f64(bodies[body][0]), f64(bodies[body][1]), f64(bodies[body][2]))

    @ti.func
    def put_off(q, places, bodies: ti.template(), rows: t.Rows):
        """What the rows of joint q are off by without what their bodies move; 0 where they are to be factored anew."""
        parent = rows.tree_parent[q]
        same = 1
        for i in range(rows.tree_size[q]):
            k, r, lane = place_of(q, i, rows)
            off = f64(rows.column[k + BIAS][lane])
            if places == 1:
                off = f64(rows.column[k + GAP][lane])
                still = rows.column[k + EN][lane] > 0.0 and rows.column[k + HELD][lane] == 0.0
                if still or rows.tree_factor[q * TREE_JOINT + SOFT + i] != 0.0:
                    same = 0
            if rows.tree_child[q] < 0:
                second = i32(rows.body[r][lane] == parent)
                along = jacobian(k, lane, second, rows)
                off = off + dot(along, velocity_of(bodies, rows.body[r + second][lane]))
            rows.tree_factor[q * TREE_JOINT + OFF + i] = off
        return same

    @ti.func
    def begin(q, bodies: ti.template(), rows: t.Rows):
        """The mobilities of both bodies of joint q alone; nothing is kept of its rows."""
        kept = q * TREE_JOINT
        for i in range(OFF):
            rows.tree_factor[kept + i] = 0.0
        k, r, lane = place_of(q, 0, rows)
        for side in range(2):
            body = rows.tree_parent[q]
            if side == 1:
                body = rows.tree_child[q]
            if body >= 0:
                m = body * TREE_MOVES
                for i in range(TREE_MOVES):
                    rows.tree_moves[m + i] = 0.0
                mass = f64(ti.max(bodies[body][3], 0.0))
                inertia = f64(rows.column[k + IB][lane])
                if rows.body[r][lane] == body:
                    inertia = f64(rows.column[k + IA][lane])
                rows.tree_moves[m] = mass
                rows.tree_moves[m + 1] = mass
                rows.tree_moves[m + 2] = inertia
                rows.tree_factor[kept + INERTIA + side] = inertia

    @ti.func
    def invert(kept, size, own, rows: t.Rows):
        """The inverse of D, in its place, by Gauss-Jordan steps; rows without a pivot of their own are left out."""
        solved = 0
        for p in range(size):
            pivot = rows.tree_factor[kept + 4 * p]
            mass = own[0]
            if p == 1:
                mass = own[1]
            if p == 2:
                mass = own[2]
            if pivot > f64(LEAST) * mass and mass > 0.0:
                solved = solved | (1 << p)
                for i in range(size):
                    for k in range(size):
                        if i != p and k != p:
                            product = rows.tree_factor[kept + 3 * i + p] * rows.tree_factor[kept + 3 * p + k]
                            at = kept + 3 * i + k
                            rows.tree_factor[at] = rows.tree_factor[at] - product / pivot
                for i in range(size):
                    if i != p:
                        rows.tree_factor[kept + 3 * i + p] = rows.tree_factor[kept + 3 * i + p] / pivot
                        rows.tree_factor[kept + 3 * p + i] = rows.tree_factor[kept + 3 * p + i] / pivot
                rows.tree_factor[kept + 4 * p] = f64(-1.0) / pivot
        for i in range(size):
            for k in range(size):
                at = kept + 3 * i + k
                inverse = rows.tree_factor[at] * -1.0
                rows.tree_factor[at] = 0.0
                if (solved >> i) & (solved >> k) & 1 == 1:
                    rows.tree_factor[at] = inverse

    @ti.func
    def eliminate(q, places, rows: t.Rows):
        """D^-1 and G = W J^T D^-1 of joint q, and what its parent has left of its mobility W."""
        kept = q * TREE_JOINT
        size = rows.tree_size[q]
        parent = rows.tree_parent[q]
        child = rows.tree_child[q]
        m = parent * TREE_MOVES
        own = vec3(0.0, 0.0, 0.0)
        for i in ti.static(range(SIZE)):
            if i < size:
                k, r, lane = place_of(q, i, rows)
                second = i32(rows.body[r][lane] != parent)
                rows.tree_factor[kept + SOFT + i] = 0.0
                if counts(k, lane, places, rows):
                    at = jacobian(k, lane, second, rows)
                    store(rows.tree_factor, kept + PARENT + 3 * i, at)
                    store(rows.tree_factor, kept + GAIN + 3 * i, times(rows.tree_moves, m, at))
                    if child >= 0:
                        store(rows.tree_factor, kept + CHILD + 3 * i, jacobian(k, lane, 1 - second, rows))
                    own[i] = f64(1.0) / f64(rows.column[k + EN][lane])
                    soft = f64(rows.column[k + SOFTNESS][lane])
                    rows.tree_factor[kept + SOFT + i] = soft
                    rows.tree_factor[kept + 4 * i] = soft
        for k in range(size):
            of_parent = load(rows.tree_factor, kept + GAIN + 3 * k)
            of_child = vec3(0.0, 0.0, 0.0)
            if child >= 0:
                of_child = times(rows.tree_moves, child * TREE_MOVES, load(rows.tree_factor, kept + CHILD + 3 * k))
            for i in range(size):
                at = kept + 3 * i + k
                d = rows.tree_factor[at] + dot(load(rows.tree_factor, kept + PARENT + 3 * i), of_parent)
                rows.tree_factor[at] = d + dot(load(rows.tree_factor, kept + CHILD + 3 * i), of_child)
        invert(kept, size, own, rows)
        v0 = load(rows.tree_factor, kept + GAIN)
        v1 = load(rows.tree_factor, kept + GAIN + 3)
        v2 = load(rows.tree_factor, kept + GAIN + 6)
        for i in range(size):
            v = v0
            if i == 1:
                v = v1
            if i == 2:
                v = v2
            g = v0 * rows.tree_factor[kept + i]
            if size > 1:
                g = g + v1 * rows.tree_factor[kept + 3 + i]
            if size > 2:
                g = g + v2 * rows.tree_factor[kept + 6 + i]
            store(rows.tree_factor, kept + GAIN + 3 * i, g)
            rows.tree_moves[m] = rows.tree_moves[m] - g[0] * v[0]
            rows.tree_moves[m + 1] = rows.tree_moves[m + 1] - g[1] * v[1]
            rows.tree_moves[m + 2] = rows.tree_moves[m + 2] - g[2] * v[2]
            rows.tree_moves[m + 3] = rows.tree_moves[m + 3] - (g[0] * v[1] + g[1] * v[0]) / f64(2.0)
            rows.tree_moves[m + 4] = rows.tree_moves[m + 4] - (g[0] * v[2] + g[2] * v[0]) / f64(2.0)
            rows.tree_moves[m + 5] = rows.tree_moves[m + 5] - (g[1] * v[2] + g[2] * v[1]) / f64(2.0)

    @ti.func
    def factor(tree, places, bodies: ti.template(), rows: t.Rows):
        """Elimination of the joints, leaves first (Baraff 1996; Featherstone 2008 for a body that carries others).

        J M^-1 J^T of the tree is factored without fill. For displacements (places 1) the factors of velocities serve
        again where the rows are the same.
        """
        first = rows.tree_first[tree]
        last = rows.tree_first[tree + 1]
        factored = places
        for q in range(first, last):
            if put_off(q, places, bodies, rows) == 0:
                factored = 0
        if factored == 0:
            for q in range(first, last):
                begin(q, bodies, rows)
            for q in range(first, last):
                eliminate(q, places, rows)

    @ti.func
    def rise(q, places, share, limit, bodies: ti.template(), rows: t.Rows):
        """What the rows of joint q want without what follows nearer to the root, and what its parent moves by."""
        kept = q * TREE_JOINT
        size = rows.tree_size[q]
        parent = rows.tree_parent[q]
        child = rows.tree_child[q]
        up = parent * TREE_MOVES + MOVED
        of_parent = velocity_of(bodies, parent)
        of_child = vec3(0.0, 0.0, 0.0)
        moved = vec3(0.0, 0.0, 0.0)
        if child >= 0:
            of_child = velocity_of(bodies, child)
            moved = load(rows.tree_moves, child * TREE_MOVES + MOVED)
        moves = load(rows.tree_moves, up)
        s = vec3(0.0, 0.0, 0.0)
        for i in ti.static(range(SIZE)):
            if i < size:
                at_parent = load(rows.tree_factor, kept + PARENT + 3 * i)
                at_child = load(rows.tree_factor, kept + CHILD + 3 * i)
                given = f64(0.0)
                if places == 0:
                    _, r, lane = place_of(q, i, rows)
                    given = rows.tree_factor[kept + SOFT + i] * f64(rows.impulse[r][lane])
                off = rows.tree_factor[kept + OFF + i] + given
                off = f64(share) * ((off + dot(at_parent, of_parent)) + dot(at_child, of_child))
                if places == 1:
                    most = f64(limit)
                    if off < most * -1.0:
                        off = most * -1.0
                    elif off > most:
                        off = most
                s[i] = ((off + dot(at_parent, moves)) + dot(at_child, moved)) * -1.0
        for i in range(size):
            wanted = f64(0.0)
            for k in ti.static(range(SIZE)):
                if k < size:
                    wanted = wanted + rows.tree_factor[kept + 3 * i + k] * s[k]
            rows.tree_wanted[q * SIZE + i] = wanted
        for i in ti.static(range(SIZE)):
            if i < size:
                moves = moves + load(rows.tree_factor, kept + GAIN + 3 * i) * s[i]
        store(rows.tree_moves, up, moves)

    @ti.func
    def descend(q, places, rows: t.Rows):
        """The impulses of joint q, with what its parent has of those nearer to the root."""
        kept = q * TREE_JOINT
        size = rows.tree_size[q]
        child = rows.tree_child[q]
        down = rows.tree_parent[q] * TREE_MOVES + PUSHED
        push = load(rows.tree_moves, down)
        x = vec3(0.0, 0.0, 0.0)
        for i in ti.static(range(SIZE)):
            if i < size:
                x[i] = rows.tree_wanted[q * SIZE + i] - dot(load(rows.tree_factor, kept + GAIN + 3 * i), push)
        for i in ti.static(range(SIZE)):
            if i < size:
                push = push + load(rows.tree_factor, kept + PARENT + 3 * i) * x[i]
                if child >= 0:
                    at = child * TREE_MOVES + PUSHED
                    on_child = load(rows.tree_moves, at)
                    store(rows.tree_moves, at, on_child + load(rows.tree_factor, kept + CHILD + 3 * i) * x[i])
                if places == 0:
                    _, r, lane = place_of(q, i, rows)
                    rows.impulse[r][lane] = ti.cast(f64(rows.impulse[r][lane]) + x[i], real)
                    rows.change[r][lane] = ti.cast(f64(rows.change[r][lane]) + x[i], real)
        store(rows.tree_moves, down, push)

    @ti.func
    def move(body, inertia, bodies: ti.template(), rows: t.Rows):
        """What the impulses on a body change its velocity by; nothing where there is none."""
        if body >= 0:
            m = body * TREE_MOVES
            v = bodies[body]
            mass = f64(ti.max(v[3], 0.0))
            bodies[body] = vec4(
                ti.cast(f64(v[0]) + mass * rows.tree_moves[m + PUSHED], real),
                ti.cast(f64(v[1]) + mass * rows.tree_moves[m + PUSHED + 1], real),
                ti.cast(f64(v[2]) + inertia * rows.tree_moves[m + PUSHED + 2], real),
                v[3],
            )
            for n in range(MOVED, TREE_MOVES):
                rows.tree_moves[m + n] = 0.0

    @ti.func
    def solve(tree, places, share, limit, bodies: ti.template(), rows: t.Rows):
        """The impulses that make all rows of the tree hold at once, and the velocities with them.

        In the position phase (places 1) the displacements that remove a share of what the rows have drifted by.
        """
        first = rows.tree_first[tree]
        last = rows.tree_first[tree + 1]
        for q in range(first, last):
            rise(q, places, share, limit, bodies, rows)
        for n in range(last - first):
            descend(last - 1 - n, places, rows)
        for q in range(first, last):
            move(rows.tree_child[q], rows.tree_factor[q * TREE_JOINT + INERTIA + 1], bodies, rows)
        if last > first:  # each body is the child of one joint, but for the root, which is the parent of the last
            move(rows.tree_parent[last - 1], rows.tree_factor[(last - 1) * TREE_JOINT + INERTIA], bodies, rows)

    @ti.func
    def lack(tree, still, rows: t.Rows):
        """Rows of the tree that lacked more than ``still`` of their speed as the last sweep came to them."""
        found = 0
        for q in range(rows.tree_first[tree], rows.tree_first[tree + 1]):
            for i in range(rows.tree_size[q]):
                k, r, lane = place_of(q, i, rows)
                if not (ti.abs(rows.change[r][lane]) <= still * rows.column[k + EN][lane]):  # NaN is lacking
                    found += 1
        return found

    return SimpleNamespace(factor=factor, solve=solve, lack=lack)
