"""Room that each world has for what a step makes: reserved, and grown when a step needed more."""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels.model.arrays import to_numpy
from dc_kernels.model.enums import Flag
from dc_kernels.model.settings import MAX_INT

LONG = 200  # slots of a segment, from which it is copied by itself
GROWTH = 1.25  # of what a step needed, so that a growing pile reallocates rarely


class Room:
    """Slots of one kind that each world has reserved.

    Attributes:
        slots: how many, (W,) int64.
    """

    def __init__(self, what: str, flag: Flag, slots: np.ndarray) -> None:
        """Reserve.

        Args:
            what: the slots' name in messages.
            flag: set in ``state.flags`` of a world that needed more.
            slots: how many to reserve, (W,).

        Raises:
            OverflowError: for more than kernels count in all worlds.
        """
        if (total := float(np.sum(slots, dtype=np.float64))) > MAX_INT:
            raise OverflowError(f"{total:.4g} {what} are to be reserved in all worlds; there may be {MAX_INT}")
        self.what, self.flag = what, flag
        self.slots = np.asarray(slots, np.int64)

    @property
    def total(self) -> int:
        """Slots of all worlds."""
        return int(self.slots.sum())

    def starts(self) -> np.ndarray:
        """The first slot of each world, and the end, (W + 1,) int32."""
        return starts(self.slots)

    def grow(self, flags: np.ndarray, needed: np.ndarray, error: bool) -> None:
        """Reserve more for the worlds whose flags say that they ran out; never less than before.

        A flag that was set by hand, or by a graph that knows the room of before, stands beside a need that has room.

        Args:
            flags: of the worlds, (W,).
            needed: what each world's last step needed, (W,).
            error: raise instead.

        Raises:
            OverflowError: with ``error``, naming world, need and room.
        """
        full = np.flatnonzero(flags & int(self.flag))
        short = full[needed[full] > self.slots[full]]
        if len(short) and error:
            w = int(short[0])
            raise OverflowError(
                f"world {w} needs {int(needed[w])} {self.what}, {int(self.slots[w])} are reserved; "
                "the step was not taken"
            )
        self.slots[full] = np.maximum(self.slots[full], np.ceil(GROWTH * needed[full]).astype(np.int64))


def starts(slots: np.ndarray) -> np.ndarray:
    """Offsets of consecutive segments of the given sizes, (W + 1,) int32.

    Raises:
        ValueError: for more than an int32 can count.
    """
    total = np.concatenate([[0], np.cumsum(slots, dtype=np.int64)])
    if total[-1] >= 2**31:
        raise ValueError(f"all worlds together need {int(total[-1])} slots; the limit is {2**31 - 1}")
    return total.astype(np.int32)


def world_of(start: np.ndarray) -> np.ndarray:
    """The world of each element of an axis whose worlds begin at ``start`` (W + 1,)."""
    return np.repeat(np.arange(len(start) - 1), np.diff(start))


def used_slots(start: np.ndarray, count: np.ndarray) -> np.ndarray:
    """The slots in use, world after world, of worlds that begin at ``start`` (W + 1,) and use ``count`` (W,)."""
    before = np.cumsum(count) - count
    return np.arange(int(count.sum())) + np.repeat(start[:-1].astype(np.int64) - before, count)


def rows_of(start: np.ndarray, worlds: np.ndarray, count: np.ndarray | None = None) -> np.ndarray:
    """The elements of some worlds, one world after the other, of an axis whose worlds begin at ``start`` (W + 1,).

    Each world has those up to the next one, or as many as ``count`` says, (W,).
    """
    first = start[:-1][worlds].astype(np.int64)
    used = (start[1:] if count is None else start[:-1] + count)[worlds] - first
    return np.arange(int(used.sum())) + np.repeat(first - (np.cumsum(used) - used), used)


def fill_segments(array: np.ndarray, values: np.ndarray, start: np.ndarray, count: np.ndarray) -> None:
    """Copy values, packed world after world, to the first slots of each world's segment."""
    if len(values) > LONG * len(count):  # a copy of each segment is faster than a place for each value
        source = np.concatenate(([0], np.cumsum(count)))
        for w in np.flatnonzero(count):
            array[start[w] : start[w] + count[w]] = values[source[w] : source[w + 1]]
    else:
        array[used_slots(start, count)] = values


def move_segments(array: Any, target: Any, old: np.ndarray, new: np.ndarray, counts: np.ndarray) -> None:
    """Copy the used part of every world's segment to its place in a new layout."""
    source = to_numpy(array)
    room = to_numpy(target)
    for w in np.flatnonzero(counts):
        n = int(counts[w])
        room[new[w] : new[w] + n] = source[old[w] : old[w] + n]
    if not isinstance(target, np.ndarray) and room.ctypes.data != target.ptr:
        target.assign(room)
