"""The stages that own the arrays of a step, and how they grow together."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from dc_kernels.collide.broadphase import CandidatePairs
from dc_kernels.collide.contacts import StepContacts
from dc_kernels.collide.switches import SwitchStorage
from dc_kernels.events.lists import EventStorage, check_lists
from dc_kernels.model.arrays import ArrayGroup, Model
from dc_kernels.model.config import SolverConfig
from dc_kernels.model.fields import CACHE, PER_CONTACT, STATS
from dc_kernels.model.joints.groups import Joints
from dc_kernels.model.room import move_segments
from dc_kernels.model.rules import Index
from dc_kernels.model.validate.arrays import Layout, check_field
from dc_kernels.model.validate.known import Facts
from dc_kernels.sleep.sleepers import SleepStorage, check_sleepers
from dc_kernels.solve.integrate import Integrator, typical_weight
from dc_kernels.solve.joints import apart, are_rods, plant, rows_of_worlds
from dc_kernels.solve.rows import resists_rolling
from dc_kernels.solve.storage import SolverStorage


class Moves(NamedTuple):
    """Where the elements of a simulation come to lie in arrays of other sizes."""

    sizes: dict[str, int]
    """Elements on the axes afterwards, by name."""
    start: dict[str, np.ndarray]
    """First element of each world afterwards, (W + 1,), by axis; of joint rows the first of each joint."""
    places: dict[str, tuple[np.ndarray, np.ndarray]]
    """Elements that stay, by axis: where they lie before and afterwards."""
    fresh: np.ndarray
    """Where joints that come lie afterwards."""

    def of(self, values: np.ndarray, axis: str, fill: float) -> np.ndarray:
        """An array with its elements where they come to lie; what is new there has ``fill``."""
        source, target = self.places[axis]
        found = np.full((self.sizes[axis], *values.shape[1:]), fill, values.dtype)
        found[target] = values[source]
        return found


class Storage:
    """All stages of a simulation; what each holds, and the room that it has.

    Attributes:
        broadphase, narrowphase, solver, integrator, sleep, events: the stages.
        general: whether joints have general rows, as not all of them are rods.
        changes: how often the model was changed so that launches are to be made anew.
    """

    def __init__(
        self, model: Model, joints: Joints, config: SolverConfig, *, facts: Facts | None = None, **room: float | str
    ) -> None:
        """Allocate.

        Args:
            model: of the simulation.
            joints: of the simulation.
            config: settings of the solver.
            facts: what is known of model and joints, beside which more is noted; None: nothing.
            room: ``variant`` of the rows, ``pairs`` a shape and ``contacts`` a body to reserve, ``shards`` of worlds,
                and worlds ``at_once`` whose solves may be in flight together.
        """
        self.model, self.joints = model, joints
        self.changes = 0
        self.broadphase = CandidatePairs.of_model(model, float(room["pairs"]))
        rolls = resists_rolling(model)
        self.narrowphase = StepContacts(model, float(room["contacts"]), joints.sizes["joint row"], rolls)
        self.sleep = SleepStorage(model, self.narrowphase.contacts, config.sleep)
        self.events, self.switches = EventStorage(model), SwitchStorage(model)
        self._allow(config)
        weight = (Facts() if facts is None else facts).recall("weight", lambda: typical_weight(model))
        self.integrator = Integrator(model, int(room["shards"]), config.method, weight)
        self._make_rows(str(room["variant"]), config, int(room["at_once"]))

    def _make_rows(self, variant: str, config: SolverConfig, at_once: int) -> None:
        """Allocate rows for contacts and joints."""
        self.general = not are_rods(self.joints)
        self.solver = SolverStorage(
            self.model,
            config,
            variant,
            contacts=self.contact_room,
            bodies=self.integrator.motion.sizes["body+1"],
            at_once=at_once,
            own_rows=self._joint_rows()[1],
            lines=not self.general,
        )
        self.plant()

    def link(self, moves: Moves, variant: str, config: SolverConfig) -> None:
        """Hold other joints, laid out as ``moves`` says, and rows for them; bodies and contacts stay where they are."""
        version, before = self.version, self.solver
        cache, impulse = self.narrowphase.cache, self.narrowphase.cache.numpy("joint_impulse")
        cache.reallocate(("joint_impulse",), **{"joint row": moves.sizes["joint row"]})
        cache.fill("joint_impulse", moves.of(impulse, "joint row", 0))
        self.sleep.link(moves.sizes["joint"], lambda values: moves.of(values, "joint", 0))
        self._make_rows(variant, config, before.at_once)
        self._keep_solver(before, config)
        self.changes += version - self.version + 1

    def _keep_solver(self, before: SolverStorage, config: SolverConfig) -> None:
        """Let rows have the room that they had, and show what the last solve did."""
        slots = np.maximum(self.solver.room.slots, before.room.slots)
        if (slots != self.solver.room.slots).any():
            self.solver.room.slots = slots
            self.solver.relayout(self.contact_room, config)
        for name in STATS:
            self.solver.stats.fill(name, before.stats.numpy(name))

    def plant(self) -> None:
        """Find the trees of the joints, and whom they keep apart, where these are not all rods."""
        if self.general:
            forest = plant(self.model, self.joints)
            self.solver.plant(forest, self.model.body_count if len(forest.row) else 0)
            self.solver.separate(apart(self.model, self.joints))

    def _joint_rows(self) -> tuple[np.ndarray, np.ndarray]:
        """Rods, and rows of other joints, of each world."""
        count = rows_of_worlds(self.model, self.joints)
        return (0 * count, count) if self.general else (count, 0 * count)

    def use(self, variant: str, config: SolverConfig) -> None:
        """Lay out rows of another variant from now on; the next step makes them."""
        self.general = not are_rods(self.joints)
        self.solver.use(variant, self.contact_room, config, *self._joint_rows())
        self.plant()

    def share_joints(self) -> None:
        """Let impulses and colours of general rows be those of the joints, where these have such rows."""
        if self.general:
            for name in ("impulse", "color"):
                self.solver.rows.share(f"row_{name}", self.joints.array(f"joint_{name}"))

    def groups(self) -> dict[str, ArrayGroup]:
        """Every group of arrays by the name that kernels and simulations have for it."""
        return {
            "motion": self.integrator.motion,
            "pairs": self.broadphase.pairs,
            "contacts": self.narrowphase.contacts,
            "cache": self.narrowphase.cache,
            "rows": self.solver.rows,
            "stats": self.solver.stats,
            "sleepers": self.sleep.sleepers,
            "overlaps": self.events.overlaps,
            "touches": self.events.touches,
            "switches": self.switches.switches,
        }

    def adopt(self, groups: Mapping[str, Any], slots: Mapping[str, np.ndarray]) -> None:
        """Take over the groups, and the room in each of them, of another simulation of the same scene and options."""
        self.broadphase.adopt(groups["pairs"], slots["pairs"])
        self.narrowphase.adopt(groups["contacts"], groups["cache"], slots["contacts"])
        self.solver.adopt(groups["rows"], groups["stats"], slots["blocks"])
        self.integrator.adopt(groups["motion"])
        self.sleep.adopt(groups["sleepers"])
        self.events.adopt(groups["overlaps"], groups["touches"])
        self.switches.adopt(groups["switches"])

    def take_over(self, before: Storage, moves: Moves, config: SolverConfig) -> None:
        """Go on from what another storage of the same worlds holds, whose bodies and joints lie elsewhere.

        Contacts keep their keys, as shapes keep their places within their worlds.
        """
        rooms = [(self.broadphase.room, before.broadphase.room), (self.narrowphase.room, before.narrowphase.room)]
        if any((room.slots < earlier.slots).any() for room, earlier in rooms):
            for room, earlier in rooms:
                room.slots = np.maximum(room.slots, earlier.slots)
            self._relayout(config)
        found, had = self.narrowphase, before.narrowphase
        old, new = had.contacts.numpy("contact_start"), found.contacts.numpy("contact_start")
        moved = moves.places["body"][1]
        groups = zip(
            [*had.groups(), *before.sleep.groups(), *before.switches.groups()],
            [*found.groups(), *self.sleep.groups(), *self.switches.groups()],
            strict=True,
        )
        for (source, counted), (target, _) in groups:
            for name, field in target.table.items():
                values = source.numpy(name)
                if field.per in PER_CONTACT:
                    if not len(values):  # nothing resisted rolling
                        continue
                    room_of = target.numpy(name).copy()
                    if field.rule == Index("body") and len(values):
                        values = moved[values]
                    move_segments(values, room_of, old, new, source.numpy(counted))
                    target.fill(name, room_of)
                elif field.per == "world":
                    target.fill(name, values)
                elif field.per in moves.places:
                    target.fill(name, moves.of(values, field.per, 0))
        lists = (self.events.touches, before.events.touches, old, new)
        starts = (before.broadphase.pairs.numpy("start"), self.broadphase.pairs.numpy("start"))
        for target, source, first, start in (lists, (self.events.overlaps, before.events.overlaps, *starts)):
            if target.sizes["world"] and source.sizes["world"]:
                target.restore(source.packed(first, moves.places["shape"][1]), start)
        for name in ("step_dt", "reach"):
            self.integrator.motion.fill(name, before.integrator.motion.numpy(name))
        self._keep_solver(before.solver, config)
        self.changes = before.version + 1

    def pass_over_empty(self, named: Mapping[str, np.ndarray]) -> None:
        """Let steps end at the last slot of each world that something is in; pairs of what lies behind are unknown.

        Args:
            named: ids of what is in the slots, negative where nothing is, of each "body" and "shape"; less than -1 of
                the bodies that the shapes of emptied slots belong to.
        """
        for group, name, axis in self._empty_slots():
            start = self.model.numpy(f"{axis}_start").astype(np.int64)
            used = np.flatnonzero(named[axis] >= 0)
            last = start[:-1].copy()
            np.maximum.at(last, np.searchsorted(start, used, "right") - 1, used + 1)
            group.assign(name, start[1:] - last)
        attics = np.flatnonzero(named["body"] < -1)
        if len(attics):
            self.broadphase.pairs.assign("attic", attics + 1)

    def fill_slots(self, filled: Mapping[str, np.ndarray]) -> None:
        """Let steps know of some slots of each "body" and "shape", (n,), in which there is something now."""
        for group, name, axis in self._empty_slots():
            slots, start = filled[axis], self.model.numpy(f"{axis}_start")
            world = np.searchsorted(start, slots, "right") - 1
            empty = group.numpy(name).copy()
            np.minimum.at(empty, world, start[world + 1] - slots - 1)
            group.assign(name, empty)

    def _empty_slots(self) -> tuple[tuple[ArrayGroup, str, str], ...]:
        """Groups and fields that count empty slots at the end of each world, and the axis of these."""
        motion, pairs = self.integrator.motion, self.broadphase.pairs
        return (motion, "empty_bodies", "body"), (pairs, "empty_shapes", "shape")

    @property
    def version(self) -> int:
        """A number that changes whenever arrays were allocated anew, and whenever ``changes`` does."""
        # every call of ``Images`` asks for it, and the table of groups would take a microsecond
        found, solver = self.narrowphase, self.solver
        taken = self.changes + self.integrator.motion.version + self.broadphase.pairs.version + solver.rows.version
        taken += found.contacts.version + found.cache.version + solver.stats.version
        return taken + self.sleep.sleepers.version + self.events.version + self.switches.switches.version

    @property
    def contact_room(self) -> np.ndarray:
        """Contacts reserved for each world, (W,)."""
        return self.narrowphase.room.slots

    def adapt(self, config: SolverConfig) -> None:
        """Allocate what a new configuration needs."""
        self.solver.keep_history(config)
        self.sleep.allow(config.sleep, self.narrowphase.contacts)
        self.equip(config)
        self.solver.switch(config)
        self.provide(config)

    def roll(self) -> bool:
        """Allocate impulses of rolling resistance, or free them, as the model needs; whether any changed."""
        rolls = resists_rolling(self.model)
        if rolls == self.narrowphase.rolls:
            return False
        self.narrowphase.roll(rolls, self.sleep.groups())
        self.solver.roll(rolls)
        return True

    def equip(self, config: SolverConfig) -> bool:
        """Allocate what model and settings need and is not there yet, or free it; whether there was any."""
        before = self.version
        self.broadphase.keep_hulls(self.model)
        self._allow(config)
        return self.version != before

    def _allow(self, config: SolverConfig) -> None:
        """Allocate lists of events and contacts that are off, as model and settings need them."""
        self.events.allow(self.model, config, self.broadphase.room.total, self.narrowphase.room.total)
        self.switches.allow(self.model, config, self.narrowphase.contacts)

    def provide(self, config: SolverConfig) -> bool:
        """Allocate what an iteration needs and has not got yet; whether there was any."""
        summed = self.integrator.provide(config.method)
        return self.solver.provide(config) or summed

    def grow(self, flags: np.ndarray, config: SolverConfig, error: bool) -> None:
        """More room for the worlds whose flags say that they ran out of it.

        Raises:
            OverflowError: instead, naming world, need and room, with error=True.
        """
        rows = self.solver.rows
        self.broadphase.room.grow(flags, self.broadphase.needed, error)
        self.narrowphase.room.grow(flags, rows.numpy("contact_needed"), error)
        self.solver.room.grow(flags, self.solver.used, error)
        self._relayout(config)

    def _relayout(self, config: SolverConfig) -> None:
        contacts, pairs = self.narrowphase.contacts, self.broadphase.pairs
        before = contacts.numpy("contact_start").copy(), pairs.numpy("start").copy()
        self.narrowphase.relayout([*self.sleep.groups(), *self.switches.groups()])
        self.broadphase.relayout()
        self.events.touches.move(before[0], contacts.numpy("contact_start"))
        self.events.overlaps.move(before[1], pairs.numpy("start"))
        self.solver.relayout(self.contact_room, config)

    def restore(
        self,
        count: np.ndarray,
        arrays: Mapping[str, np.ndarray],
        contact_dt: np.ndarray,
        flags: np.ndarray,
        config: SolverConfig,
    ) -> None:
        """See ``Simulation.restore_contacts``; numbers of contacts of a world with flags may be NaN or inf."""
        given = self.narrowphase.check_restored(self.model, count, arrays, contact_dt, flags)
        if (given.counts > self.contact_room).any():
            self.narrowphase.room.slots = np.maximum(self.contact_room, given.counts)
            self._relayout(config)
        self.sleep.forget(None, self.model.numpy("body_start"))
        self.narrowphase.restore(given, self.joints.numpy("joint_impulse"))

    def restore_sleepers(self, arrays: Mapping[str, np.ndarray], flags: np.ndarray, config: SolverConfig) -> bool:
        """Let bodies sleep as ``arrays`` of an earlier run say (see ``sleep.sleepers.check_sleepers``).

        Args:
            arrays: fields of ``model.fields.SLEEPERS`` by name, contacts packed world after world.
            flags: of the worlds.
            config: settings of the solver.

        Returns:
            Whether their contacts needed more room.

        Raises:
            ValueError: naming array, index, value and limit.
        """
        count = check_sleepers(arrays, self.model, flags)
        more = bool((count > self.contact_room).any())
        if more:
            self.narrowphase.room.slots = np.maximum(self.contact_room, count)
            self._relayout(config)
        self.sleep.restore(arrays, self.narrowphase.contacts.numpy("contact_start"))
        return more

    def restore_lists(
        self, group: str, arrays: Mapping[str, np.ndarray], flags: np.ndarray, config: SolverConfig
    ) -> bool:
        """Let the lists of ``group``, "overlaps" or "touches", be those of an earlier run, where there are such lists.

        Args:
            group: of lists.
            arrays: its fields by name, lists packed world after world.
            flags: of the worlds; numbers of a world with any flag may be NaN or inf.
            config: settings of the solver.

        Returns:
            Whether the lists needed more room.

        Raises:
            ValueError: naming array, index, value and limit.
        """
        lists = getattr(self.events, group)
        longest = check_lists(arrays, lists, self.model, flags)
        if not lists.sizes["world"]:
            return False
        room = self.broadphase.room if group == "overlaps" else self.narrowphase.room
        more = bool((longest > room.slots).any())
        if more:
            room.slots = np.maximum(room.slots, longest)
            self._relayout(config)
        lists.restore(arrays, self._starts(group))
        return more

    def packed_lists(self, group: str) -> dict[str, np.ndarray]:
        """The fields of ``group``, "overlaps" or "touches", by name, lists packed world after world."""
        packed: dict[str, np.ndarray] = getattr(self.events, group).packed(self._starts(group))
        return packed

    def _starts(self, group: str) -> np.ndarray:
        """First slot of each world of the lists of a group, (W + 1,)."""
        if group == "overlaps":
            return self.broadphase.pairs.numpy("start")
        return self.narrowphase.contacts.numpy("contact_start")

    def restore_cache(
        self, count: np.ndarray, arrays: Mapping[str, np.ndarray], contact_dt: np.ndarray, joint_impulse: np.ndarray
    ) -> None:
        """Start the next step from other contacts, for which there is room, than ``contacts`` holds."""
        given = self.narrowphase.check_restored(self.model, count, arrays, contact_dt, np.zeros(len(count), np.int32))
        check_field("joint_impulse", CACHE["joint_impulse"], joint_impulse, Layout(self.model.views()))
        self.narrowphase.restore(given, joint_impulse, shown=False)

    def used(self) -> dict[str, np.ndarray]:
        """Pairs, contacts and blocks of each world at the last step."""
        return {"pairs": self.broadphase.used, "contacts": self.narrowphase.used, "blocks": self.solver.used}

    def reserved(self) -> dict[str, np.ndarray]:
        """Room of each world for pairs, contacts and blocks."""
        return {
            "pairs": self.broadphase.room.slots,
            "contacts": self.contact_room,
            "blocks": self.solver.room.slots,
        }
