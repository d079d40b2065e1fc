"""What holds in each step of any scene, computed anew in float64 from the public arrays.

Call ``collide``, ``solve``, then ``check_step`` before ``advance``: the state is then that of the step's beginning.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

import dc_kernels as dc
from dc_kernels.measure import contact_slots
from dc_kernels.model.fields import KEY_FEATURE_BITS, KEY_SHAPE_BITS

Array = Any


@dataclass(frozen=True)
class Bounds:
    """How far a step may be from what holds exactly; lengths in ``length_scale``."""

    geometry: float
    """Of a gap and of the limit of the contacts that have to be there [length_scale]."""
    energy: float
    """Of the step's kinetic energy above predicted energy plus work [predicted energy plus work]."""


BOUNDS = {"float64": Bounds(1e-9, 1e-6), "float32": Bounds(1e-4, 1e-2)}
ROUND_OFF = 4.0
"""Of velocities against impulses: so many last digits a sweep, of speed plus the sum of |impulse| / mass [1]."""


def rotation(angle: float) -> Array:
    """The matrix of a turn."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array(((c, -s), (s, c)))


def core(sim: dc.Simulation, shape: int) -> tuple[Array, float]:
    """A shape's hull in the world's coordinates, (n, 2), a segment's without its neighbours, and its radius."""
    model, state = sim.model, sim.state
    body = int(model.numpy("shape_body")[shape])
    first, last = model.numpy("vertex_start")[shape : shape + 2]
    kind = model.numpy("shape_type")[shape]
    local = model.numpy("vertices")[first : first + 2 if kind == dc.ShapeType.SEGMENT else last].astype(np.float64)
    if kind == dc.ShapeType.DISC:
        local = model.numpy("shape_center")[shape : shape + 1].astype(np.float64)
    turned = local @ rotation(float(state.numpy("angle")[body])).T
    return turned + state.numpy("position")[body].astype(np.float64), float(model.numpy("shape_radius")[shape])


def velocity_at(velocity: Array, arm: Array) -> Array:
    """Velocities of points of bodies with these velocities and spins, (..., 3), at these arms, (..., 2)."""
    return velocity[..., :2] + velocity[..., 2:3] * np.stack([-arm[..., 1], arm[..., 0]], axis=-1)


def edges(hull: Array) -> tuple[Array, Array]:
    """Starts and ends of a hull's edges: one for a point (to itself) or a line, n for a polygon."""
    if len(hull) < 3:
        return hull[:1], hull[-1:]
    return hull, np.roll(hull, -1, axis=0)


def to_edges(points: Array, hull: Array) -> float:
    """Least distance of any point to any edge of a hull."""
    start, end = edges(hull)
    along = end - start
    square = np.maximum((along * along).sum(axis=1), np.finfo(float).tiny)
    to = points[:, None] - start
    at = np.clip((to * along).sum(axis=2) / square, 0.0, 1.0)
    away = to - at[..., None] * along
    return float(np.hypot(away[..., 0], away[..., 1]).min())


def meet(p: Array, q: Array) -> bool:
    """Whether two convex hulls have a point in common: no axis separates them."""
    axes = []
    for hull in (p, q):
        start, end = edges(hull)
        along = end - start
        axes.append(np.stack([along[:, 1], -along[:, 0]], axis=1))
        if len(hull) == 2:
            axes.append(along)
    normals = np.concatenate(axes)
    normals = normals[np.abs(normals).max(axis=1) > 0]
    if not len(normals):
        return bool((p[0] == q[0]).all())
    one, two = p @ normals.T, q @ normals.T
    return bool(((one.min(axis=0) <= two.max(axis=0)) & (two.min(axis=0) <= one.max(axis=0))).all())


def distance(p: Array, q: Array) -> float:
    """Distance of two hulls, 0 where they meet."""
    if min(len(p), len(q)) > 1 and meet(p, q):
        return 0.0
    for point, hull in ((p, q), (q, p)):
        if len(point) == 1 and len(hull) > 2 and meet(point, hull):
            return 0.0
    return min(to_edges(p, q), to_edges(q, p))


