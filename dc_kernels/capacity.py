"""Room for pairs, contacts and solver rows: reserved a world, grown between steps, never silently too small."""

from __future__ import annotations

from typing import Any

import numpy as np

from .arrays import ArrayGroup, to_numpy
from .types import CACHE, LANES, PAIRS, ROWS

GROWTH = 1.25  # of what a step needed, so that a growing pile reallocates rarely
SPARE_BLOCKS = 10  # blocks beyond full ones: a colour's last block is partly empty, and piles have 6-10 colours


class Cache(ArrayGroup):
    """Contacts of the last finished step, by key (``types.CACHE``)."""

    table = CACHE


class Pairs(ArrayGroup):
    """Broadphase: cells, boxes and candidate pairs (``types.PAIRS``)."""

    table = PAIRS


class Rows(ArrayGroup):
    """Solver rows and colours (``types.ROWS``)."""

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


def move_segments(array: Any, target: Any, old: np.ndarray, new: np.ndarray, counts: np.ndarray) -> None:
    """Copy the used part of every world's segment to its place in a new layout."""
    source = to_numpy(array)
    room = to_numpy(target)
    for w in np.flatnonzero(counts):
        n = int(counts[w])
        room[new[w] : new[w] + n] = source[old[w] : old[w] + n]
    if not isinstance(target, np.ndarray) and room.ctypes.data != target.ptr:
        target.assign(room)
