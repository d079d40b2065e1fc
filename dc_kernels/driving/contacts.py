"""Forces of contacts and joints [N], and pairs that begin and cease to touch, for programs that drive a simulation.

A simulation here is anything with the attributes of ``dc_kernels.Simulation`` that are used; no loop runs over worlds.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from dc_kernels.measure import are_off, contact_slots
from dc_kernels.model.fields import KEY_FEATURE_BITS, KEY_SHAPE_BITS
from dc_kernels.runtime.inputs import check_simulation
from dc_kernels.solve.rows import read_column

PARTS = ("model", "state", "contacts", "joints", "motion", "phase")


class NetForces(NamedTuple):
    """The total force and torque of the contacts on each body."""

    force: np.ndarray
    """(bodies, 2) [N]."""
    torque: np.ndarray
    """About the centre of mass, (bodies,) [N m]."""


def contact_forces(sim: Any) -> np.ndarray:
    """Return the force of each contact on its body B, in the world's axes; body A feels the opposite force.

    Args:
        sim: the simulation, between steps or after ``solve``: impulses are those of the last step, or of that solve.

    Returns:
        (n, 2) float64 [N], one row for each slot of ``contact_slots(sim.contacts)``; zero in worlds that
        have stopped.

    Raises:
        ValueError: it is called after ``collide``, when impulses are the start of the solve.

    Examples:
        >>> import dc_kernels as dc
        >>> builder = dc.ModelBuilder()
        >>> world = builder.add_world()
        >>> floor = builder.add_body(type=dc.BodyType.STATIC)
        >>> shape = builder.add_box(floor, 5.0, 0.5, center=(0.0, -0.5))
        >>> ball = builder.add_body(position=(0.0, 0.5), mass=2.0)
        >>> shape = builder.add_disc(ball, 0.5)
        >>> sim = dc.Simulation(*builder.finalize())
        >>> sim.run(50, 0.01)
        >>> dc.contact_forces(sim).round(1).tolist()
        [[0.0, 19.6]]
    """
    check_simulation("sim", sim, PARTS)
    slots, world = contact_slots(sim.contacts)
    normal, impulse = (sim.contacts.numpy(name)[slots].astype(np.float64) for name in ("normal", "impulse"))
    tangent = np.stack([normal[:, 1], -normal[:, 0]], axis=1)
    with np.errstate(invalid="ignore"):  # in worlds that have stopped
        force = normal * impulse[:, :1] + tangent * impulse[:, 1:]
    rate = _rate(sim)[world, None]
    return np.where(rate > 0, force * rate, 0.0)


def net_contact_forces(sim: Any) -> NetForces:
    """Return the total force and torque of the contacts on each body.

    Args:
        sim: the simulation, see ``contact_forces``.

    Raises:
        ValueError: see ``contact_forces``.
    """
    force = contact_forces(sim)
    slots, _ = contact_slots(sim.contacts)
    bodies = sim.model.body_count
    total, torque = np.zeros((bodies, 2)), np.zeros(bodies)
    for side, sign in (("a", -1.0), ("b", 1.0)):
        body, arm = sim.contacts.numpy(f"body_{side}")[slots], sim.contacts.numpy(f"arm_{side}")[slots]
        for k in (0, 1):
            total[:, k] += np.bincount(body, sign * force[:, k], bodies)
        turn = arm[:, 0] * force[:, 1] - arm[:, 1] * force[:, 0]
        torque += np.bincount(body, np.where(np.isfinite(turn), sign * turn, 0.0), bodies)
    return NetForces(total, torque)


class JointReactions(NamedTuple):
    """Forces and torques of joints on their bodies B; bodies A feel the opposite force."""

    force: np.ndarray
    """(joints, 2) [N], in the world's axes."""
    torque: np.ndarray
    """About anchor B, (joints,) [N m]."""


