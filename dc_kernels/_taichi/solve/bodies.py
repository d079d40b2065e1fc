"""Velocities of the bodies of LANES rows, a vector for each component, and numbers of theirs that lie anywhere.

Velocities are loaded as vec4 and transposed in registers, as in ``_warp/native/solve/bodies.h``. What makes that as
fast as there:

- A vector whose elements come from two others becomes one shuffle; but LLVM looks through several, and puts together a
  vector of eight others by chains of insertions. The larger of a vector and ``floor``, which is minus infinity without
  the compiler's knowledge, is what it does not look through: with AVX-512 a sweep of discs then takes 1.15 times Warp's
  time in float32, else 1.5 times, and 1.3 and 1.5 times in float64.
- Indices of bodies are loaded one by one: of a vector loaded whole they would be extracted, at 0.3 of the time.

Taichi takes an element of a vector in memory for another place than the vector: after ``rows.body[k] = v`` it may give
``rows.body[k][0]`` of before. ``bodies_at`` takes indices from registers.
"""

from functools import cache
from types import SimpleNamespace

from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels.solve.rows import LANES

INFINITY = float("inf")
# of an index, whose // and % would look at its sign
LAST_LANE = LANES - 1
LANE_BITS = LAST_LANE.bit_length()


@ti.func
def magnitude(v):
    """Absolute values of a vector, element by element."""
    return ti.max(v, v * -1.0)


@ti.func
def total(v):
    """Sum of the lanes, in a fixed order."""
    return ((v[0] + v[1]) + (v[2] + v[3])) + ((v[4] + v[5]) + (v[6] + v[7]))


@ti.func
def largest(v):
    """The largest lane that is above 0, else 0."""
    low = ti.max(ti.max(v[0], v[1]), ti.max(v[2], v[3]))
    return ti.max(ti.max(low, ti.max(ti.max(v[4], v[5]), ti.max(v[6], v[7]))), 0.0)


@ti.func
def values_at(array: ti.template(), at):
    """Eight numbers of an array, wherever they lie."""
    return ti.Vector(
        [
            array[at[0]],
            array[at[1]],
            array[at[2]],
            array[at[3]],
            array[at[4]],
            array[at[5]],
            array[at[6]],
            array[at[7]],
        ]
    )


@ti.func
def pairs_at(array: ti.template(), at):
    """Both components of eight vectors of an array, wherever they lie."""
    p0 = array[at[0]]
    p1 = array[at[1]]
    p2 = array[at[2]]
    p3 = array[at[3]]
    p4 = array[at[4]]
    p5 = array[at[5]]
    p6 = array[at[6]]
    p7 = array[at[7]]
    x = ti.Vector([p0[0], p1[0], p2[0], p3[0], p4[0], p5[0], p6[0], p7[0]])
    y = ti.Vector([p0[1], p1[1], p2[1], p3[1], p4[1], p5[1], p6[1], p7[1]])
    return x, y


