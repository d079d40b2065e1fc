"""The calls by which a program drives a simulation between its steps."""

from __future__ import annotations

import copy
import functools
import os
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, BinaryIO, ParamSpec

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


Arguments = ParamSpec("Arguments")
CHOSEN = ("threads", "schedule", "specialize")
"""What is chosen when a simulation is made."""
OF_MODEL = ("dtype", "device", "backend")
"""What is chosen when its model is made."""
HELD = {
    "model": "sim.change_model(NAME=values) changes a field of it; or make a new simulation",
    "joints": "sim.change_model(NAME=values) changes a field of it; or make a new simulation",
    "state": 'sim.state.assign("NAME", values) writes a field of it, and sim.reset(None, state) all',
    "built": 'sim.built.assign("NAME", values) writes a field of it',
    **{name: f"make another one of ModelBuilder.finalize({name}=...)" for name in OF_MODEL},
    **dict.fromkeys(
        ("motion", "pairs", "contacts", "cache", "rows", "stats", "sleepers", "overlaps", "touches", "switches"),
        "it is written by the steps, and by restore_contacts and change_contacts",
    ),
}
"""What kernels hold, and how it is changed instead."""
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


def options_of_model(make: Callable[Arguments, None]) -> Callable[Arguments, None]:
    """Let a constructor that is given what its model determines say where that is chosen.

    Raises:
        TypeError: naming it.
    """

    @functools.wraps(make)
    def named(*arguments: Arguments.args, **options: Arguments.kwargs) -> None:
        for name in OF_MODEL:
            if name in options:
                raise TypeError(f"a simulation takes no {name}: ModelBuilder.finalize({name}=...) does")
        make(*arguments, **options)

    return named