def contact_table(sim: dc.Simulation) -> dict[str, Array]:
    """The contacts of all worlds by field, in float64, with their shapes."""
    slots, world = contact_slots(sim.contacts)
    names = ("key", "body_a", "body_b", "normal", "arm_a", "arm_b", "gap", "friction", "restitution", "impulse")
    table = {name: sim.contacts.numpy(name)[slots] for name in names}
    table = {name: v.astype(np.float64) if v.dtype.kind == "f" else v for name, v in table.items()}
    key, first = table["key"], sim.model.numpy("shape_start")[world]
    mask = (1 << KEY_SHAPE_BITS) - 1
    table["world"] = world
    table["shape_a"] = (key >> (KEY_SHAPE_BITS + KEY_FEATURE_BITS)) + first
    table["shape_b"] = ((key >> KEY_FEATURE_BITS) & mask) + first
    return table


def closest(sim: dc.Simulation) -> dict[tuple[int, int], float]:
    """Gap of every pair of shapes that may collide [m], 0 or less where hulls meet; A as in contact keys.

    A chain counts as one shape, the first of its segments: which of two neighbours has a contact is its own business.
    """
    model = sim.model
    body, kind = model.numpy("shape_body"), model.numpy("body_type")
    category, mask = model.numpy("shape_category"), model.numpy("shape_mask")
    starts, segment = model.numpy("shape_start"), model.numpy("shape_type") == dc.ShapeType.SEGMENT
    hulls = [core(sim, shape) for shape in range(model.shape_count)]
    found: dict[tuple[int, int], float] = {}
    for w in range(model.world_count):
        for a in range(starts[w], starts[w + 1]):
            for b in range(a + 1, starts[w + 1]):
                i, j = body[a], body[b]
                agreed = category[a] & mask[b] and category[b] & mask[a]
                if i == j or dc.BodyType.DYNAMIC not in (kind[i], kind[j]) or not agreed:
                    continue
                pair = (b, a) if kind[j] == dc.BodyType.STATIC else (a, b)
                gap = distance(hulls[a][0], hulls[b][0]) - hulls[a][1] - hulls[b][1]
                name = _chained(pair, segment, body)
                found[name] = min(gap, found.get(name, math.inf))
    return found


def _chained(pair: tuple[int, int], segment: Array, body: Array) -> tuple[int, int]:
    """The pair with a chain's first segment in place of any of its segments."""
    one, two = (int((body == body[shape]).argmax()) if segment[shape] else int(shape) for shape in pair)
    return one, two


def parted(p: Array, q: Array, normal: Array) -> float:
    """How far two hulls are parted along a unit vector from p to q; never more than their distance."""
    return float((q @ normal).min() - (p @ normal).max())


def pass_by(sim: dc.Simulation, pair: tuple[int, int], dt: float, reach: float, slack: float) -> bool:
    """Whether two shapes stay apart on their ways in the step and are beyond the look-ahead at its end.

    Shapes move with their bodies, or straight with the velocities of their centres, as contacts are looked for.
    """
    body, segment = sim.model.numpy("shape_body"), sim.model.numpy("shape_type") == dc.ShapeType.SEGMENT
    # a chain stands for all its segments
    parts = [np.flatnonzero(segment & (body == body[shape])) if segment[shape] else [shape] for shape in pair]
    return any(
        all(_stay_apart(Way(sim, int(i), turns), Way(sim, int(j), turns), dt, reach, slack)
            for i in parts[0] for j in parts[1])
        for turns in (True, False)
    )  # fmt: skip


