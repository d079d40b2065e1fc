"""Touching and overlapping pairs of shapes, as lists, and their changes in each step.

**Sensors** (``sensor=True`` of a shape) carry no impulse: ``sense_overlaps`` takes their pairs out of the candidates
before the narrowphase sees any, and lists those whose shapes overlap or touch where the step begins, by the exact
distance of two rounded polygons. They cost one test of each candidate pair, in scenes that have sensors.

**Contact events** (``SolverConfig.contact_events``): at the end of a step ``note_touches`` merges the contacts, which
are sorted by key, with the pairs that touched before. A pair begins to touch when one of its contacts has an impulse or
overlaps, and ceases when it has no contact any more, so that bodies at rest do not flicker. A pair hits if it
approached faster than ``SolverConfig.hit_speed``, by its velocities before the step, and has an impulse, unless it hit
in the previous step: an impact whose gap closes within a step takes two.

Both are sorted by (A, B), so a merge of two lists finds the pairs that have begun and ended. Lists are of the last
step, or of all its whole substeps together; in a world that has stopped, or sleeps, no pair begins or ends.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from dc_kernels.model.arrays import ArrayGroup, Fielded, Model, to_numpy
from dc_kernels.model.config import SolverConfig
from dc_kernels.model.enums import ShapeRole
from dc_kernels.model.groups import LISTS, OVERLAPS, TOUCHES
from dc_kernels.model.room import fill_segments, move_segments, used_slots
from dc_kernels.model.rules import BrokenRule, refuse

SENSING = ("sense_overlaps", "note_overlaps")
NOTING = ("note_touches",)
"""Kernels that sensors, and contact events, add to those of a step."""


class PairList(NamedTuple):
    """Pairs of shapes, packed world after world; all arrays have the length n."""

    shape_a: np.ndarray
    """Shape of the static body, or of the lower index, numbered over all worlds; of an overlap the sensor."""
    shape_b: np.ndarray
    """The other shape."""
    world: np.ndarray
    """The world of both."""
    slot: np.ndarray
    """Index of the pair in the arrays of the list."""


class PairLists(ArrayGroup):
    """Lists of pairs of shapes, in slots of their worlds (``model.groups``)."""

    noun = ""

    def listed(self, start: np.ndarray, which: str) -> PairList:
        """A list, packed: "" for all, "begun", "ended", "hit".

        Args:
            start: first slot of each world, (W + 1,).
            which: of the lists.
        """
        prefix = f"{which}_" if which else ""
        count = self.numpy(f"{prefix}count")
        slots = used_slots(start, count) if len(count) else np.zeros(0, np.int64)
        a, b = (self.numpy(prefix + side)[slots] for side in "ab")
        return PairList(a, b, np.repeat(np.arange(len(count)), count), slots)

    def allow(self, wanted: bool, worlds: int, slots: int, parts: int) -> None:
        """Allocate the lists, or free them; let a step have so many whole substeps."""
        if wanted != (self.sizes["world"] > 0):
            sizes = {axis: slots for axis in self.sizes if axis != "world"} | {"world": worlds}
            self.reallocate(self.table, **(sizes if wanted else dict.fromkeys(self.sizes, 0)))
        if wanted and (self.numpy("parts") != parts).any():
            self.fill("parts", np.full(worlds, parts, np.int32))
            self.fill("part", np.zeros(worlds, np.int32))

    def move(self, old: np.ndarray, new: np.ndarray) -> None:
        """Allocate the slots anew, where there are any, and move what is listed to where its worlds now begin."""
        if not self.sizes["world"]:
            return
        before = self.renew(**{axis: int(new[-1]) for axis in self.sizes if axis != "world"})
        for name, field in self.table.items():
            if field.per != "world":
                count = LISTS[field.per.removesuffix(self.noun)]
                move_segments(before[name], self.array(name), old, new, self.numpy(count))

    def forget(self, gone: np.ndarray, start: np.ndarray) -> None:
        """Take pairs out of the lists of which a shape is gone.

        Args:
            gone: which shapes are, (shapes,) bool.
            start: first slot of each world, (W + 1,).
        """
        if not self.sizes["world"]:
            return
        for before, counted in LISTS.items():
            if counted not in self.table:
                continue
            prefix, count = counted.removesuffix("count"), self.numpy(counted)
            slots, world = used_slots(start, count), np.repeat(np.arange(len(count)), count)
            hit = gone[self.numpy(f"{prefix}a")[slots]] | gone[self.numpy(f"{prefix}b")[slots]]
            if not hit.any():
                continue
            count = count - np.bincount(world[hit], minlength=len(count))
            for name, field in self.table.items():
                if field.per == before + self.noun:
                    values = self.numpy(name).copy()
                    fill_segments(values, values[slots[~hit]], start, count)
                    self.fill(name, values)
            self.fill(counted, count)

    def packed(self, start: np.ndarray, moved: np.ndarray | None = None) -> dict[str, np.ndarray]:
        """All arrays, those of the lists packed world after world; ``moved``: other numbers of the shapes."""
        found = {}
        for name, field in self.table.items():
            values = self.numpy(name)
            if field.per != "world":
                values = values[used_slots(start, self.numpy(LISTS[field.per.removesuffix(self.noun)]))]
                if moved is not None and name.split("_")[-1] in ("a", "b"):
                    values = moved[values].astype(values.dtype)
            found[name] = values
        return found

    def restore(self, arrays: Mapping[str, np.ndarray], start: np.ndarray) -> None:
        """Take over arrays that ``packed`` gave, for which there is room (``check_lists``).

        A step that is not at its end stays so where it has as many whole substeps.
        """
        parts = self.numpy("parts").copy()
        for name, field in self.table.items():
            values = arrays[name]
            if name == "parts":
                continue
            if name == "part":
                values = np.where(arrays["parts"] == parts, values, 0).astype(np.int32)
            elif field.per != "world":
                values = to_numpy(self.array(name)).copy()
                fill_segments(values, arrays[name], start, arrays[LISTS[field.per.removesuffix(self.noun)]])
            self.fill(name, values)


class Overlaps(PairLists):
    """Pairs of a sensor and another shape (``model.groups.OVERLAPS``): axes are empty where there are no sensors."""

    table = OVERLAPS
    noun = "overlap"


class Touches(PairLists):
    """Pairs of shapes that touch (``model.groups.TOUCHES``); all axes are empty without contact events."""

    table = TOUCHES
    noun = "touching pair"


def axes_of(table: Mapping[str, Any]) -> dict[str, int]:
    """All axes of a table, empty."""
    return dict.fromkeys((field.per for field in table.values()), 0)


def roles_of(model: Model) -> np.ndarray:
    """The role of each shape, a ``ShapeRole``, (shapes,)."""
    roles = model.numpy("shape_role")
    return roles if len(roles) else np.zeros(model.shape_count, np.int32)


def has_sensors(model: Fielded) -> bool:
    """Whether a shape is a sensor."""
    return bool((model.numpy("shape_role") == ShapeRole.SENSOR).any())


def event_kernels(model: Fielded, config: SolverConfig) -> tuple[str, ...]:
    """Kernels that a scene and its settings need beside those of a step (``stages.EVENTS``)."""
    return (*(SENSING if has_sensors(model) else ()), *(NOTING if config.contact_events else ()))


class EventStorage:
    """The lists of a simulation, which are there only where its scene or its settings ask for them.

    Attributes:
        overlaps: of sensors; they lie in slots of the numbers that pairs have.
        touches: of contacts; they lie in slots of the numbers that contacts have.
    """

    def __init__(self, model: Model) -> None:
        """Begin without any; ``allow`` allocates what is needed."""
        memory = (model.dtype, model.device, model.backend)
        self.overlaps, self.touches = Overlaps(axes_of(OVERLAPS), *memory), Touches(axes_of(TOUCHES), *memory)

    def adopt(self, overlaps: Overlaps, touches: Touches) -> None:
        """Take over the lists of the same scene and settings."""
        self.overlaps, self.touches = overlaps, touches

    def allow(self, model: Model, config: SolverConfig, pairs: int, contacts: int) -> None:
        """Allocate what a scene and its settings need, in as many slots as pairs and contacts have."""
        worlds, parts = model.world_count, config.whole_substeps
        self.overlaps.allow(has_sensors(model), worlds, pairs, parts)
        self.touches.allow(config.contact_events, worlds, contacts, parts)

    @property
    def version(self) -> int:
        """A number that changes whenever arrays were allocated anew."""
        return self.overlaps.version + self.touches.version


def check_lists(arrays: Mapping[str, np.ndarray], lists: PairLists, model: Model, flags: np.ndarray) -> np.ndarray:
    """Hold lists of an earlier run to their rules.

    Args:
        arrays: fields of a table by name, packed world after world.
        lists: whose table it is.
        model: of the shapes.
        flags: of the worlds; numbers of a world with any flag may be NaN or inf.

    Returns:
        The length of the longest list of each world, (W,).

    Raises:
        BrokenRule: naming array, index, value and limit.
    """
    start = model.numpy("shape_start")
    longest = np.zeros(model.world_count, np.int64)
    for before, name in LISTS.items():
        if name not in arrays:
            continue
        prefix, count = name.removesuffix("count"), arrays[name]
        refuse(name, count, count < 0, ">= 0")
        total = int(count.sum(dtype=np.int64))
        if total != len(arrays[f"{prefix}a"]):
            raise BrokenRule(name, f"adds up to {total}; it must be {len(arrays[f'{prefix}a'])}, its pairs")
        world = np.repeat(np.arange(len(count)), count)
        for side in "ab":
            shape = arrays[f"{prefix}{side}"]
            wrong = (shape < start[world]) | (shape >= start[world + 1])
            refuse(f"{prefix}{side}", shape, wrong, "a shape of its world")
        for field in lists.table.values():
            if field.per == f"{before}{lists.noun}" and field.dtype != "int32":
                values = arrays[field.name]
                bad = ~np.isfinite(values).reshape(total, math.prod(values.shape[1:])).all(axis=1) & (flags[world] == 0)
                refuse(field.name, values, bad, "finite")
        longest = np.maximum(longest, count)
    parts = arrays["parts"]
    refuse("parts", parts, parts < 1, ">= 1")
    refuse("part", arrays["part"], (arrays["part"] < 0) | (arrays["part"] >= parts), "within [0, parts)")
    return longest
