"""Data sets for torch: states of a data set in batches, shuffled across worlds.

    for batch in loader("out/data", batch_size=64, split="train", shuffle=True, seed=0):
        image, label = splatter(batch)  # of ``data.splatter``

A state is one world at one step. Worlds are read whole and kept while their pool is in use; states are shuffled within
a pool, pools are drawn across all worlds. Files are opened at the first access to a state, so workers may be forked
or spawned. Images are made by the kernels of a simulation's images, from the same numbers.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal

import numpy as np

from dc_kernels.model.enums import BodyType
from dc_kernels.model.room import world_of
from dc_kernels.model.settings import WrongType, shown
from dc_kernels.runtime.imports import require
from pipeline.data.batch import BODY, CONTACT, SHAPE, Batch, World
from pipeline.data.folders import Folders, Paths, row_counts
from pipeline.data.layout import MOTION, offsets
from pipeline.seeds import HELD_OUT_SEED

torch = require("torch", "pipeline")
Dataset: Any = torch.utils.data.Dataset
DataLoader: Any = torch.utils.data.DataLoader
Sampler: Any = torch.utils.data.Sampler

Split = Literal["train", "validation"]
CACHE_BYTES = 2**28
"""Size of the worlds that a process keeps in memory, about [B]."""
STATE_OPTIONS = ("validation", "split_seed", "stride", "min_contacts", "cache_bytes")
"""Options of ``loader`` that are those of ``States``."""


class States(Dataset):
    """The states of a data set, as a torch dataset.

    ``states[i]`` is a batch of one, ``states.batch([...])`` of several. A state is included if its world is in the
    split and not flagged, its step is a multiple of ``stride``, and it has at least ``min_contacts`` contacts.
    """

    def __init__(
        self,
        path: Paths,
        split: Split | None = None,
        validation: float = 0.1,
        split_seed: int = 0,
        stride: int = 1,
        min_contacts: int = 1,
        cache_bytes: int = CACHE_BYTES,
    ) -> None:
        """Read the index.

        Args:
            path: folder of the data set, or its index; or several that differ only in worlds, seed and shard_worlds.
            split: "train" or "validation": whole worlds, drawn by ``split_seed``; None: all.
            validation: share of the worlds for validation, at least one world.
            split_seed: seed of the draw.
            stride: number of steps from one state to the next.
            min_contacts: smallest number of contacts of a state.
            cache_bytes: approximate size of the worlds that each process keeps; at least two are kept.

        Raises:
            ValueError: an argument is out of its range, the index foreign or damaged, the data set not finished or
                without a shard, folders do not belong together or share a world, or held-out seeds, which are
                for tests only, are requested with a split.
        """
        if split not in (None, "train", "validation"):
            raise ValueError(f"split is {split!r}; it must be None, 'train' or 'validation'")
        if not 0.0 <= validation < 1.0:
            raise ValueError(f"validation is {validation!r}; it must lie in [0, 1)")
        for name, value, low in (
            ("stride", stride, 1),
            ("min_contacts", min_contacts, 0),
            ("split_seed", split_seed, 0),
        ):
            if value < low:
                raise ValueError(f"{name} is {value}; it must be >= {low}")
        self.folders = Folders(path)
        self.folder, self.config = self.folders.folder, self.folders.config
        found, rows = self.folders.gather(
            "world/seed", "world/step_start", "step/step", "step/flags", "step/contact_start"
        )
        self.seeds, self.step_start = found["world/seed"], found["world/step_start"]
        self.contact_count = np.diff(found["step/contact_start"])
        step, flags = found["step/step"], found["step/flags"]
        seeds, times = np.unique(self.seeds, return_counts=True)
        if (times > 1).any():
            raise ValueError(
                f"seed {seeds[np.argmax(times > 1)]} is there twice: one world must not be two of a data set"
            )
        if split is not None and (self.seeds >= HELD_OUT_SEED).any():
            raise ValueError(
                f"{self.folder} has worlds of seeds from {HELD_OUT_SEED} on: for tests, never for training"
            )
        self.worlds = _split(len(self.seeds), split, validation, split_seed)
        chosen = np.isin(np.arange(len(self.seeds)), self.worlds)[self._world_of(np.arange(len(step)))]
        self.rows = np.flatnonzero(chosen & (step % stride == 0) & (flags == 0) & (self.contact_count >= min_contacts))
        world_bytes = (rows["motion"] * 24 + rows["contact"] * 76) / max(len(self.seeds), 1)
        self.pool = max(2, int(cache_bytes / max(world_bytes, 1.0)))
        self._forget()

    def _forget(self) -> None:
        """Begin with nothing open and nothing read."""
        self._known: OrderedDict[int, World] = OrderedDict()

    def __getstate__(self) -> dict[str, Any]:
        """Return what workers are given: nothing that is open or read."""
        return {**self.__dict__, "_known": OrderedDict()}

    def __len__(self) -> int:
        """Count the states."""
        return len(self.rows)

    def __getitem__(self, index: int) -> Batch:
        """Return one state, as a batch."""
        return self.batch([index])

    def __getitems__(self, indices: Sequence[int]) -> Batch:
        """Return a batch, for torch's loaders."""
        return self.batch(indices)

    def world_of(self, indices: Any) -> np.ndarray:
        """Return the world of each state, counted through the data set."""
        return self._world_of(self.rows[self._checked(indices)])

    def _checked(self, indices: Any) -> np.ndarray:
        """Return indices of states, (n,) int64; negative ones count from the end.

        Raises:
            TypeError: for what are no integers.
            IndexError: naming the first that is out of range.
        """
        found = np.asarray(indices)
        if found.size and found.dtype.kind not in "iu":
            raise WrongType(f"index is {shown(indices)}; it must be an integer, or several")
        bad = (found < -len(self.rows)) | (found >= len(self.rows))
        if bad.any():
            raise IndexError(f"index is {found[bad].flat[0]}; it must lie in [{-len(self.rows)}, {len(self.rows) - 1}]")
        return found.astype(np.int64)

    def _world_of(self, rows: np.ndarray) -> np.ndarray:
        """Return the world of each row of the steps."""
        return np.searchsorted(self.step_start, rows, "right") - 1

    def _world(self, number: int) -> World:
        """Return a world, which is read unless it is still kept."""
        if number in self._known:
            self._known.move_to_end(number)
            return self._known[number]
        shard = int(np.searchsorted(self.folders.first_world, number, "right") - 1)
        with self.folders.shard(shard) as file:
            world = World(file, number - int(self.folders.first_world[shard]))
        if world.seed != self.seeds[number]:
            raise ValueError(f"{self.folders.parts[shard].path} is not what it was: another world is in its place")
        self._known[number] = world
        while len(self._known) > self.pool:
            self._known.popitem(last=False)
        return world

    def batch(self, indices: Sequence[int]) -> Batch:
        """Return a batch of states, in the given order.

        Raises:
            TypeError: for what is no index, such as 1.5 or True.
            IndexError: for an index out of range.
            ValueError: for a shard that is damaged.
        """
        chosen = self._checked(indices)
        rows, numbers = self.rows[chosen], self.world_of(chosen)
        worlds = [self._world(int(number)) for number in numbers]
        steps = (rows - self.step_start[numbers]).tolist()
        motion = [slice(*w.motion_start[s : s + 2]) for w, s in zip(worlds, steps)]
        contact = [slice(*w.contact_start[s : s + 2]) for w, s in zip(worlds, steps)]

        def whole(name: str) -> np.ndarray:
            return np.concatenate([w.arrays[name] for w in worlds])

        def cut(name: str, parts: Sequence[slice]) -> np.ndarray:
            return np.concatenate([w.arrays[name][part] for w, part in zip(worlds, parts)])

        bodies = np.array([part.stop - part.start for part in motion])
        contacts = np.array([part.stop - part.start for part in contact])
        shapes = np.array([len(w.vertex_count) for w in worlds])
        body_start = offsets(bodies)
        arrays: dict[str, np.ndarray] = {
            "body_start": body_start,
            "contact_start": offsets(contacts),
            "shape_start": offsets(shapes),
            "vertex_start": offsets(np.concatenate([w.vertex_count for w in worlds])),
            "body_a": cut("body_a", contact) + np.repeat(body_start[:-1], contacts),
            "body_b": cut("body_b", contact) + np.repeat(body_start[:-1], contacts),
            "shape_body": whole("shape_body") + np.repeat(body_start[:-1], shapes),
            "dt": np.array([w.dt for w in worlds], np.float32),
            "gravity": np.stack([w.gravity for w in worlds]),
            "seed": self.seeds[numbers],
            "step": np.array(steps, np.int64),
            **{name: cut(name, motion) for name in MOTION},
            **{name: cut(name, contact) for name in CONTACT},
            **{name: whole(name) for name in (*BODY, *SHAPE, "vertices")},
        }
        return Batch(**{name: torch.from_numpy(values) for name, values in arrays.items()})


