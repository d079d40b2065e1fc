"""Lists of pairs of shapes of a world: what the oracle's kernels of events share."""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels.model.enums import Flag

Pair = tuple[int, int]


def passes(w: int, state: Any, lists: Any) -> bool:
    """Whether nothing begins or ends in a world, as it has stopped or sleeps."""
    return bool(state.flags[w] and (state.flags[w] != Flag.ASLEEP or lists.part[w] == 0))


def read(lists: Any, prefix: str, w: int, start: int) -> list[Pair]:
    """The pairs of a list."""
    used = slice(start, start + getattr(lists, f"{prefix}count")[w])
    return list(zip(getattr(lists, f"{prefix}a")[used].tolist(), getattr(lists, f"{prefix}b")[used].tolist()))


def write(lists: Any, prefix: str, w: int, start: int, pairs: list[Pair]) -> None:
    """Let these be the pairs of a list."""
    getattr(lists, f"{prefix}count")[w] = len(pairs)
    used = slice(start, start + len(pairs))
    both = np.array(pairs, np.int32).reshape(-1, 2)
    getattr(lists, f"{prefix}a")[used], getattr(lists, f"{prefix}b")[used] = both.T


def compare(lists: Any, w: int, start: int) -> None:
    """List what has begun and ended, and take the present list for that of the step before at the end of a step."""
    now, before = read(lists, "", w, start), read(lists, "before_", w, start)
    write(lists, "begun_", w, start, sorted({*now} - {*before}))
    write(lists, "ended_", w, start, sorted({*before} - {*now}))
    lists.part[w] = (lists.part[w] + 1) % lists.parts[w]
    if lists.part[w] == 0:
        write(lists, "before_", w, start, now)