def joint_forces(sim: Any) -> np.ndarray:
    """Return the force of each row of the joints, (joint rows,) [N]; a rod's force is positive if it pushes apart.

    Forces of rows of angles act at an arm of the world's ``length_scale``; ``joint_reactions`` has forces and torques.

    Args:
        sim: the simulation, see ``contact_forces``.

    Raises:
        ValueError: see ``contact_forces``.
    """
    check_simulation("sim", sim, PARTS)
    start = sim.joints.numpy("joint_row_start")[sim.model.numpy("joint_start")]
    rate = np.repeat(_rate(sim), np.diff(start))
    return np.where(rate > 0, sim.joints.numpy("joint_impulse") * rate, 0.0)


def joint_reactions(sim: Any) -> JointReactions:
    """Return force and torque of each joint on its body B in the last step.

    Args:
        sim: the simulation, see ``contact_forces``.

    Raises:
        ValueError: see ``contact_forces``.
    """
    along = joint_forces(sim)
    joints, rows, count = sim.joints, sim.rows, sim.joints.sizes["joint"]
    if not sim.storage.general:
        slot = rows.numpy("joint_slot")
        names = ("nx", "ny", "rBn")
        column = rows.numpy("column")
        jacobian = np.stack([read_column(column, sim.variant, name, slot) for name in names], axis=1).astype(np.float64)
    else:
        jacobian = rows.numpy("row_jacobian_b").astype(np.float64)
    owner = np.repeat(np.arange(count), np.diff(joints.numpy("joint_row_start")))
    total = np.stack([np.bincount(owner, along * jacobian[:, k], count) for k in range(3)], axis=1)
    body, anchor = joints.numpy("joint_body_b"), joints.numpy("joint_anchor_b").astype(np.float64)
    angle = sim.state.numpy("angle")[body].astype(np.float64)
    if sim.phase == "advance":  # the arms of the solve were those before the step
        angle -= sim.motion.numpy("displacement")[body, 2]
    c, s = np.cos(angle), np.sin(angle)
    x, y = c * anchor[:, 0] - s * anchor[:, 1], s * anchor[:, 0] + c * anchor[:, 1]
    return JointReactions(total[:, :2], total[:, 2] - (x * total[:, 1] - y * total[:, 0]))


def _rate(sim: Any) -> np.ndarray:
    """One over the time step of the impulses of each world, (W,) [1/s]; 0 where there are none, or it has stopped."""
    if sim.phase == "collide":
        raise ValueError("forces after collide(): impulses are what the solve starts from; solve() first")
    dt = sim.contacts.numpy("contact_dt") if sim.phase == "advance" else sim.motion.numpy("step_dt")
    dt = np.where(sim.state.numpy("flags") == 0, dt, 0).astype(np.float64)
    return np.divide(1.0, dt, out=np.zeros_like(dt), where=dt > 0)


class Touches(NamedTuple):
    """Pairs of shapes, sorted by them; all arrays have the length n."""

    shape_a: np.ndarray
    """The shape of the lower index, numbered over all worlds."""
    shape_b: np.ndarray
    """The other shape."""
    body_a: np.ndarray
    """The body of shape A."""
    body_b: np.ndarray
    """The body of shape B."""
    impulse: np.ndarray
    """Normal impulse of the step, of all contacts of the pair together [N s]."""