class Way:
    """A shape's way through a step, with the velocities predicted for it."""

    def __init__(self, sim: dc.Simulation, shape: int, turns: bool) -> None:
        """``turns``: with its body, else straight with the velocity of its centre."""
        body = int(sim.model.numpy("shape_body")[shape])
        self.points, self.radius = core(sim, shape)
        self.middle = sim.state.numpy("position")[body].astype(np.float64)
        vx, vy, self.spin = (float(v) for v in sim.motion.numpy("predicted")[body, :3])
        self.velocity = np.array((vx, vy))
        if not turns:
            center = sim.model.numpy("shape_center")[shape].astype(np.float64)
            arm = rotation(float(sim.state.numpy("angle")[body])) @ center
            self.velocity = velocity_at(np.array((vx, vy, self.spin)), arm)
            self.spin = 0.0

    @property
    def turning(self) -> float:
        """Largest speed of a point about the body's centre of mass [m/s]."""
        return abs(self.spin) * float(np.hypot(*(self.points - self.middle).T).max())

    def at(self, time: float) -> Array:
        """The hull so long into the step."""
        return (self.points - self.middle) @ rotation(self.spin * time).T + self.middle + self.velocity * time


def _stay_apart(one: Way, other: Way, dt: float, reach: float, slack: float) -> bool:
    """By conservative advancement (Mirtich 1996): no gap closes sooner than at the largest relative speed of points."""

    def gap(time: float) -> float:
        return distance(one.at(time), other.at(time)) - one.radius - other.radius

    if gap(dt) <= reach:
        return False
    speed = float(np.hypot(*(other.velocity - one.velocity))) + one.turning + other.turning
    time = 0.0
    while time < dt and speed > 0:
        now = gap(time)
        if now <= slack:
            return False
        time += now / speed
    return True


def lost_contacts(sim: dc.Simulation, bound: float) -> list[str]:
    """Pairs closer than the look-ahead without a contact, contacts twice, and gaps that are not the hulls'.

    A gap is the distance along the contact's normal, which is the axis that the motion closes last and not always that
    of the least distance. Shapes that pass by each other, or fly apart, need no contact.
    """
    table, model = contact_table(sim), sim.model
    faults = []
    if len(np.unique(np.stack([table["world"], table["key"]]), axis=1).T) != len(table["key"]):
        faults.append("a key occurs twice")
    segment, body = model.numpy("shape_type") == dc.ShapeType.SEGMENT, model.numpy("shape_body")
    hulls = [core(sim, shape) for shape in range(model.shape_count)]
    seen: dict[tuple[int, int], float] = {}
    lack: dict[tuple[int, int], float] = {}  # by how much a gap is less than what parts its hulls
    for a, b, gap, normal in zip(*(table[field] for field in ("shape_a", "shape_b", "gap", "normal")), strict=True):
        name = _chained((a, b), segment, body)
        seen[name] = min(gap, seen.get(name, math.inf))
        (p, p_radius), (q, q_radius) = hulls[a], hulls[b]
        lack[name] = max(parted(p, q, normal) - p_radius - q_radius - gap, lack.get(name, -math.inf))
    world = np.repeat(np.arange(model.world_count), np.diff(model.numpy("shape_start")))
    scale, reach, dt = model.numpy("length_scale"), sim.motion.numpy("reach"), sim.motion.numpy("step_dt")
    for pair, gap in closest(sim).items():
        w = world[pair[0]]
        slack = bound * float(scale[w])
        near = reach[w] - slack
        if gap < near and pair not in seen and not pass_by(sim, pair, float(dt[w]), near, slack):
            faults.append(f"shapes {pair} are {gap:g} m apart, look-ahead {reach[w]:g} m: no contact")
        if pair in seen and gap > slack and lack[pair] > slack:
            faults.append(f"shapes {pair} are {gap:g} m apart, their contact says {seen[pair]:g} m")
    return faults