@cache
def body_functions(dtype: str) -> SimpleNamespace:
    """``load_bodies`` and ``store_bodies``: of a block, a vector for each component.

    ``indices`` of a block; ``bodies_at`` loads those of given indices, ``pushed`` what they were pushed by;
    ``unknown_floor`` is for all of them (see the module).
    """
    t = group_types(dtype)
    vec4, vec8 = t.vec4, t.vec8

    @ti.func
    def unknown_floor(config: t.Config):
        """Minus infinity, which the compiler does not know."""
        return config.omega * 0.0 - INFINITY

    @ti.func
    def kept(v, floor):
        """A vector that the compiler does not take apart."""
        return ti.select(v < floor, vec8(floor), v)

    @ti.func
    def low_halves(a, b, floor):
        return kept(vec8(a[0], b[0], a[1], b[1], a[4], b[4], a[5], b[5]), floor)

    @ti.func
    def high_halves(a, b, floor):
        return kept(vec8(a[2], b[2], a[3], b[3], a[6], b[6], a[7], b[7]), floor)

    @ti.func
    def low_pairs(a, b):
        return vec8(a[0], a[1], b[0], b[1], a[4], a[5], b[4], b[5])

    @ti.func
    def high_pairs(a, b):
        return vec8(a[2], a[3], b[2], b[3], a[6], a[7], b[6], b[7])

    @ti.func
    def transpose(a, b, c, d, floor):
        """Its own inverse."""
        t0 = low_halves(a, b, floor)
        t1 = low_halves(c, d, floor)
        t2 = high_halves(a, b, floor)
        t3 = high_halves(c, d, floor)
        return low_pairs(t0, t1), high_pairs(t0, t1), low_pairs(t2, t3), high_pairs(t2, t3)

    @ti.func
    def load_pair(bodies: ti.template(), i, j, floor):
        q = bodies[i]
        r = bodies[j]
        return kept(vec8(q[0], q[1], q[2], q[3], r[0], r[1], r[2], r[3]), floor)

    @ti.func
    def store_pair(bodies: ti.template(), i, j, both):
        bodies[i] = vec4(both[0], both[1], both[2], both[3])
        bodies[j] = vec4(both[4], both[5], both[6], both[7])

    @ti.func
    def indices(rows: t.Rows, k):
        """What ``rows.body[k]`` names."""
        return ti.Vector(
            [
                rows.body[k][0],
                rows.body[k][1],
                rows.body[k][2],
                rows.body[k][3],
                rows.body[k][4],
                rows.body[k][5],
                rows.body[k][6],
                rows.body[k][7],
            ]
        )

    @ti.func
    def load_bodies(rows: t.Rows, k, bodies: ti.template(), floor):
        """Velocity (x, y), spin and inverse mass of the bodies that ``rows.body[k]`` names."""
        return transpose(
            load_pair(bodies, rows.body[k][0], rows.body[k][4], floor),
            load_pair(bodies, rows.body[k][1], rows.body[k][5], floor),
            load_pair(bodies, rows.body[k][2], rows.body[k][6], floor),
            load_pair(bodies, rows.body[k][3], rows.body[k][7], floor),
            floor,
        )

    @ti.func
    def bodies_at(bodies: ti.template(), at, floor):
        """``load_bodies`` of those with the indices ``at``."""
        return transpose(
            load_pair(bodies, at[0], at[4], floor),
            load_pair(bodies, at[1], at[5], floor),
            load_pair(bodies, at[2], at[6], floor),
            load_pair(bodies, at[3], at[7], floor),
            floor,
        )

    @ti.func
    def push_of_pair(motion: t.Motion, i, j, floor):
        q = motion.solved[i] - motion.predicted[i]
        r = motion.solved[j] - motion.predicted[j]
        return kept(vec8(q[0], q[1], q[2], q[3], r[0], r[1], r[2], r[3]), floor)

    @ti.func
    def pushed(rows: t.Rows, k, motion: t.Motion, floor):
        """What the impulses of the step have changed the velocities of bodies by, the larger component [m/s]."""
        x, y, _, _ = transpose(
            push_of_pair(motion, rows.body[k][0], rows.body[k][4], floor),
            push_of_pair(motion, rows.body[k][1], rows.body[k][5], floor),
            push_of_pair(motion, rows.body[k][2], rows.body[k][6], floor),
            push_of_pair(motion, rows.body[k][3], rows.body[k][7], floor),
            floor,
        )
        return ti.max(magnitude(x), magnitude(y))

    @ti.func
    def store_bodies(rows: t.Rows, k, bodies: ti.template(), x, y, w, m, floor):
        p0, p1, p2, p3 = transpose(x, y, w, m, floor)
        store_pair(bodies, rows.body[k][0], rows.body[k][4], p0)
        store_pair(bodies, rows.body[k][1], rows.body[k][5], p1)
        store_pair(bodies, rows.body[k][2], rows.body[k][6], p2)
        store_pair(bodies, rows.body[k][3], rows.body[k][7], p3)

    return SimpleNamespace(
        unknown_floor=unknown_floor,
        indices=indices,
        bodies_at=bodies_at,
        load_bodies=load_bodies,
        store_bodies=store_bodies,
        pushed=pushed,
    )