def _split(worlds: int, split: Split | None, validation: float, seed: int) -> np.ndarray:
    """Draw the worlds of a split, sorted."""
    if split is None:
        return np.arange(worlds)
    order = np.random.Generator(np.random.PCG64(seed)).permutation(worlds)
    held = min(max(round(validation * worlds), 1), worlds) if validation > 0.0 else 0
    return np.sort(order[:held] if split == "validation" else order[held:])


class BatchOrder(Sampler):
    """Indices of each batch; the order depends only on seed and epoch.

    Each of several ranks takes every ``world_size``-th batch, and all take equally many: the first batches are repeated
    at the end if their number is not divisible.
    """

    def __init__(
        self,
        states: States,
        batch_size: int,
        shuffle: bool = True,
        seed: int = 0,
        drop_last: bool = False,
        rank: int = 0,
        world_size: int = 1,
    ) -> None:
        """Choose the batches of a rank; the arguments are those of ``loader``."""
        for name, value, low in (("batch_size", batch_size, 1), ("seed", seed, 0), ("world_size", world_size, 1)):
            if value < low:
                raise ValueError(f"{name} is {value}; it must be >= {low}")
        if not 0 <= rank < world_size:
            raise ValueError(f"rank is {rank}; it must lie in [0, {world_size})")
        self.states, self.batch_size, self.shuffle, self.seed = states, batch_size, shuffle, seed
        self.drop_last, self.rank, self.world_size = drop_last, rank, world_size
        self.epoch = 0
        self._world = states.world_of(np.arange(len(states)))

    def set_epoch(self, epoch: int) -> None:
        """Choose the order of the next pass."""
        self.epoch = epoch

    def order(self) -> np.ndarray:
        """Return the indices of all states in the order of this epoch."""
        count = len(self.states)
        if not self.shuffle:
            return np.arange(count)
        stream = np.random.Generator(np.random.PCG64([self.seed, self.epoch]))
        worlds = self.states.worlds
        place = np.empty(len(self.states.seeds), np.int64)
        place[stream.permutation(worlds)] = np.arange(len(worlds))
        pool = place[self._world] // self.states.pool
        return np.lexsort((stream.random(count), pool))

    def __len__(self) -> int:
        """Count the batches of this rank."""
        count = len(self.states)
        batches = count // self.batch_size if self.drop_last else -(-count // self.batch_size)
        return batches // self.world_size if self.drop_last else -(-batches // self.world_size)

    def __iter__(self) -> Iterator[list[int]]:
        """Go through the batches of this rank, each a list of indices."""
        order = self.order()
        batches = [order[i : i + self.batch_size] for i in range(0, len(order), self.batch_size)]
        for i in range(len(self)):
            yield batches[(i * self.world_size + self.rank) % len(batches)].tolist()