class Driven(Populated):
    """The methods of a simulation that copy, save, reset and change it."""

    model: Model
    joints: Joints
    built: State
    sleepers: Sleepers
    calls: OneCaller
    _reset: Reset | None

    def __setattr__(self, name: str, value: Any) -> None:
        """Set ``config``, or an attribute of your own; the parts of a simulation cannot be replaced.

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
        """Return a copy with its own memory that continues with the same bits, even from within a step.

        ``copy.copy``, ``copy.deepcopy`` and ``pickle`` do so too.

        Raises:
            RuntimeError: it is called within ``wp.ScopedCapture``.
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
        """Reset worlds to the state that they were built in, as if no step had been made, or to a given state.

        Reset worlds have no contacts, impulses or flags; changes of the model, its joints and the settings remain.
        Their next step has the bits of the first step of a new simulation. Other worlds keep their bits. Use it at the
        end of an episode of reinforcement learning: ``sim.reset(done)``.

        Args:
            worlds: a mask, (W,) bool, or indices, (k,); None: all.
            state: initial values that differ from the built state: values by name of a field of
                ``model.fields.STATE`` (except ``flags``) for these worlds in this order, (bodies of all, ...), or
                (k, n, ...) if each has n bodies; or a ``State`` from which the rows of these worlds are copied, such
                as a copy of an earlier ``sim.state``.

        Raises:
            TypeError, ValueError: an argument is invalid (the error names argument, field, index and limit), or only
                some worlds are reset between the phases of a step. Nothing has changed then.
            RuntimeError: it is called within ``wp.ScopedCapture``.

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
            rows = [] if state is None else check_rows(self.model, chosen, state)
            if chosen is not None and not len(chosen):
                return
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

        Give fields that depend on each other in one call; all are checked before anything is written, so an error
        changes nothing. Contacts keep their impulses, and worlds in which no field changes keep their bits. The change
        applies to all simulations that share the model or the joints. Steps do not become slower.

        Dependent fields are computed: inverse masses and inertias (or masses from the
        inverses), which become zero for bodies that are no longer dynamic; centres, extents and normals of shapes with
        other ``vertices`` or radii. Centres of mass do not change. A body that becomes dynamic needs a mass and
        an inertia; one that becomes static stops. ``joint_impulse`` is the start of the next step.

        Args:
            **values: by name of a field (``Model.changeable``, ``Joints.changeable``), an array of its shape, or one
                number for all. Without values, changes written to the memory of the fields, through ``dc.to_numpy``
                or a tensor, are checked and applied.

        Raises:
            UnknownName: (a ``ValueError`` and ``KeyError``) the field determines the layout of memory, or is derived.
            TypeError, ValueError: a value is invalid (the error names field, index and limit), or the call is between
                the phases of a step.
            RuntimeError: it is called within ``wp.ScopedCapture``.

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
        """Change contacts between ``collide`` and ``solve``, or in a start; their rows are rebuilt.

        A disabled contact does not act in this step, and is in ``contacts`` again at its end,
        with the colour -1 and no impulse. The next ``collide`` makes all contacts from their shapes again.

        Args:
            **values: by name, values of all contacts in the order of ``dc.contact_slots``, (n,), or one for all:
                ``enabled`` (with ``SolverConfig.contact_switches``); ``friction``; ``restitution``;
                ``surface_speed`` [m/s] of both surfaces along the tangent (n_y, -n_x), positive if
                friction drives B that way (in a scene with moving surfaces, and with ``contact_switches``).
                Without values, changes written to the memory of ``switches.enabled``, ``contacts.friction``,
                ``contacts.restitution`` or ``rows.surface_speed``, at these slots, are checked and applied.

        Raises:
            UnknownName: (a ``ValueError`` and ``KeyError``) the name is unknown.
            TypeError, ValueError: a value is invalid (the error names field, index and limit), or the call is out of
                turn.
            RuntimeError: it is called within ``wp.ScopedCapture``.

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
        """The first world and the number of worlds of each shard."""
        return self._shards.ranges

    @property
    def asleep(self) -> np.ndarray:
        """Mask of the sleeping bodies, bool (bodies,), read-only; all False without ``SolverConfig.sleep``."""
        return asleep(self.model, self.sleepers)

    def sleep(self, bodies: Any = None) -> None:
        """Put bodies to sleep, with velocity zero, until something disturbs them.

        A body that touches an awake one wakes in the next step, so put whole piles to sleep. It may be called before
        the first step.

        Args:
            bodies: a mask, (bodies,) bool, or indices, (k,); None: all. Only dynamic bodies sleep.

        Raises:
            TypeError, ValueError: an index is invalid (the error names it and the limit), the settings do not allow
                sleep, or the call is between the phases of a step.
            RuntimeError: it is called within ``wp.ScopedCapture``.
        """
        self._let(bodies, Rest.FALLING)

    def wake(self, bodies: Any = None) -> None:
        """Wake bodies in the next step, with all sleeping bodies that touch them, directly or through others.

        Writing to the state, the model, its joints or its gravity wakes the affected bodies by itself.

        Args:
            bodies: a mask, (bodies,) bool, or indices, (k,); None: all.

        Raises:
            TypeError, ValueError, RuntimeError: see ``sleep``.
        """
        self._let(bodies, Rest.ROUSED)

    def restore_sleepers(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Restore the sleeping bodies of an earlier run (see ``Storage.restore_sleepers``)."""
        with self.calls, uninterrupted():
            if self.storage.restore_sleepers(arrays, self._flags, self._config):
                self._bind_all()

    def restore_lists(self, group: str, arrays: Mapping[str, np.ndarray]) -> None:
        """Restore the lists of touching and overlapping pairs of an earlier run (see ``Storage.restore_lists``)."""
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
        """Write a snapshot from which a run continues bit for bit to a path or a binary file (``snapshot.save``)."""
        with self.calls:
            snapshot.save(self, path)  # type: ignore[arg-type]

    @classmethod
    def load(cls, path: str | os.PathLike[str] | BinaryIO, **options: Any) -> Self:
        """Return the simulation of a snapshot, a path or a binary file; it continues with the same bits.

        Args:
            path: of the file, or an open binary file.
            **options: ``threads``, ``device`` and ``backend``, and those of the constructor; each is as it was saved
                where it is not given, ``threads`` at most the number of cores.

        Raises:
            ValueError: the file is no snapshot, or is damaged; the error names file and dataset.
            OSError: the file does not exist, or must not be read.
            ImportError: h5py is not installed.
        """
        return snapshot.load(cls, path, **options)  # type: ignore[type-var]
