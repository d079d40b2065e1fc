"""Narrowphase: contact points of pairs of shapes, as a stage."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from typing import Any

import numpy as np

from dc_kernels.collide.broadphase import Broadphase, Pairs
from dc_kernels.collide.contacts import FoundContacts
from dc_kernels.collide.shapes import Shapes, whole_group
from dc_kernels.model.arrays import kernel_array, kernel_vectors, to_numpy
from dc_kernels.model.config import CONFIG, SLACK, SolverConfig
from dc_kernels.model.dtypes import aligned_zeros
from dc_kernels.model.enums import BodyType, Flag, ShapeType
from dc_kernels.model.fields import LAUNCH, MOTION, ROWS
from dc_kernels.model.room import starts
from dc_kernels.model.settings import UnknownName, shown
from dc_kernels.runtime.backends import Launch, bind, host_threads, kernel_file, make_kernels
from dc_kernels.runtime.capture import STALE, Recordings, recording
from dc_kernels.runtime.inputs import (
    MAX_INDEX,
    check_array,
    check_count,
    check_index,
    check_layout,
    check_not_negative,
    check_slots,
    check_start,
)
from dc_kernels.runtime.interop import InPlace
from dc_kernels.runtime.sequences import as_one
from dc_kernels.runtime.threads import run_shards, shard_worlds

CONTACTS_PER_BODY = 2.5  # reserved at first
FOUND = ("key", "body_a", "body_b", "normal", "arm_a", "arm_b", "gap", "friction", "restitution")


class Narrowphase(InPlace):
    """Computes contacts of pairs of shapes: discs, capsules, polygons with or without rounding, segments of chains.

        narrowphase = dc.Narrowphase(model, position, angle, broadphase)
        narrowphase()
        gaps = narrowphase.numpy("gap")  # or narrowphase.gap, .normal, .point ..., .count for kernels

    Each world has its own range of the arrays: its ``count[w]`` contacts begin at ``contact_start[w]``, in the order
    of the pairs, which is that of the keys if pairs are sorted. Contacts have the conventions of ``model.fields``: the
    normal points from body A, static or of the lower index, to body B; the gap is negative where surfaces overlap.

    Contacts of discs with discs and hulls are computed in closed form, those of hulls with hulls by separating axes
    and clipping (``_warp/collide/manifold.py``, as in Box2D v3): up to two points a pair.

    A call within ``wp.ScopedCapture`` becomes part of the graph. Arrays cannot grow in a replay: ``check`` afterwards
    raises if some contacts did not fit; such a world has no contacts. Several Python threads may call one
    narrowphase; the calls run one after the other.

    Attributes:
        count: number of contacts of each world, (W,) int32.
        contact_start: first element of each world's range, (W + 1,) int32.
        key: shape A, shape B (numbered in their world) and feature, (capacity,) int64; a contact keeps its key from
            call to call.
        body_a, body_b: bodies, (capacity,) int32.
        normal: unit vectors from A to B, (capacity,) vectors.
        point: midpoints between the surfaces, (capacity,) vectors [m].
        arm_a, arm_b: vectors from the bodies' centres of mass to the point, (capacity,) vectors [m].
        gap: distances of the surfaces, (capacity,) [m].
        friction, restitution: coefficients of the pair, (capacity,) [1].
        flags: ``Flag`` bits of each world in the last call, (W,) int32: CONTACT_OVERFLOW, or INVALID.
        layout_version: number that changes whenever arrays are reallocated.
    """

    def __init__(
        self,
        shapes: Any,
        position: Any,
        angle: Any,
        pairs: Any,
        *,
        pair_start: Any = None,
        pair_count: Any = None,
        reach: float = 0.0,
        max_contacts: Any = None,
        threads: int = 1,
        backend: str | None = None,
    ) -> None:
        """Check the arguments and allocate all memory. All arrays are kept, and read at each call.

        Args:
            shapes: a model of ``ModelBuilder.finalize``; or arrays by name (see ``collide.shapes.Shapes``). Their
                types, and whether all are centred discs, are read only here.
            position: centres of mass of the bodies, (bodies, 2), contiguous on the CPU, of the shapes' dtype [m].
            angle: orientations of the bodies, (bodies,) [rad].
            pairs: a ``Broadphase`` of these shapes' boxes; or pairs of shapes in any order, (capacity, 2) int32, those
                of each world from ``pair_start`` on.
            pair_start: first row of each world and the number of rows, (W + 1,); None for one world.
            pair_count: number of pairs of each world, (W,) int32; None: all rows.
            reach: largest gap of a contact, >= 0 [m]; it must be at least the approach of two shapes in a step.
            max_contacts: capacity for contacts of each world, a number or (W,), beyond which an error is raised; None:
                the capacity grows.
            threads: number of threads that share the worlds; the contacts do not depend on it.
            backend: "warp", "taichi", or "numpy" for the oracle; None: that of the model.

        Raises:
            ValueError, TypeError: an argument is invalid; the error names argument, index and limit.
        """
        self.shapes = Shapes(shapes, backend)
        self.backend, self.dtype = self.shapes.backend, self.shapes.dtype
        self._kept = (position, angle, pairs, pair_count)  # whose memory the kernels read
        worlds = self.shapes.worlds
        self._flags = np.zeros(worlds, np.int32)
        self.position, self.angle = position, angle
        self._recordings = Recordings()
        self._state = self.shapes.state(position, angle, flags=self._flags)
        self.flags = self._state.flags
        self.threads = check_count("threads", threads)
        self.reach = check_not_negative("reach", reach)
        self._take(pairs, pair_start, pair_count)
        bodies = np.diff(self.shapes.arrays["body_start"]).astype(np.int64)
        self.fixed = max_contacts is not None
        slots = check_slots("max_contacts", max_contacts, worlds) if self.fixed else np.ceil(CONTACTS_PER_BODY * bodies)
        sizes = {"world": worlds, "world+1": worlds + 1}
        self._found = FoundContacts(sizes, slots, self.dtype, "cpu", self.backend)
        self._needed = np.zeros(worlds, np.int32)
        self._lock = threading.Lock()
        self._bind()

    def _take(self, pairs: Any, pair_start: Any, pair_count: Any) -> None:
        """Check the pairs, of a broadphase or in rows."""
        worlds, count = self.shapes.worlds, len(self.shapes.arrays["shape_type"])
        self._broadphase = pairs if isinstance(pairs, Broadphase) else None
        if self._broadphase is not None:
            if (pairs.backend, pairs.dtype) != (self.backend, self.dtype):
                raise ValueError(
                    f"pairs is a Broadphase of backend {pairs.backend!r} and dtype {pairs.dtype}; "
                    f"the shapes have {self.backend!r} and {self.dtype}"
                )
            if not np.array_equal(pairs.start, self.shapes.arrays["shape_start"]):
                raise ValueError(f"pairs.start is {pairs.start}; that of the shapes, shape_start, differs")
            self._pair, self._pair_count = np.zeros((0, 2), np.int32), np.zeros(0, np.int32)
            return
        self._pair = check_layout("pairs", pairs, (None, 2), np.dtype(np.int32))
        rows = check_start("pair_start", pair_start, len(self._pair), "pairs")
        if len(rows) != worlds + 1:
            raise ValueError(f"pair_start has {len(rows) - 1} worlds; the shapes have {worlds}")
        if pair_count is None:
            self._pair_count = np.diff(rows).astype(np.int32)
        else:
            self._pair_count = check_layout("pair_count", pair_count, (worlds,), np.dtype(np.int32))
        sizes = {"world": worlds, "world+1": worlds + 1, "pair": len(self._pair), "shape": 0, "bucket": 0}
        sizes |= {"turned body": 0, "kept pair": 0}
        self._pairs = Pairs(sizes, self.dtype, "cpu", self.backend)
        self._pairs.assign("start", starts(np.diff(rows)))
        if count:
            self._check_pairs()

    def _bind(self) -> None:
        """Bind the launches to the present arrays."""
        contacts, dtype, backend = self._found.contacts, self.dtype, self.backend
        groups = kernel_file(backend, "groups")
        arrays, worlds = self.shapes.arrays, self.shapes.worlds
        pairs = self._broadphase.pairs if self._broadphase is not None else self._pairs
        self._version = pairs.version
        for name in FOUND:
            setattr(self, name, contacts.array(name))
        self.count, self.contact_start = contacts.contact_count, contacts.contact_start
        point = aligned_zeros((contacts.sizes["contact"], 2), dtype)
        # nothing moves; the share of a body in what parts two goes by its inverse mass
        still = aligned_zeros((self.shapes.bodies, 4), dtype)
        still[:, 3] = arrays.get("inv_mass", arrays["body_type"] == BodyType.DYNAMIC)
        motion = {"step_dt": np.zeros(worlds, dtype), "reach": np.full(worlds, self.reach, dtype), "predicted": still}
        slop = SolverConfig().slop
        settings = {"slop": slop, "slack": SLACK * slop, "uniform_friction": -1.0, "uniform_restitution": -1.0}
        values = {
            "model": self.shapes.group(),
            "state": self._state,
            "motion": whole_group("motion", dtype, MOTION, motion, backend),
            "rows": whole_group("rows", dtype, ROWS, {"contact_needed": self._needed}, backend),
            "config": groups.group("config", dtype.name, CONFIG, settings),
            "pairs": groups.array_group(pairs, "pairs"),
            "contacts": groups.array_group(contacts, "contacts"),
            "pair": kernel_array(self._pair, backend),
            "pair_count": kernel_array(self._pair_count, backend),
            "point": kernel_vectors(point, backend),
            "threads": self.threads,
        }
        self.point = values["point"]
        table = dict(make_kernels(backend, "collide.narrowphase", dtype.name, factory="stage_kernels"))
        only_discs = bool((arrays["shape_type"] == ShapeType.DISC).all() and not arrays["shape_center"].any())
        table |= make_kernels(backend, "collide.narrowphase", dtype.name, only_discs)
        names = ("take_pairs", "narrowphase", "place_contacts")

        def shard(first: int, count: int) -> Launch:
            launch = groups.group("launch", dtype.name, LAUNCH, {"world_offset": first})
            return as_one([bind(table[name], count, {**values, "launch": launch}, "cpu") for name in names])

        parts = shard_worlds(worlds, host_threads(backend, self.threads))
        self._shards = [shard(*part) for part in parts] if worlds else []

    @property
    def lengths(self) -> Mapping[str, int]:
        """Return the numbers of its elements, by noun."""
        return {"shape": len(self.shapes.arrays["shape_type"]), "world": self.shapes.worlds}

    @property
    def layout_version(self) -> int:
        """Number that changes whenever arrays are reallocated."""
        return self._found.contacts.version

    def __call__(self) -> Any:
        """Compute the contacts of the present pairs and return ``count``.

        Raises:
            OverflowError: a world, which the error names, has more contacts than ``max_contacts``.
            ValueError: a body is not finite, or a pair is not of two shapes of a world; the error names argument and
                index.
        """
        if self._broadphase is not None and self._broadphase.layout_version != self._version:
            with self._lock:
                self._rebind()
        run_shards(self._shards, self.threads)
        if recording():
            self._recordings.note()
        elif self._flags.any():
            with self._lock:
                while self._flags.any():
                    self._explain(room=self.fixed)
                    self._found.room.grow(self._flags, self._needed, error=False)
                    left = to_numpy(self.count)
                    self._found.relayout()
                    self._rebind()
                    left.fill(STALE)
                    run_shards(self._shards, self.threads)
        return self.count

    def check(self, room: bool = True) -> None:
        """Raise an error for a failure in the last call or replay, as a replay itself cannot raise.

        Args:
            room: whether to raise an error for contacts that did not fit.

        Raises:
            OverflowError, ValueError: see ``__call__``.
            RuntimeError: the replayed graph was recorded before ``layout_version`` changed.
        """
        self._recordings.check(self.layout_version)
        self._explain(room)

    def _rebind(self) -> None:
        """Bind to new arrays; graphs recorded before keep using the old ones."""
        self._flags = self._recordings.renew(self._flags, self._shards)
        self._state = self.shapes.state(self.position, self.angle, flags=self._flags)
        self.flags = self._state.flags
        self._bind()

    def _explain(self, room: bool) -> None:
        """Raise for the flags of the last call."""
        if (self._flags & Flag.INVALID).any():
            check_array("position", self.position, (None, 2))
            check_array("angle", self.angle, (None,))
            self._check_pairs()
        full = np.flatnonzero(self._flags & Flag.CONTACT_OVERFLOW)
        if room and len(full):
            w = int(full[0])
            reserved = int(self._found.room.slots[w])
            raise OverflowError(f"world {w} has {int(self._needed[w])} contacts; max_contacts is {reserved}")

    def _check_pairs(self) -> None:
        """Raise ValueError for rows that are no pairs of two shapes of a world."""
        if self._broadphase is not None:
            return
        start, shapes = to_numpy(self._pairs.start), self.shapes.arrays["shape_start"]
        check_index("pair_count", self._pair_count, MAX_INDEX)
        for w, count in enumerate(self._pair_count):
            room = int(start[w + 1] - start[w])
            if count > room:
                raise ValueError(f"pair_count[{w}] is {count}; it must lie in [0, {room}]")
            rows = self._pair[start[w] : start[w] + count]
            bad = np.argwhere((rows < shapes[w]) | (rows >= shapes[w + 1]) | (rows[:, :1] == rows[:, 1:]))
            if len(bad):
                i, k = int(start[w] + bad[0][0]), int(bad[0][1])
                raise ValueError(
                    f"pairs[{i}] is {self._pair[i].tolist()}; pairs[{i}, {k}] must lie in "
                    f"[{shapes[w]}, {shapes[w + 1] - 1}], as shapes of world {w} do, and differ from the other"
                )

    def numpy(self, name: str) -> np.ndarray:
        """A field of the contacts of all worlds, one world after the other, (m, ...): a copy.

        Args:
            name: of an attribute with room for contacts, such as "gap".

        Raises:
            UnknownName: for any other name.
        """
        if name not in (known := (*FOUND, "point")):
            raise UnknownName(
                f"name is {shown(name)}, of no array with room for contacts; there are {', '.join(known)}"
            )
        values, first = to_numpy(getattr(self, name)), to_numpy(self.contact_start)
        return np.concatenate([values[:0], *(values[a : a + n] for a, n in zip(first, to_numpy(self.count)))])
