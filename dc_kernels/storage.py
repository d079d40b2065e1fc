"""Room for pairs, contacts and solver rows: reserved a world, grown between steps, never silently too small."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from dc_kernels.model.arrays import ArrayGroup, Contacts, Joints, Model, allocate, to_numpy
from dc_kernels.model.config import SolverConfig
from dc_kernels.model.enums import Flag
from dc_kernels.model.fields import CACHE, MOTION, PAIRS, ROWS
from dc_kernels.solve.iteration import PAST
from dc_kernels.solve.rows import COLORS, COLUMNS, LANES
from dc_kernels.solve.schedules import SolveStats

GROWTH = 1.25  # of what a step needed, so that a growing pile reallocates rarely
PADDING = 8  # bodies between the padding bodies of two shards: more than a cache line
SPARE_BLOCKS = 10  # blocks beyond full ones: a colour's last block is partly empty, and piles have 6-10 colours


class Motion(ArrayGroup):
    """Velocities and displacements of the step in flight (``model.fields.MOTION``)."""

    table = MOTION


class Cache(ArrayGroup):
    """Contacts of the last finished step, by key (``model.fields.CACHE``)."""

    table = CACHE


class Pairs(ArrayGroup):
    """Broadphase: cells, boxes and candidate pairs (``model.fields.PAIRS``)."""

    table = PAIRS


class Rows(ArrayGroup):
    """Solver rows and colours (``model.fields.ROWS``)."""

    table = ROWS


def starts(room: np.ndarray) -> np.ndarray:
    """Offsets of consecutive segments of the given sizes."""
    total = np.concatenate([[0], np.cumsum(room, dtype=np.int64)])
    if total[-1] >= 2**31:
        raise ValueError(f"all worlds together need {int(total[-1])} slots; the limit is {2**31 - 1}")
    return total.astype(np.int32)


def bucket_room(shapes: np.ndarray) -> np.ndarray:
    """Buckets of the cell list of each world: a power of two that is not below its shapes, and one more."""
    return 2 ** np.ceil(np.log2(np.maximum(shapes, 2))).astype(np.int64) + 1


def blocks_for(contacts: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """Blocks reserved for so many contacts and joints."""
    return -(-(contacts + joints) // LANES) + SPARE_BLOCKS


def typical_weight(model: Model) -> np.ndarray:
    """Gravity times the geometric mean of the dynamic bodies' masses, (W,) [N]; 0 in a world without any.

    The geometric mean follows light bodies among heavy ones, and not to where a heavy one's round-off lies above it.
    """
    worlds = np.repeat(np.arange(model.world_count), np.diff(model.numpy("body_start")))
    dynamic = model.numpy("inv_mass") > 0
    mass = model.numpy("mass").astype(np.float64)[dynamic]
    count = np.bincount(worlds[dynamic], minlength=model.world_count)
    total = np.bincount(worlds[dynamic], weights=np.log(mass), minlength=model.world_count)
    mean = np.where(count > 0, np.exp(total / np.maximum(count, 1)), 0.0)
    return (mean * np.linalg.norm(model.numpy("gravity").astype(np.float64), axis=1)).astype(model.dtype)


def move_segments(array: Any, target: Any, old: np.ndarray, new: np.ndarray, counts: np.ndarray) -> None:
    """Copy the used part of every world's segment to its place in a new layout."""
    source = to_numpy(array)
    room = to_numpy(target)
    for w in np.flatnonzero(counts):
        n = int(counts[w])
        room[new[w] : new[w] + n] = source[old[w] : old[w] + n]
    if not isinstance(target, np.ndarray) and room.ctypes.data != target.ptr:
        target.assign(room)