def step_faults(sim: dc.Simulation, start: Array) -> list[str]:
    """What does not hold after ``solve`` and before ``advance``.

    Velocities are the predicted ones plus each body's impulses over its mass, so that linear and angular momentum
    change by gravity, forces and what does not move freely only; normal impulses push; friction obeys Coulomb.

    Args:
        sim: one world.
        start: impulses (contacts, 2) [N s] that the solve began from, whose round-off the velocities keep.
    """
    model, table = sim.model, contact_table(sim)
    count = model.body_count
    predicted = sim.motion.numpy("predicted")[:count].astype(np.float64)
    solved = sim.motion.numpy("solved")[:count].astype(np.float64)
    faults = []
    if not (np.isfinite(solved).all() and np.isfinite(table["impulse"]).all()):
        return ["a velocity or an impulse is not finite"]
    push, friction = table["impulse"], table["friction"]
    if (push[:, 0] < 0).any():
        faults.append(f"a normal impulse is {push[:, 0].min():g} N s")
    unit = np.finfo(sim.dtype)
    beyond = np.abs(push[:, 1]) - friction * push[:, 0] * (1 + 4 * unit.eps) - unit.smallest_subnormal
    if (beyond > 0).any():
        faults.append(f"friction exceeds its limit by {beyond.max():g} N s")
    expected, size = apply_impulses(sim, table, predicted)
    # round-off of impulses that came and went too: those it began from, and those that would stop the approach
    for impulse in (start, stopping(sim, table, predicted)):
        size += apply_impulses(sim, {**table, "impulse": impulse}, predicted)[1]
    size *= ROUND_OFF * np.finfo(sim.dtype).eps * (8 + int(sim.stats.numpy("sweeps")[0]))
    moves = model.numpy("body_type") == dc.BodyType.DYNAMIC
    off = np.abs(expected - solved[:, :3])
    # what a turn adds to a velocity at the body's rim counts as velocity
    bad = moves[:, None] & (off > size + np.finfo(sim.dtype).tiny)
    for b, k in np.argwhere(bad)[:3]:
        faults.append(
            f"velocity {k} of body {b} is {solved[b, k]:g}, its impulses say {expected[b, k]:g} +- {size[b, k]:g}"
        )
    if not (solved[~moves, :3] == predicted[~moves, :3]).all():
        faults.append("a body that is not dynamic changed its velocity")
    return faults


def apply_impulses(sim: dc.Simulation, table: dict[str, Array], predicted: Array) -> tuple[Array, Array]:
    """Predicted velocities plus M^-1 J^T impulses, (bodies, 3), and the sum of the terms' magnitudes."""
    model, joints = sim.model, sim.joints
    inverse = model.numpy("inv_mass").astype(np.float64), model.numpy("inv_inertia").astype(np.float64)
    velocity, size = predicted[:, :3].copy(), np.abs(predicted[:, :3])

    def add(body: Array, force: Array, arm: Array, sign: float) -> None:
        turn = arm[:, 0] * force[:, 1] - arm[:, 1] * force[:, 0]
        change = np.concatenate([force * inverse[0][body, None], (turn * inverse[1][body])[:, None]], axis=1)
        lever = np.hypot(*arm.T) * np.hypot(*force.T) * inverse[1][body]
        np.add.at(velocity, body, sign * change)
        np.add.at(size, body, np.concatenate([np.hypot(*force.T)[:, None] * inverse[0][body, None]] * 2
                                             + [lever[:, None]], axis=1))  # fmt: skip

    n = table["normal"]
    force = table["impulse"][:, :1] * n + table["impulse"][:, 1:] * np.stack([n[:, 1], -n[:, 0]], axis=1)
    add(table["body_b"], force, table["arm_b"], 1.0)
    add(table["body_a"], force, table["arm_a"], -1.0)
    if model.joint_count:
        a, b, along, arms = joint_frames(sim)
        force = joints.numpy("joint_impulse").astype(np.float64)[:, None] * along
        add(b, force, arms[1], 1.0)
        add(a, force, arms[0], -1.0)
    size[:, :2] = np.hypot(*size[:, :2].T)[:, None]
    return velocity, size


