"""Solvers of contacts that are kept from one problem to the next: to make one takes milliseconds."""

from __future__ import annotations

import contextlib
import threading
from collections import OrderedDict
from collections.abc import Hashable, Iterator, Mapping
from typing import Any

import numpy as np

from dc_kernels.runtime.interop import host_view
from dc_kernels.solve.contacts import ContactSolver

CONTACT = ("body_a", "body_b", "point", "normal", "gap", "arm_a", "arm_b", "friction", "restitution", "impulse")
"""Arguments of ``ContactSolver`` that have an element for each contact."""
APART = ("count", "color", "rows", "body_start", "contact_start", "joint_start", "row_start")
"""Arguments with which a solver is made anew: several worlds, or what only a solver that stays has a use for."""
CONSTANT = ("length_scale", "weight", "gravity")
"""Arguments that a solver reads when it is made: numbers are part of what it is for."""
KEPT = 8  # solvers, the ones used last
LARGEST = 20_000  # contacts or bodies of one that is kept: beyond, its making is nothing beside the matrix
LEAST = 64  # contacts that one has room for; else the next power of two


class KeptSolvers:
    """Solvers by what they are for: scalars, sizes, settings, room for contacts; each serves one call at a time."""

    def __init__(self) -> None:
        """Begin with none."""
        self._free: OrderedDict[Hashable, tuple[ContactSolver, dict[str, np.ndarray]]] = OrderedDict()
        self._lock = threading.Lock()

    @contextlib.contextmanager
    def solver(self, arguments: Mapping[str, Any]) -> Iterator[ContactSolver]:
        """A solver of these contacts, which is nobody else's within the block.

        One that is kept has memory of its own, into which the arrays are copied; what cannot be copied as it is gets a
        solver of its own, which refuses what is wrong with it.

        Args:
            arguments: of ``ContactSolver`` by name.

        Raises:
            TypeError, ValueError: see ``ContactSolver``.
        """
        arrays, others = _arrays_of(arguments)
        key = _key(arrays, others)
        if key is None:
            yield ContactSolver(**arguments)
            return
        with self._lock:
            solver, memory = self._free.pop(key, (None, {}))
        count = len(arrays["body_a"])
        if solver is None:
            memory = {name: _room(name, array, count) for name, array in arrays.items()}
            memory["count"] = np.zeros(1, np.int32)
            joints = {name.partition(".")[2]: array for name, array in memory.items() if name.startswith("joints.")}
            given = {name: array for name, array in memory.items() if "." not in name}
            solver = ContactSolver(**{**others, **given, **({"joints": joints} if joints else {})})
        for name, array in arrays.items():
            memory[name][: len(array)] = array
        memory["count"][0] = count
        yield solver  # one that finds a fault is not kept
        with self._lock:
            self._free[key] = solver, memory
            while len(self._free) > KEPT:
                self._free.popitem(last=False)


def _arrays_of(arguments: Mapping[str, Any]) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Arguments that are arrays, those of joints as "joints.NAME", and the others that are given."""
    arrays, others = {}, {}
    for name, value in arguments.items():
        parts = value.items() if name == "joints" and isinstance(value, Mapping) else [(None, value)]
        for part, one in parts:
            label = name if part is None else f"joints.{part}"
            view = host_view(label if part is None else str(part), one)
            if isinstance(view, np.ndarray) and view.ndim:
                arrays[label] = view
            elif view is not None or part is None:  # what may not be None is refused for it
                others[label] = view
    return arrays, others


def _key(arrays: Mapping[str, np.ndarray], others: Mapping[str, Any]) -> Hashable | None:
    """What a solver is for; None where none is to be kept for it."""
    apart = any(name in arrays or others.get(name) is not None for name in APART) or any(
        name in arrays for name in CONSTANT
    )
    if apart or any("." in name for name in others):
        return None
    count = len(arrays["body_a"]) if "body_a" in arrays else 0
    largest = max((len(array) for array in arrays.values()), default=0)
    if not 0 < count <= largest <= LARGEST:
        return None
    parts: list[Hashable] = []
    for name, array in sorted(arrays.items()):
        if not array.flags.c_contiguous or (name in CONTACT and len(array) != count):
            return None
        length = _slots(count) if name in CONTACT else len(array)
        parts.append((name, array.dtype.str, length, array.shape[1:]))
    try:
        whole = (*parts, *((name, type(value), value) for name, value in sorted(others.items())))
        hash(whole)
    except TypeError:
        return None
    return whole


def _slots(count: int) -> int:
    """Contacts that a solver has room for."""
    return max(LEAST, 1 << (count - 1).bit_length())


def _room(name: str, array: np.ndarray, count: int) -> np.ndarray:
    """Memory for an array, and for more contacts."""
    length = _slots(count) if name in CONTACT else len(array)
    return np.zeros((length, *array.shape[1:]), array.dtype)