class Storage:
    """All arrays of a simulation beside model, state and joints, and the room they have.

    Attributes:
        pair_room, contact_room, block_room: what is reserved for each world, (W,).
        version: changes whenever arrays were allocated anew.
    """

    def __init__(
        self,
        model: Model,
        joints: Joints,
        config: SolverConfig,
        variant: str,
        pairs: float,
        contacts: float,
        shards: int,
        at_once: int,
    ) -> None:
        """Allocate for so many pairs a shape and contacts a body, and a padding body for each shard of worlds.

        ``at_once``: worlds whose solves may be in flight together.
        """
        self.version = 0
        self.at_once = at_once
        self.model = model
        self.joints = joints
        self.width = len(COLUMNS[variant]) * LANES
        self._joint_counts = np.diff(model.numpy("joint_start")).astype(np.int64)
        shapes = np.diff(model.numpy("shape_start")).astype(np.int64)
        self.pair_room = np.ceil(pairs * shapes).astype(np.int64)
        self.contact_room = np.ceil(contacts * np.diff(model.numpy("body_start"))).astype(np.int64)
        self.block_room = blocks_for(self.contact_room, self._joint_counts)
        worlds, bodies = model.world_count, model.body_count
        buckets = bucket_room(shapes)
        self.sizes = {
            **model.sizes,
            "joint": model.joint_count,
            "body+1": bodies + PADDING * shards,
            "body sum": bodies + PADDING * shards if config.method == "jacobi" else 1,
            "bucket": int(buckets.sum()),
            "world color": worlds * COLORS,
            "world color+1": worlds * (COLORS + 1),
            "sweep": config.max_sweeps if config.history else 0,
            "row direction": 0,
            "row past": 0,
        }
        self._count(config)
        make = (self.sizes, model.dtype, model.device, model.backend)
        self.motion = Motion(*make)
        self.motion.assign("weight", typical_weight(model))
        self.pairs = Pairs(*make)
        self.contacts = Contacts(*make)
        self.cache = Cache(*make)
        self.rows = Rows(*make)
        self.stats = SolveStats(*make)
        self.pairs.assign("bucket_start", starts(buckets))
        self._assign_starts()

    def groups(self) -> tuple[ArrayGroup, ...]:
        """Every group of arrays."""
        return (self.motion, self.pairs, self.contacts, self.cache, self.rows, self.stats)

    def adapt(self, config: SolverConfig, before: SolverConfig) -> None:
        """Allocate what a new configuration needs."""
        if (config.history, config.max_sweeps) != (before.history, before.max_sweeps):
            self.sizes["sweep"] = config.max_sweeps if config.history else 0
            self._reallocate(self.stats, ("history",))
            self.version += 1
        self.provide(config)

    def provide(self, config: SolverConfig) -> bool:
        """Allocate what an iteration needs and has not got yet; whether there was any."""
        missing: list[tuple[ArrayGroup, str, str, int]] = []
        if config.method == "jacobi" and self.sizes["body sum"] == 1:
            missing.append((self.motion, "summed", "body sum", self.sizes["body+1"]))
        if config.acceleration == "nncg" and self.sizes["row direction"] == 0:
            missing.append((self.rows, "direction", "row direction", self.sizes["row pair"]))
        if config.acceleration != "none" and self.sizes["row past"] == 0:
            missing.append((self.rows, "past", "row past", self.at_once * self.past_width))
        for group, name, axis, size in missing:
            self.sizes[axis] = size
            self._reallocate(group, (name,))
        return bool(missing)

    def grow(self, flags: np.ndarray, config: SolverConfig, error: bool) -> None:
        """More room for the worlds whose flags say that they ran out of it.

        Raises:
            OverflowError: instead, naming world, need and room, with error=True.
        """
        needs = (
            (Flag.PAIR_OVERFLOW, "pairs", self.pair_room, self.pairs.numpy("needed")),
            (Flag.CONTACT_OVERFLOW, "contacts", self.contact_room, self.rows.numpy("contact_needed")),
            (Flag.ROW_OVERFLOW, "blocks of rows", self.block_room, self.rows.numpy("block_needed")),
        )
        for flag, what, room, needed in needs:
            full = np.flatnonzero(flags & int(flag))
            if len(full) and error:
                w = int(full[0])
                raise OverflowError(
                    f"world {w} needs {int(needed[w])} {what}, {int(room[w])} are reserved; the step was not taken"
                )
            room[full] = np.ceil(GROWTH * needed[full]).astype(np.int64)
        self._relayout(config)

    def _count(self, config: SolverConfig) -> None:
        """Sizes of the axes that follow the room."""
        self.block_room = np.maximum(self.block_room, blocks_for(self.contact_room, self._joint_counts))
        blocks = int(self.block_room.sum())
        self.sizes.update(
            {
                "pair": int(self.pair_room.sum()),
                "contact": int(self.contact_room.sum()),
                "row column": blocks * self.width,
                "row pair": blocks * 2 * LANES,
            }
        )
        if self.sizes["row direction"] or config.acceleration == "nncg":
            self.sizes["row direction"] = self.sizes["row pair"]
        if self.sizes["row past"] or config.acceleration != "none":
            self.sizes["row past"] = self.at_once * self.past_width

    @property
    def past_width(self) -> int:
        """Numbers that a world's accelerated solve may have to look back on."""
        rows = int(self.block_room.max(initial=0)) * 2 * LANES
        return PAST * rows + 4 * int(np.diff(self.model.numpy("body_start")).max(initial=0))

    def _assign_starts(self) -> None:
        self.pairs.assign("start", starts(self.pair_room))
        self.contacts.assign("contact_start", starts(self.contact_room))
        self.rows.assign("block_start", starts(self.block_room))

    def _reallocate(self, group: ArrayGroup, names: tuple[str, ...]) -> None:
        """New zeroed arrays for the present sizes."""
        self.version += 1
        group.sizes = dict(self.sizes)
        model = self.model
        for name in names:
            field = group.table[name]
            array = allocate(field, self.sizes, model.dtype, model.device, model.backend)
            setattr(group, name, array)

    def _relayout(self, config: SolverConfig) -> None:
        """Move the contact segments to their new places; pairs and rows are made anew."""
        old = self.contacts.numpy("contact_start").copy()
        new = starts(self.contact_room)
        self._count(config)
        for group, count in ((self.contacts, "contact_count"), (self.cache, "count")):
            names = tuple(name for name, field in group.table.items() if field.per == "contact")
            before = {name: group.array(name) for name in names}
            self._reallocate(group, names)
            for name in names:
                move_segments(before[name], group.array(name), old, new, group.numpy(count))
        self._reallocate(self.pairs, ("shape_a", "shape_b", "temp_a", "temp_b"))
        packed = ("slot", "column", "body", "impulse", "change")
        self._reallocate(self.rows, (*packed, "before", "direction", "past"))
        self.pairs.assign("valid", np.zeros(self.model.world_count, np.int32))
        self._assign_starts()

    def restore(
        self, count: np.ndarray, arrays: Mapping[str, np.ndarray], contact_dt: np.ndarray, config: SolverConfig
    ) -> None:
        """See ``Simulation.restore_contacts``."""
        worlds = self.model.world_count
        count = np.asarray(count, np.int64)
        if count.shape != (worlds,) or (count < 0).any():
            raise ValueError(f"count has shape {count.shape}; it must be one number >= 0 for each of {worlds} worlds")
        total = int(count.sum())
        for name in ("key", "impulse", "color", "age"):
            if name not in arrays:
                raise ValueError(f"{name} is missing; the contact cache needs key, impulse, color and age")
        for name, values in arrays.items():
            if len(values) != total:
                raise ValueError(f"{name} has {len(values)} contacts; the worlds together have {total}")
        if (count > self.contact_room).any():
            self.contact_room = np.maximum(self.contact_room, count)
            self._relayout(config)
        first = self.contacts.numpy("contact_start")
        source = np.concatenate([[0], np.cumsum(count)])
        for name, values in arrays.items():
            targets: list[tuple[ArrayGroup, str]] = [(self.contacts, name)]
            if name in self.cache.table:
                targets.append((self.cache, name))
            for group, field in targets:
                array = group.numpy(field)
                for w in range(worlds):
                    array[first[w] : first[w] + count[w]] = values[source[w] : source[w + 1]]
                if self.model.device != "cpu":
                    group.array(field).assign(array)
        self.contacts.assign("contact_count", count)
        self.cache.assign("count", count)
        self.contacts.assign("contact_dt", contact_dt)
        self.cache.assign("joint_impulse", self.joints.numpy("joint_impulse"))

    def check_start(self) -> None:
        """Raise ValueError, naming the contact, if a start impulse is NaN or inf."""
        impulse = self.contacts.numpy("impulse")
        first = self.contacts.numpy("contact_start")
        for w, count in enumerate(self.contacts.numpy("contact_count")):
            start = impulse[first[w] : first[w] + count]
            bad = np.argwhere(~np.isfinite(start))
            if len(bad):
                c, k = (int(i) for i in bad[0])
                raise ValueError(
                    f"contacts.impulse[{first[w] + c}, {k}] (contact {c} of world {w}) is {start[c, k]}; "
                    "a start impulse must be finite"
                )

    def used(self) -> dict[str, np.ndarray]:
        """Pairs, contacts and blocks of each world at the last step."""
        return {
            "pairs": self.pairs.numpy("count"),
            "contacts": self.contacts.numpy("contact_count"),
            "blocks": self.rows.numpy("block_needed"),
        }

    def reserved(self) -> dict[str, np.ndarray]:
        """Room of each world for the same."""
        return {"pairs": self.pair_room, "contacts": self.contact_room, "blocks": self.block_room}
