"""The calls by which a program drives a simulation between its steps."""

from __future__ import annotations

import copy
import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from dc_kernels import snapshot
from dc_kernels.driving import changes, switches
from dc_kernels.driving.copies import Parts, from_parts, parts_of
from dc_kernels.driving.populated import Populated
from dc_kernels.driving.reset import Reset, check_rows, write_rows
from dc_kernels.model.arrays import Model, State
from dc_kernels.model.enums import Rest
from dc_kernels.model.fields import JOINTS, MODEL, STATE
from dc_kernels.model.joints.groups import Joints
from dc_kernels.runtime.capture import refuse_recording
from dc_kernels.runtime.inputs import check_worlds
from dc_kernels.runtime.threads import OneCaller, uninterrupted
from dc_kernels.sleep.sleepers import Sleepers, asleep, mark

if TYPE_CHECKING:
    from typing_extensions import Self


CHOSEN = ("threads", "schedule", "specialize", "dtype", "device", "backend")
"""What is chosen when a simulation is made."""
HELD = {
    "model": "sim.change_model(NAME=values) changes a field of it; or make a new simulation",
    "joints": "sim.change_model(NAME=values) changes a field of it; or make a new simulation",
    "state": 'sim.state.assign("NAME", values) writes a field of it, and sim.reset(None, state) all',
    "built": 'sim.built.assign("NAME", values) writes a field of it',
    **dict.fromkeys(
        ("motion", "pairs", "contacts", "cache", "rows", "stats", "sleepers", "overlaps", "touches", "switches"),
        "it is written by the steps, and by restore_contacts and change_contacts",
    ),
}
"""Groups whose memory kernels hold, and how they are written."""
PARTS = frozenset((*CHOSEN, *HELD))
RESERVED = frozenset((*PARTS, *STATE, *MODEL, *JOINTS))


def _instead(name: str) -> str:
    """Say what a reserved name is, and how it is changed."""
    if name in STATE:
        return f'is a field of the state; sim.state.assign("{name}", values) writes it'
    if name in MODEL or name in JOINTS:
        group = "model" if name in MODEL else "joints"
        return f"is a field of the {group}; sim.change_model({name}=values) changes it"
    way = HELD.get(name, f"make another one: dc.Simulation(..., {name}=...)")
    return f"is that of this simulation, whose kernels go by it; {way}"


