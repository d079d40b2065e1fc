"""Sleep: what has come to rest costs nothing until something disturbs it (``SolverConfig.sleep``).

**Falling asleep.** At the end of a step ``rest`` adds the time step to the rest time of each dynamic body whose speed
is below ``sleep_speed``, and makes that of any other zero. Every ``LOOK_EVERY`` steps, if some body has rested for
``sleep_time``, ``fall_asleep`` makes islands by union-find over contacts and joints of bodies that are awake. One whose
bodies have all rested so long falls asleep, unless it touches a kinematic body that moves: velocities become zero, and
position, angle, force and torque are remembered.

**A world in which nothing is awake** is dormant: each phase begins with ``enter_worlds``, which flags it, so that its
stages return at once, and ends with a kernel that takes the flag away. Only its time goes on.

**A world that is awake in part** runs its stages, of which the narrowphase passes over pairs of sleepers: in
``mark_sleepers`` their velocities become zero and their inverse masses ``-MARK``, which stands for an infinite mass. So
contacts of sleepers are in no row. ``lay`` has kept them apart, and ``show_sleepers`` puts them back among the contacts
of the step, by key, before the cache is written: between steps ``contacts`` and the cache hold all contacts. Joints of
sleepers become rows of zeros, which keep their impulses.

**Waking.** ``notice_writes`` compares sleepers with what they were last seen like, once in a call: other places,
velocities, forces, torques, gravity or joints rouse them; a body that is not dynamic and was put elsewhere rouses what
it carried. A contact of a sleeper that the narrowphase finds all the same is one with something that moves: it rouses
the sleeper, which gets its velocity back, and the narrowphase is run once more. What is roused wakes with all sleepers
that candidate pairs, contacts and joints connect it to, before the contacts of the step are made; matched by their
keys, these have impulse, colour and age of the step in which they fell asleep. No contact acts on one that sleeps on,
because the narrowphase met it at rest both times; so none takes a colour that a contact kept apart has at that body.

**Launches.** Rounds of compiled launches (``runtime.sequences``) leave out what has nothing to do in their shard
(``stages.needs_of``): the kernels of sleep where nothing sleeps, the stages of a step where nothing is awake.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from dc_kernels.model.arrays import ArrayGroup, Contacts, Model
from dc_kernels.model.enums import BodyType, Rest
from dc_kernels.model.fields import CONTACTS, PER_CONTACT, ROLLING, SLEEPERS
from dc_kernels.model.room import fill_segments
from dc_kernels.model.rules import BrokenRule, refuse
from dc_kernels.model.validate.arrays import Layout, check_field, sane
from dc_kernels.model.validate.contacts import check_contacts

LOOK_EVERY = 8
"""Steps between two looks for islands: union-find over all contacts costs a twentieth of a step."""
MARK = 1e-30
"""Size of what stands for the inverse mass of a sleeper: nothing beside any other inverse mass."""


class Sleepers(ArrayGroup):
    """Bodies that sleep, and their contacts (``model.fields.SLEEPERS``); all axes are empty where none may sleep."""

    table = SLEEPERS


class SleepStorage:
    """The arrays of sleep, which are there only where the settings ask for it.

    Attributes:
        sleepers: bodies that sleep; their contacts lie in slots of the numbers that contacts of the step have.
    """

    def __init__(self, model: Model, contacts: Contacts, allowed: bool) -> None:
        """Allocate, if bodies may sleep."""
        self._sizes = {"body": model.body_count, "joint": model.joint_count, "world": model.world_count}
        self.sleepers = Sleepers(
            dict.fromkeys((*self._sizes, *PER_CONTACT), 0), model.dtype, model.device, model.backend
        )
        self.allow(allowed, contacts)

    @property
    def allowed(self) -> bool:
        """Whether bodies may sleep."""
        return self.sleepers.sizes["world"] > 0

    def allow(self, allowed: bool, contacts: Contacts) -> None:
        """Let bodies sleep, or wake all and free the arrays."""
        if allowed != self.allowed:
            sizes = {**self._sizes, **{axis: contacts.sizes[axis] for axis in PER_CONTACT}} if allowed else {}
            self.sleepers.reallocate(SLEEPERS, **{**dict.fromkeys(self.sleepers.sizes, 0), **sizes})

    def link(self, joints: int, moved: Callable[[np.ndarray], np.ndarray]) -> None:
        """Know so many joints; ``moved``: what the arrays of those that there were become."""
        self._sizes["joint"] = joints
        if self.allowed:
            kept = {name: moved(self.sleepers.numpy(name)) for name, field in SLEEPERS.items() if field.per == "joint"}
            self.sleepers.reallocate(kept, joint=joints)
            for name, values in kept.items():
                self.sleepers.fill(name, values)

    def adopt(self, sleepers: Sleepers) -> None:
        """Take over the sleepers of the same bodies."""
        self.sleepers = sleepers

    def groups(self) -> list[tuple[ArrayGroup, str]]:
        """The group with a slot for each contact, and the field that holds the number of those of each world."""
        return [(self.sleepers, "count")] if self.allowed else []

    def restore(self, arrays: Mapping[str, np.ndarray], contact_start: np.ndarray) -> None:
        """Take over checked arrays (``check_sleepers``), contacts packed world after world, for which there is room."""
        for name, field in SLEEPERS.items():
            if field.per == ROLLING and name not in arrays:  # a scene without it, or a file of before it was kept
                values = np.zeros_like(self.sleepers.numpy(name))
            elif field.per in PER_CONTACT:
                values = self.sleepers.numpy(name).copy()
                fill_segments(values, arrays[name], contact_start, arrays["count"])
            else:
                values = arrays[name]
            self.sleepers.fill(name, values)

    def forget(self, worlds: np.ndarray | None, body_start: np.ndarray) -> None:
        """Let all bodies of some worlds be awake, and their rest begin anew; None: of all worlds."""
        if not self.allowed:
            return
        chosen = np.ones(len(body_start) - 1, bool)
        if worlds is not None:
            chosen = np.zeros(len(body_start) - 1, bool)
            chosen[worlds] = True
        rows = {"world": chosen, "body": np.repeat(chosen, np.diff(body_start))}
        for name in ("asleep", "rest_time", "sleeping", "dormant", "waited", "count"):
            values = self.sleepers.numpy(name).copy()
            values[rows[SLEEPERS[name].per]] = 0
            self.sleepers.fill(name, values)


def check_sleepers(arrays: Mapping[str, np.ndarray], model: Model, flags: np.ndarray) -> np.ndarray:
    """Hold sleepers of an earlier run to their rules, and to each other.

    Args:
        arrays: fields of ``model.fields.SLEEPERS`` by name, contacts packed world after world.
        model: of the bodies.
        flags: of the worlds; numbers of a world with any flag may be NaN or inf.

    Returns:
        The number of contacts of each world, (W,).

    Raises:
        BrokenRule: naming array, index, value and limit.
    """
    views = model.views()
    total = int(arrays["count"].sum(dtype=np.int64))
    if total != len(arrays["key"]) or (arrays["count"] < 0).any():
        raise BrokenRule("count", f"adds up to {total}; it must be {len(arrays['key'])}, the number of contacts")
    kept = {name: arrays[name] for name, field in CONTACTS.items() if field.per in PER_CONTACT and name in arrays}
    check_contacts({"contact_count": arrays["count"], **kept}, views, flags=flags, backend=model.backend)
    layout = Layout(views, arrays["count"], model.backend)
    for name, values in sane(SLEEPERS, arrays, layout, flags).items():
        if name not in kept:
            check_field(name, SLEEPERS[name], values, layout)
    worlds, dynamic = layout.world("body"), views["body_type"] == BodyType.DYNAMIC
    asleep = dynamic & (arrays["asleep"] != Rest.AWAKE)
    sleeping = np.bincount(worlds[asleep], minlength=len(flags))
    refuse("sleeping", arrays["sleeping"], arrays["sleeping"] != sleeping, "the bodies of the world that sleep")
    awake = np.bincount(worlds[dynamic & ~asleep], minlength=len(flags)) > 0
    refuse("dormant", arrays["dormant"], awake & (arrays["dormant"] != 0), "0 where a dynamic body is awake")
    return arrays["count"]


def asleep(model: Model, sleepers: Sleepers) -> np.ndarray:
    """Bodies that sleep, bool (bodies,), for reading only."""
    if not sleepers.sizes["world"]:
        found = np.zeros(model.body_count, bool)
    else:
        found = sleepers.numpy("asleep") == Rest.ASLEEP
    found.flags.writeable = False  # who writes into it means ``sim.sleep`` or ``sim.wake``
    return found


def mark(model: Model, sleepers: Sleepers, bodies: np.ndarray | None, rest: Rest) -> None:
    """Mark dynamic bodies for what is to become of them; None: all.

    Args:
        model: of the bodies.
        sleepers: to be written.
        bodies: their indices.
        rest: FALLING of those that are awake, or ROUSED of those that sleep.
    """
    codes = sleepers.numpy("asleep").copy()
    chosen = np.zeros(model.body_count, bool)
    chosen[slice(None) if bodies is None else bodies] = True
    chosen &= model.numpy("body_type") == BodyType.DYNAMIC
    chosen &= (codes == Rest.ASLEEP) == (rest == Rest.ROUSED)
    codes[chosen] = rest
    sleepers.fill("asleep", codes)
    if rest == Rest.ROUSED:
        dormant = sleepers.numpy("dormant").copy()
        dormant[np.searchsorted(model.numpy("body_start"), np.flatnonzero(chosen), "right") - 1] = 0
        sleepers.fill("dormant", dormant)
