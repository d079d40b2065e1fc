"""What a simulation has reserved, and how much memory that takes."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from dc_kernels.model.arrays import ArrayGroup
from dc_kernels.model.fields import PER_CONTACT
from dc_kernels.storage import Storage


def capacity(storage: Storage, peak: np.ndarray) -> dict[str, dict[str, int]]:
    """Pairs, contacts and blocks of rows: reserved in all worlds, used now, and the most one world used (``peak``)."""
    used, room = storage.used(), storage.reserved()
    return {
        name: {"reserved": int(room[name].sum()), "used": int(used[name].sum()), "peak_of_a_world": int(most)}
        for name, most in zip(used, peak)
    }


def memory(groups: Iterable[ArrayGroup]) -> dict[str, int]:
    """Bytes allocated: by what they grow with (bodies with their shapes and pairs, contacts with their rows)."""
    total = {"body_bytes": 0, "contact_bytes": 0, "joint_bytes": 0}
    owner = dict.fromkeys(PER_CONTACT, "contact_bytes")
    for group in groups:
        for axis, size in group.nbytes_by_axis().items():
            key = "contact_bytes" if axis.startswith("row") else owner.get(axis, "body_bytes")
            key = "joint_bytes" if axis.startswith("joint") else key
            total[key] += size
    return total