class Driven(Populated):
    """The part of a simulation that is copied, saved, and brought into another state."""

    model: Model
    joints: Joints
    built: State
    sleepers: Sleepers
    calls: OneCaller
    _reset: Reset | None

    def __setattr__(self, name: str, value: Any) -> None:
        """Set ``config``, or what is no part of a simulation; no step goes by other parts than it was made with.

        Raises:
            AttributeError: for such a part, or for a field of model, joints or state, saying how it is changed.
        """
        if name in RESERVED and not (name in PARTS and self.__dict__.get(name, value) is value):
            raise AttributeError(f"sim.{name} {_instead(name)}")
        object.__setattr__(self, name, value)

    @property
    def peak(self) -> np.ndarray:
        """The most that a world used of each kind of room, in the row of a shard, or of all."""
        return self._shards.peak

    def clone(self) -> Self:
        """A simulation of its own memory that goes on with the bits of this one, even from within a step.

        ``copy.copy``, ``copy.deepcopy`` and ``pickle`` do so too.

        Raises:
            RuntimeError: within ``wp.ScopedCapture``.
        """
        refuse_recording("a copy of a simulation", "it is made at once")
        with self.calls:
            return copy.deepcopy(self)

    def __copy__(self) -> Self:
        """See ``clone``: two simulations of one memory would disturb each other."""
        return self.clone()

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle all parts."""
        return from_parts, (type(self), parts_of(self))  # type: ignore[arg-type]

    def adopt(self, parts: Parts) -> None:
        """Consist of other parts than those that were made for it: of a simulation of the same scene and options."""
        self.storage.adopt(parts.groups, parts.slots)
        self.__dict__["built"], self.given_ids = parts.built, parts.ids
        self._turn.ran = parts.phase
        self._shards.peak[...] = parts.peak
        self._bind_all()

    def reset(self, worlds: Any = None, state: State | Mapping[str, Any] | None = None) -> None:
        """Bring worlds back to the state that they were built in, as if no step had been taken, or to a given one.

        They have no contacts and no impulses then, and no flags; what was written to the model, to its joints and to
        the settings stays. Their next step has the bits of the first one of a new simulation. Other worlds keep their
        bits. An episode of reinforcement learning ends so: ``sim.reset(done)``.

        Args:
            worlds: a mask, (W,) bool, or indices, (k,); None: all.
            state: what they are to begin with where that is not as built: values by name of a field of
                ``model.fields.STATE`` (but ``flags``) for these worlds in this order, (bodies of all, ...), or
                (k, n, ...) where each has n bodies; or a ``State`` whose rows of these worlds are taken, such as a
                copy of an earlier ``sim.state``.

        Raises:
            TypeError, ValueError: naming argument, field, index and limit; for some of the worlds in the middle of a
                step. Nothing has changed then.
            RuntimeError: within ``wp.ScopedCapture``.

        Examples:
            >>> import dc_kernels as dc
            >>> builder = dc.ModelBuilder()
            >>> for _ in range(3):
            ...     world = builder.add_world()
            ...     ball = builder.add_discs([(0.0, 2.0)], 0.5)
            >>> sim = dc.Simulation(*builder.finalize())
            >>> sim.run(10, 0.01)
            >>> sim.reset([0, 2], {"velocity": [(1.0, 0.0), (2.0, 0.0)]})
            >>> sim.state.numpy("time").round(2).tolist(), sim.state.numpy("velocity")[:, 0].tolist()
            ([0.0, 0.1, 0.0], [1.0, 0.0, 2.0])
        """
        refuse_recording("reset", "it looks at the worlds that are given now")
        with self.calls:
            count = self.model.world_count
            chosen = check_worlds("worlds", worlds, count)
            whole = chosen is None or len(chosen) == count
            if not (whole or self._turn.ran == "advance"):
                raise ValueError(
                    "reset() of some worlds in the middle of a step: finish it with solve() and advance(), or reset all"
                )
            if chosen is not None and not len(chosen):
                return
            rows = [] if state is None else check_rows(self.model, chosen, state)
            if self._reset is None or self.device != "cpu":  # from where numpy has copies
                groups = {"state": self.state, "joints": self.joints, **self.storage.groups()}
                self._reset = Reset(self.model, self.built, groups)
            with uninterrupted():
                self._reset(chosen)
                write_rows(self.state, rows)
                if whole:
                    self._turn.ran = "advance"

    def change_model(self, **values: Any) -> None:
        """Change fields of the model or of its joints; they act from the next step on.

        What belongs together is given together, and checked before anything is written: an error leaves all as it was.
        Contacts keep their impulses, and worlds of which no field changes keep their bits. All simulations that share
        the model or the joints go by it. A step costs no more for it.

        What follows from the given fields need not be given: inverses of masses and inertias (or these of the
        inverses), zero for those of bodies that are no longer dynamic; centres, extents and normals of shapes with
        other ``vertices`` or radii. Centres of mass stay where they are. A body that becomes dynamic needs a mass and
        an inertia; one that becomes static comes to rest. ``joint_impulse`` is what the next step starts from.

        Args:
            **values: by name of a field (``Model.changeable``, ``Joints.changeable``), an array of its shape, or one
                number for all. Without any, whatever was written to the memory of the fields, through ``dc.to_numpy``
                or a tensor, is checked and taken up.

        Raises:
            UnknownName: a ``ValueError`` and ``KeyError``, for a field that lays out memory, or follows from others.
            TypeError, ValueError: naming field, index and limit; in the middle of a step.
            RuntimeError: within ``wp.ScopedCapture``.

        Examples:
            >>> import dc_kernels as dc
            >>> builder = dc.ModelBuilder()
            >>> world = builder.add_world()
            >>> ball = builder.add_discs([(0.0, 2.0)], 0.5)
            >>> sim = dc.Simulation(*builder.finalize())
            >>> sim.change_model(shape_friction=0.1, mass=[3.0])
            >>> sim.model.numpy("inv_mass")
            array([0.33333334], dtype=float32)
        """
        refuse_recording("change_model", "it writes at once")
        changes.change(self, values)  # type: ignore[arg-type]

    def change_contacts(self, **values: Any) -> None:
        """Change contacts between ``collide`` and ``solve``, or in a start: their rows are made anew.

        A contact that is switched off does not act in this step, and is among ``contacts`` again when it has ended,
        with the colour -1 and no impulse. The next ``collide`` makes all of them as their shapes say.

        Args:
            **values: by name, of all contacts in the order of ``dc.contact_slots``, (n,), or one number for all:
                ``enabled``, False switches off, with ``SolverConfig.contact_switches``; ``friction``; ``restitution``;
                ``surface_speed`` [m/s], of the surfaces of both shapes along the tangent (n_y, -n_x), positive where
                friction drives B that way, in a scene with surfaces that move, with ``contact_switches`` too.
                Without any, what was written to the memory of ``switches.enabled``, ``contacts.friction``,
                ``contacts.restitution`` or ``rows.surface_speed``, at these slots, is checked and taken up.

        Raises:
            UnknownName: a ``ValueError`` and ``KeyError``, for another name.
            TypeError, ValueError: naming field, index and limit; out of turn.
            RuntimeError: within ``wp.ScopedCapture``.

        Examples:
            >>> import dc_kernels as dc
            >>> builder = dc.ModelBuilder()
            >>> world = builder.add_world()
            >>> floor = builder.add_body(type=dc.BodyType.STATIC)
            >>> shape = builder.add_box(floor, 5.0, 0.5, center=(0.0, -0.5))
            >>> balls = builder.add_discs([(0.0, 0.5), (2.0, 0.5)], 0.5)
            >>> sim = dc.Simulation(*builder.finalize(), config=dc.SolverConfig(contact_switches=True))
            >>> sim.run(50, 0.01, lambda sim: sim.change_contacts(enabled=[True, False]))
            >>> [round(float(y), 1) for y in sim.state.numpy("position")[1:, 1]]
            [0.5, -0.7]
        """
        refuse_recording("change_contacts", "it writes at once")
        with self.calls:
            switches.change(self, values)  # type: ignore[arg-type]

    @property
    def ranges(self) -> list[tuple[int, int]]:
        """First world and number of worlds of each shard."""
        return self._shards.ranges

    @property
    def asleep(self) -> np.ndarray:
        """Bodies that sleep, bool (bodies,); none where the settings let none sleep (``SolverConfig.sleep``)."""
        return asleep(self.model, self.sleepers)

    def sleep(self, bodies: Any = None) -> None:
        """Let bodies sleep from now on, with velocities of zero, until something disturbs them.

        A body that touches one which is awake wakes in the next step, so let whole piles sleep. Scenes may begin so.

        Args:
            bodies: a mask, (bodies,) bool, or indices, (k,); None: all. Only dynamic bodies sleep.

        Raises:
            TypeError, ValueError: naming the index and the limit; where the settings let none sleep; in the middle of a
                step.
            RuntimeError: within ``wp.ScopedCapture``.
        """
        self._let(bodies, Rest.FALLING)

    def wake(self, bodies: Any = None) -> None:
        """Wake bodies in the next step, with all that sleeps and touches them; they rest anew before they sleep again.

        What is written to the state, the model, its joints or its gravity wakes by itself whom it concerns.

        Args:
            bodies: a mask, (bodies,) bool, or indices, (k,); None: all.

        Raises:
            TypeError, ValueError, RuntimeError: see ``sleep``.
        """
        self._let(bodies, Rest.ROUSED)

    def restore_sleepers(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Let bodies sleep as in an earlier run (see ``Storage.restore_sleepers``)."""
        with self.calls, uninterrupted():
            if self.storage.restore_sleepers(arrays, self._flags, self._config):
                self._bind_all()

    def restore_lists(self, group: str, arrays: Mapping[str, np.ndarray]) -> None:
        """Let what touches or overlaps be as in an earlier run (see ``Storage.restore_lists``)."""
        with self.calls, uninterrupted():
            if self.storage.restore_lists(group, arrays, self._flags, self._config):
                self._bind_all()

    def _let(self, bodies: Any, rest: Rest) -> None:
        refuse_recording("a change of who sleeps", "it is made at once")
        with self.calls:
            chosen = check_worlds("bodies", bodies, self.model.body_count)
            if not self._config.sleep:
                raise ValueError("SolverConfig.sleep is False; no body of this simulation sleeps")
            if self._turn.ran != "advance":
                raise ValueError("a change of who sleeps in the middle of a step: finish it with solve() and advance()")
            with uninterrupted():
                mark(self.model, self.sleepers, chosen, rest)
                if rest == Rest.FALLING:
                    for shard in self._shards.ranges:
                        self.bind("lay_down", *shard)()

    def save(self, path: str | os.PathLike[str] | BinaryIO) -> None:
        """Write a snapshot to continue from, bit for bit, to a path or a binary file (see ``snapshot.save``)."""
        with self.calls:
            snapshot.save(self, path)  # type: ignore[arg-type]

    @classmethod
    def load(cls, path: str | os.PathLike[str] | BinaryIO, **options: Any) -> Self:
        """A simulation from a snapshot; options as for the constructor (see ``snapshot.load``)."""
        return snapshot.load(cls, path, **options)  # type: ignore[type-var]