def collate(batch: Batch) -> Batch:
    """Return a batch unchanged, as the ``collate_fn`` of a ``DataLoader`` over ``States``."""
    return batch


class Loader(DataLoader):
    """A ``DataLoader`` of batches, made by ``loader``."""

    def set_epoch(self, epoch: int) -> None:
        """Choose the order of the next pass."""
        self.batch_sampler.set_epoch(epoch)


def loader(
    path: Paths,
    *,
    batch_size: int,
    split: Split | None = "train",
    shuffle: bool = True,
    seed: int = 0,
    num_workers: int = 0,
    pin_memory: bool = False,
    drop_last: bool = False,
    rank: int = 0,
    world_size: int = 1,
    **options: Any,
) -> Loader:
    """Make a ``DataLoader`` of batches; its ``set_epoch(n)`` chooses the order of each pass.

    Args:
        path: folder of the data set, or its index; or several.
        batch_size: states in a batch.
        split: as for ``States``.
        shuffle: whether to shuffle across the worlds of a pool, and pools across all worlds.
        seed: seed of the order.
        num_workers: number of processes that read ahead; 0: this process reads. The batches do not depend on it.
        pin_memory: whether batches are in page-locked memory, for ``batch.to("cuda", non_blocking=True)``.
        drop_last: whether to drop the last batch if it is smaller, and batches that the ranks cannot share evenly.
        rank: rank of this process in a joint training.
        world_size: number of these processes.
        **options: validation, split_seed, stride, min_contacts, cache_bytes of ``States``; all others are torch's,
            such as prefetch_factor, timeout, worker_init_fn. Workers are spawned and kept unless
            multiprocessing_context or persistent_workers say otherwise.

    Raises:
        ValueError: see ``States``; no state is left; a sampler or collate_fn, which the loader sets, is given.
        TypeError: an option is unknown to torch.
    """
    for name in ("sampler", "batch_sampler", "collate_fn"):
        if name in options:
            raise ValueError(f"{name} is the loader's own; DataLoader(States(...), collate_fn=collate) takes any")
    chosen = {name: options.pop(name) for name in STATE_OPTIONS if name in options}
    states = States(path, split, **chosen)
    if not len(states):
        raise ValueError(f"{path} has no state with split {split!r} and {chosen}")
    order = BatchOrder(states, batch_size, shuffle, seed, drop_last, rank, world_size)
    more: Mapping[str, Any] = {"persistent_workers": True, "multiprocessing_context": "spawn"} if num_workers else {}
    options = {**more, **options, "num_workers": num_workers, "pin_memory": pin_memory}
    return Loader(states, batch_sampler=order, collate_fn=collate, **options)


