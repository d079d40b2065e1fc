"""Broadphase: candidate pairs of boxes, kept until a box leaves its enlarged copy and its pairs are found again."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from typing import Any

import numpy as np

from dc_kernels.collide.fields import BOXES
from dc_kernels.model.arrays import ArrayGroup, Model, to_numpy
from dc_kernels.model.enums import BodyType, Flag, ShapeType
from dc_kernels.model.fields import LAUNCH, MODEL, PAIRS, STATE
from dc_kernels.model.room import Room, starts
from dc_kernels.model.rules import refuse
from dc_kernels.runtime.backends import bind, check_backend, host_threads, kernel_file, make_kernels
from dc_kernels.runtime.capture import STALE, Recordings, recording
from dc_kernels.runtime.inputs import (
    MAX_INDEX,
    check_count,
    check_index,
    check_layout,
    check_not_negative,
    check_slots,
    check_start,
)
from dc_kernels.runtime.interop import InPlace
from dc_kernels.runtime.memory import check_memory
from dc_kernels.runtime.threads import run_shards, shard_worlds

PAIRS_PER_BOX = 4.0  # reserved at first


class Pairs(ArrayGroup):
    """Cells, boxes and candidate pairs (``model.fields.PAIRS``)."""

    table = PAIRS


class CandidatePairs:
    """The arrays of a broadphase and the room that they have.

    Attributes:
        pairs: the pairs, sorted by (A, B) in each world.
        room: pairs reserved for each world.
    """

    def __init__(
        self, shapes: np.ndarray, slots: np.ndarray, dtype: Any, device: str, backend: str, turned: int = 0
    ) -> None:
        """Reserve.

        Args:
            shapes: of each world, (W,).
            slots: pairs to reserve for each world, (W,).
            dtype: float32 or float64.
            device: of the arrays.
            backend: of the arrays.
            turned: bodies whose hulls are met by what is kept of their pairs; 0: nothing is kept.
        """
        shapes = np.asarray(shapes, np.int64)
        self.room = Room("pairs", Flag.PAIR_OVERFLOW, slots)
        # buckets of the cell list: a power of two that is not below a world's shapes, and one more
        buckets = 2 ** np.ceil(np.log2(np.maximum(shapes, 2))).astype(np.int64) + 1
        sizes = {"world": len(shapes), "world+1": len(shapes) + 1, "shape": int(shapes.sum())}
        sizes |= {"pair": self.room.total, "bucket": int(buckets.sum())}
        sizes |= {"turned body": turned, "kept pair": 2 * self.room.total if turned else 0}
        self.pairs = Pairs(sizes, dtype, device, backend)
        self.pairs.fill("bucket_start", starts(buckets))
        self.pairs.fill("start", self.room.starts())

    @classmethod
    def of_model(cls, model: Model, pairs_per_shape: float) -> CandidatePairs:
        """Reserve so many pairs for each shape of a model."""
        shapes = np.diff(model.numpy("shape_start")).astype(np.int64)
        slots = np.ceil(pairs_per_shape * shapes)
        return cls(shapes, slots, model.dtype, model.device, model.backend, _turned_bodies(model))

    def keep_hulls(self, model: Model) -> None:
        """Allocate what is kept of pairs of hulls, where a model has got its first ones."""
        pairs = self.pairs
        if pairs.sizes["turned body"] == 0 and (turned := _turned_bodies(model)):
            axes = {"turned body": turned, "kept pair": 2 * self.room.total}
            pairs.reallocate([name for name, field in pairs.table.items() if field.per in axes], **axes)
            pairs.fill("kept_count", np.zeros(pairs.sizes["world"], np.int32))
            pairs.fill("kept_rebuilds", np.full(pairs.sizes["world"], -1, np.int32))

    def adopt(self, pairs: Pairs, slots: np.ndarray) -> None:
        """Take over the pairs of as many shapes, and their room."""
        self.pairs, self.room.slots = pairs, slots

    @property
    def used(self) -> np.ndarray:
        """Candidate pairs of each world at the last step, (W,); its room is for those of boxes with margin."""
        return self.pairs.numpy("count")

    @property
    def needed(self) -> np.ndarray:
        """Pairs found at the last rebuild, also those without room, (W,)."""
        return self.pairs.numpy("needed")

    def relayout(self) -> None:
        """Allocate the room anew; pairs are found in the next step."""
        pairs = self.pairs
        kept = 2 * self.room.total if pairs.sizes["turned body"] else 0
        pairs.renew(**{"pair": self.room.total, "kept pair": kept})
        for name in ("valid", "kept_count"):
            pairs.assign(name, np.zeros(pairs.sizes["world"], np.int32))
        pairs.assign("start", self.room.starts())


class Broadphase(InPlace):
    """Finds the pairs of overlapping boxes; the sizes of the boxes may differ by any ratio.

        broadphase = dc.Broadphase(lower, upper, margin=0.1)  # numpy, torch or wp.array, read in place
        broadphase()                                          # call it again when the boxes have moved
        for a, b in broadphase.numpy(): ...                   # or broadphase.shape_a, .shape_b, .count for kernels

    Each world has its own range of the arrays: its ``count[w]`` pairs begin at ``pair_start[w]``, sorted by (A, B).
    A is the box of the static body, else the one with the lower index. With a margin the pairs are those of boxes
    enlarged by it on each side. They are kept, with one test of each box per call, until a box leaves its enlarged
    copy: the box then gets a new copy, and only its pairs are found again (all pairs if more than half of the boxes
    have left, or a filter changes). So all pairs of overlapping boxes are found, and also
    some that are up to about two margins apart. Without a margin the pairs are exactly those that overlap.

    A call within ``wp.ScopedCapture`` becomes part of the graph. Arrays cannot grow in a replay: ``check`` afterwards
    raises if some pairs did not fit; such a world has no pairs. Several Python threads may call one
    broadphase; the calls run one after the other.

    Boxes are sorted into cells on levels whose cells double in size (``_warp/collide/broadphase.py``).

    Attributes:
        shape_a, shape_b: boxes of the pairs, (capacity,) int32, numbered over all worlds.
        count: number of pairs of each world, (W,) int32.
        pair_start: first element of each world's range, (W + 1,) int32.
        flags: ``Flag`` bits of each world in the last call, (W,) int32: PAIR_OVERFLOW, or INVALID.
        rebuilds: number of times that each world's pairs were found again, (W,) int32.
        start: first box of each world and the number of boxes, (W + 1,) int64.
        layout_version: number that changes whenever arrays are reallocated.
    """

    def __init__(
        self,
        lower: Any,
        upper: Any,
        start: Any = None,
        *,
        margin: float = 0.0,
        max_pairs: Any = None,
        shape_body: Any = None,
        body_type: Any = None,
        category: Any = None,
        mask: Any = None,
        threads: int = 1,
        backend: str = "warp",
    ) -> None:
        """Check the arguments and allocate all memory. All arrays are kept, and read at each call.

        Args:
            lower: lower corners, (n, 2), float32 or float64, contiguous on the CPU [m].
            upper: upper corners, (n, 2), of the same dtype [m].
            start: first box of each world and the number of boxes, (W + 1,); None for one world.
            margin: enlargement of boxes on each side while pairs are kept, >= 0 [m].
            max_pairs: capacity for pairs of each world, a number or (W,), beyond which an error is raised; None: the
                capacity grows.
            shape_body: body of each box, (n,) int32: boxes of one body form no pair; None: each box is its own body.
            body_type: ``BodyType`` of each body, (bodies,) int32: a pair needs a dynamic one; None: all are dynamic.
            category: category bits of each box, (n,) uint32; None: all bits.
            mask: categories that each box accepts, (n,) uint32; both boxes must accept each other; None: all bits.
            threads: number of threads that share the worlds; the pairs do not depend on it.
            backend: "warp", "taichi", or "numpy" for the oracle, which tests every pair.

        Raises:
            ValueError: an argument is invalid; the error names argument, index and limit.
        """
        self.backend = check_backend(backend)
        self._kept = (lower, upper, shape_body, body_type, category, mask)  # whose memory the kernels read
        self.lower = check_layout("lower", lower, (None, 2))
        self.dtype, n = self.lower.dtype, len(self.lower)
        self.upper = check_layout("upper", upper, (n, 2), self.dtype)
        self.start = check_start("start", start, n, "boxes")
        self.margin = check_not_negative("margin", margin)
        self.threads = check_count("threads", threads)
        self.shape_body = np.arange(n, dtype=np.int32) if shape_body is None else _filter(shape_body, "shape_body", n)
        bodies = int(self.shape_body.max(initial=-1)) + 1
        if body_type is None:
            refuse("shape_body", self.shape_body, self.shape_body == MAX_INDEX, f"< {MAX_INDEX}")
            check_memory(f"a type for each of the {bodies} bodies that shape_body names", 4.0 * bodies)
            self.body_type = np.full(bodies, BodyType.DYNAMIC, np.int32)
        else:
            self.body_type = _filter(body_type, "body_type", None)
        check_index("shape_body", self.shape_body, len(self.body_type))
        check_index("body_type", self.body_type, len(BodyType))
        everything = np.full(n, 0xFFFFFFFF, np.uint32)
        self.category = everything if category is None else _filter(category, "category", n, np.uint32)
        self.mask = everything if mask is None else _filter(mask, "mask", n, np.uint32)
        counts = np.diff(self.start)
        self.fixed = max_pairs is not None
        slots = check_slots("max_pairs", max_pairs, len(counts)) if self.fixed else np.ceil(PAIRS_PER_BOX * counts)
        self._candidates = CandidatePairs(counts, slots, self.dtype, "cpu", backend)
        self._flags = np.zeros(len(counts), np.int32)
        self._recordings = Recordings()
        self._filters = np.zeros(len(counts), np.int64)
        self.check_boxes()
        self._lock = threading.Lock()
        self._bind()

    def _bind(self) -> None:
        """Bind the launches to the present arrays."""
        pairs, dtype = self._candidates.pairs, self.dtype.name
        groups = kernel_file(self.backend, "groups")
        start = self.start.astype(np.int32)
        filters = {"shape_body": self.shape_body, "body_type": self.body_type}
        filters |= {"shape_category": self.category, "shape_mask": self.mask}
        boxes = {"lower": self.lower, "upper": self.upper, "margin": self.margin, "filters": self._filters}
        values = {
            "model": groups.group("model", dtype, MODEL, {"shape_start": start, **filters}),
            "state": groups.group("state", dtype, STATE, {"flags": self._flags}),
            "boxes": groups.group("boxes", dtype, BOXES, boxes),
            "pairs": groups.array_group(pairs, "pairs"),
            "threads": self.threads,
        }
        self.shape_a, self.shape_b = pairs.shape_a, pairs.shape_b
        self.count, self.pair_start, self.rebuilds = pairs.count, pairs.start, pairs.rebuilds
        self.flags = values["state"].flags
        kernel = make_kernels(self.backend, "collide.broadphase", dtype, factory="box_kernels")["update_box_pairs"]
        self._shards = [
            bind(kernel, n, {**values, "launch": groups.group("launch", dtype, LAUNCH, {"world_offset": w})}, "cpu")
            for w, n in shard_worlds(len(start) - 1, host_threads(self.backend, self.threads))
        ]

    @property
    def lengths(self) -> Mapping[str, int]:
        """Return the numbers of its elements, by noun."""
        return {"box": len(self.lower), "world": len(self.start) - 1}

    @property
    def layout_version(self) -> int:
        """Number that changes whenever arrays are reallocated."""
        return self._candidates.pairs.version

    @property
    def pairs(self) -> ArrayGroup:
        """The pairs as an array group for other stages (``model.fields.PAIRS``)."""
        return self._candidates.pairs

    def __call__(self) -> Any:
        """Find the pairs of the present boxes and return ``count``.

        Raises:
            OverflowError: naming the world, for more pairs than ``max_pairs``.
            ValueError: naming the box, for one that is not finite or whose lower corner is not the lower one.
        """
        run_shards(self._shards, self.threads)
        if recording():
            self._recordings.note()
        elif self._flags.any():
            with self._lock:
                while self._flags.any():
                    self._explain(room=self.fixed)
                    self._candidates.room.grow(self._flags, self._candidates.needed, error=False)
                    left = to_numpy(self.count)
                    self._candidates.relayout()
                    self._flags = self._recordings.renew(self._flags, self._shards)
                    self._bind()
                    left.fill(STALE)
                    run_shards(self._shards, self.threads)
        return self.count

    def check_boxes(self) -> None:
        """Raise a ValueError that names the first box that is not finite or whose lower corner exceeds the upper."""
        for name, corner in (("lower", self.lower), ("upper", self.upper)):
            bad = np.argwhere(~np.isfinite(corner))
            if len(bad):
                i, k = (int(index) for index in bad[0])
                raise ValueError(f"{name}[{i}, {k}] is {corner[i, k]}; it must be finite")
        bad = np.argwhere(self.lower > self.upper)
        if len(bad):
            i, k = (int(index) for index in bad[0])
            raise ValueError(f"lower[{i}, {k}] is {self.lower[i, k]}; it must not exceed upper, {self.upper[i, k]}")

    def check(self, room: bool = True) -> None:
        """Raise an error for a failure in the last call or replay, as a replay itself cannot raise.

        Args:
            room: whether to raise an error for pairs that did not fit.

        Raises:
            OverflowError, ValueError: see ``__call__``.
            RuntimeError: the replayed graph was recorded before ``layout_version`` changed.
        """
        self._recordings.check(self.layout_version)
        self._explain(room)

    def _explain(self, room: bool) -> None:
        """Raise an error for the flags of the last call."""
        if (self._flags & Flag.INVALID).any():
            self.check_boxes()
            check_index("shape_body", self.shape_body, len(self.body_type))
        full = np.flatnonzero(self._flags & Flag.PAIR_OVERFLOW)
        if room and len(full):
            w = int(full[0])
            reserved = int(self._candidates.room.slots[w])
            raise OverflowError(f"world {w} has {int(self._candidates.needed[w])} pairs; max_pairs is {reserved}")

    def numpy(self) -> np.ndarray:
        """Return a copy of the pairs of all worlds, one world after the other, (m, 2) int32."""
        both = np.stack([to_numpy(self.shape_a), to_numpy(self.shape_b)], axis=1)
        first = to_numpy(self.pair_start)
        return np.concatenate([both[:0], *(both[a : a + n] for a, n in zip(first, to_numpy(self.count)))])


def _turned_bodies(model: Model) -> int:
    """Return the number of bodies with hulls, whose pairs keep data between steps; 0 if there is none."""
    recycles = model.device == "cpu" and model.backend == "warp"
    return model.body_count if recycles and (model.numpy("shape_type") == ShapeType.POLYGON).any() else 0


def _filter(array: Any, name: str, count: int | None, dtype: Any = np.int32) -> np.ndarray:
    """Return integers of boxes or bodies, used in place."""
    return check_layout(name, array, (count,), np.dtype(dtype))