def stopping(sim: dc.Simulation, table: dict[str, Array], predicted: Array) -> Array:
    """Impulses (contacts, 2) [N s] of the size that a contact alone would need to stop the relative velocity there."""
    inverse = sim.model.numpy("inv_mass").astype(np.float64)
    a, b = table["body_a"], table["body_b"]
    speed = velocity_at(predicted[b], table["arm_b"]) - velocity_at(predicted[a], table["arm_a"])
    return np.hypot(*speed.T)[:, None] / (inverse[a] + inverse[b])[:, None] * np.ones(2)


def joint_frames(sim: dc.Simulation) -> tuple[Array, Array, Array, tuple[Array, Array]]:
    """Bodies, direction and arms of each joint at the present positions."""
    joints, state = sim.joints, sim.state
    a, b = joints.numpy("joint_body_a"), joints.numpy("joint_body_b")
    arms = []
    for body, name in ((a, "joint_anchor_a"), (b, "joint_anchor_b")):
        local, angle = joints.numpy(name).astype(np.float64), state.numpy("angle")[body].astype(np.float64)
        c, s = np.cos(angle), np.sin(angle)
        arms.append(np.stack([c * local[:, 0] - s * local[:, 1], s * local[:, 0] + c * local[:, 1]], axis=1))
    position = state.numpy("position").astype(np.float64)
    line = (position[b] + arms[1]) - (position[a] + arms[0])
    length = np.hypot(*line.T)
    along = np.where(length[:, None] > 0, line / np.maximum(length, np.finfo(float).tiny)[:, None], (1.0, 0.0))
    return a, b, along, (arms[0], arms[1])


def energy_gain(sim: dc.Simulation) -> tuple[float, float]:
    """Kinetic energy of all worlds that a solve added to the predicted one, less what was supplied to it [J].

    The energy changes by p.u+ - dv.M dv / 2. With restitution 0 and no velocity bias against overlap p.u+ is not
    positive for contacts, where u+ = -gap/dt or 0 where they press, and friction acts against the slip. Kinematic
    bodies supply energy, and so do rods that turn: they are given the speed by which the straight motion of the step
    would stretch them. Returns the gain and the energy that it is to be compared with.
    """
    model, table = sim.model, contact_table(sim)
    mass, inertia = (model.numpy(name).astype(np.float64) for name in ("mass", "inertia"))
    before, after = (sim.motion.numpy(name)[: model.body_count].astype(np.float64) for name in ("predicted", "solved"))

    def kinetic(v: Array) -> float:
        return float((mass * (v[:, 0] ** 2 + v[:, 1] ** 2) + inertia * v[:, 2] ** 2).sum() / 2)

    kinematic = model.numpy("body_type") == dc.BodyType.KINEMATIC
    n = table["normal"]
    force = table["impulse"][:, :1] * n + table["impulse"][:, 1:] * np.stack([n[:, 1], -n[:, 0]], axis=1)
    work = size = 0.0
    ends = [(table["body_a"], table["arm_a"], force, 1.0), (table["body_b"], table["arm_b"], force, -1.0)]
    if model.joint_count:
        a, b, along, arms = joint_frames(sim)
        pull = sim.joints.numpy("joint_impulse").astype(np.float64)[:, None] * along
        ends += [(a, arms[0], pull, 1.0), (b, arms[1], pull, -1.0)]
        given = (pull * (velocity_at(after[b], arms[1]) - velocity_at(after[a], arms[0]))).sum(axis=1)
        work += float(given.sum())
        size += float(np.abs(given).sum())
    for body, arm, push, sign in ends:
        power = sign * (push * velocity_at(before[body], arm)).sum(axis=1)[kinematic[body]]  # on what is not kinematic
        work += float(power.sum())
        size += float(np.abs(power).sum())
    return kinetic(after) - kinetic(before) - work, kinetic(before) + size