class ContactEvents:
    """Finds the pairs of shapes that have begun or ceased to touch since the last update.

        events = dc.ContactEvents(sim)
        sim.step(0.01)
        events.update()
        events.begun.body_a, events.begun.impulse  # how hard they met

    A pair begins to touch when one of its contacts has an impulse or overlaps, and ceases when it has no contact any
    more, so bodies at rest do not flicker. With an update after each step no pair is missed; a pair that begins and
    ceases between two updates is. Shapes are identified by their ids: a removed shape has no ended pairs, and a new
    shape in its slot begins pairs. In a world that is reset all pairs end and begin again; pairs of a stopped world
    remain.

    Attributes:
        sim: the simulation.
        begun: pairs that have begun to touch since the last update, with the impulse of the last step.
        ended: pairs that touched at the last update and no longer do, with the impulse that they had then.
        touching: all pairs that touch.
    """

    def __init__(self, sim: Any) -> None:
        """Start with the pairs that touch now, without events."""
        check_simulation("sim", sim, PARTS)
        self.sim = sim
        nothing = np.zeros(0, np.int64)
        self._ids, self._impulse = nothing, np.zeros(0)
        self._named = self._names()
        self._start = sim.model.numpy("shape_start").copy()
        self.begun = self.ended = self.touching = self._touches(nothing, self._impulse)
        self.update()
        self.begun = self._touches(nothing, np.zeros(0))

    def update(self) -> None:
        """Compare the contacts of the last step with those of the last update.

        Raises:
            ValueError: it is called between the phases of a step.
        """
        sim = self.sim
        if sim.phase != "advance":
            raise ValueError("update() in the middle of a step: finish it with solve() and advance(), or take a step")
        self._follow()
        slots, world = contact_slots(sim.contacts)
        live = sim.state.numpy("flags") == 0
        chosen = live[world] & ~are_off(sim.contacts, slots)
        slots, world = slots[chosen], world[chosen]
        key, first = sim.contacts.numpy("key")[slots], sim.model.numpy("shape_start")[world].astype(np.int64)
        mask = 2**KEY_SHAPE_BITS - 1
        a, b = ((key >> shift) & mask for shift in (KEY_FEATURE_BITS + KEY_SHAPE_BITS, KEY_FEATURE_BITS))
        pair, place = np.unique((np.minimum(a, b) + first) << 32 | (np.maximum(a, b) + first), return_inverse=True)
        normal = sim.contacts.numpy("impulse")[slots, 0]
        impulse = np.bincount(place, normal, len(pair))
        presses = np.bincount(place, (normal != 0) | (sim.contacts.numpy("gap")[slots] < 0), len(pair)) > 0
        known = np.isin(pair, self._ids, assume_unique=True)
        touches = presses | known
        pair, impulse, known = pair[touches], impulse[touches], known[touches]
        stays = np.isin(self._ids, pair, assume_unique=True)
        shapes = np.diff(sim.model.numpy("shape_start"))
        stopped = ~np.repeat(live, shapes)[self._ids >> 32]
        kept, gone = stopped & ~stays, ~stopped & ~stays
        self.begun = self._touches(pair[~known], impulse[~known])
        self.ended = self._touches(self._ids[gone], self._impulse[gone])
        ids, impulses = np.concatenate([pair, self._ids[kept]]), np.concatenate([impulse, self._impulse[kept]])
        order = np.argsort(ids)
        self._ids, self._impulse = ids[order], impulses[order]
        self._named = self._names()
        self.touching = self._touches(self._ids, self._impulse)

    def _follow(self) -> None:
        """Know shapes by the numbers that they have now, and forget pairs of those that are no more."""
        start = self.sim.model.numpy("shape_start")
        if not np.array_equal(start, self._start):
            world = np.searchsorted(self._start, self._ids >> 32, "right") - 1
            shift = (start - self._start)[world].astype(np.int64)
            self._ids, self._start = self._ids + (shift << 32 | shift), start.copy()
        stays = (self._names() == self._named).all(axis=0)
        self._ids, self._impulse = self._ids[stays], self._impulse[stays]

    def _names(self) -> np.ndarray:
        """Ids of the shapes of the pairs, (2, n), which what comes in the slot of another one does not share."""
        shapes, given = np.stack([self._ids >> 32, self._ids & (2**32 - 1)]), getattr(self.sim, "given_ids", None)
        return shapes if given is None else given.numpy("shape_id")[shapes]

    def _touches(self, pairs: np.ndarray, impulse: np.ndarray) -> Touches:
        a, b, body = pairs >> 32, pairs & (2**32 - 1), self.sim.model.numpy("shape_body")
        return Touches(a, b, body[a], body[b], impulse)

    def __repr__(self) -> str:
        """Numbers of pairs."""
        counts = (len(touches.impulse) for touches in (self.begun, self.ended, self.touching))
        return "<ContactEvents: {} pairs begun, {} ended, {} touching>".format(*counts)