def describe(path: Paths) -> dict[str, Any]:
    """Describe a data set, without its states.

    Args:
        path: folder of the data set, or its index; or several.

    Returns:
        ``config``, of the first folder; ``seeds``, the first and one past the last; ``worlds``, ``states``; ``box``,
        the bounds of all static shapes: low x, low y, high x, high y [m]; ``slop``, overlap that the solver did not
        correct, mean of the worlds [m].

    Raises:
        ValueError, OSError: see ``States``.
    """
    folders = Folders(path)
    found, rows = folders.gather("world/seed", "world/length_scale")
    boxes = [box for file, part in folders.files() if (box := _static_box(file, part.worlds)) is not None]
    low, high = np.zeros(2), np.zeros(2)
    if boxes:
        low, high = np.min([box[0] for box in boxes], axis=0), np.max([box[1] for box in boxes], axis=0)
    seeds = found["world/seed"]
    return {
        "config": folders.config,
        "seeds": (int(seeds.min()), int(seeds.max()) + 1),
        "worlds": len(seeds),
        "states": rows["step"],
        "box": (float(low[0]), float(low[1]), float(high[0]), float(high[1])),
        "slop": folders.config["solver"]["slop"] * float(found["world/length_scale"].mean()),
    }


def _static_box(file: Any, worlds: int) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the lower and upper corner of what holds the static shapes of a shard's first worlds; None without any."""
    rows = row_counts(file, worlds)
    step_start, body_start, shape_start = (
        file[f"world/{name}"][: worlds + 1] for name in ("step_start", "body_start", "shape_start")
    )
    # of each shape, then of each vertex, the body's row in motion at its world's first step
    first = file["step/motion_start"][...][step_start[:-1]] - body_start[:-1]
    world = world_of(shape_start)
    body = file["shape/shape_body"][: rows["shape"]] + body_start[world]
    static = file["body/body_type"][...][body] == BodyType.STATIC
    count = np.diff(file["shape/vertex_start"][: rows["shape"] + 1])
    place_of = np.repeat((body + first[world])[static], count[static])
    if not len(place_of):
        return None
    vertices = file["vertex/vertices"][: rows["vertex"]][np.repeat(static, count)]
    kept, place = np.unique(place_of, return_inverse=True)
    angle, position = file["motion/angle"][kept][place], file["motion/position"][kept][place]
    radius = np.repeat(file["shape/shape_radius"][: rows["shape"]][static], count[static])[:, None]
    c, s = np.cos(angle), np.sin(angle)
    x, y = vertices.T
    corners = position + np.stack([c * x - s * y, s * x + c * y], axis=1)
    return (corners - radius).min(axis=0), (corners + radius).max(axis=0)
