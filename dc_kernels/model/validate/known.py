"""Scenes of which an equal one was made, or found right, before: they are compared instead of worked out again.

Worlds are often made again and again with bodies of the same kinds, of which only places and velocities differ.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable, Hashable, Iterable
from typing import Any, NamedTuple, TypeVar

import numpy as np

from dc_kernels.model.arrays import ArrayGroup, Model, State
from dc_kernels.model.dtypes import float_name
from dc_kernels.model.joints.groups import Joints

KEPT = 2**18  # most bytes of a group, or of a builder's tables, that are remembered
MOST = 2**22  # bytes of all that is remembered of one kind
Value = TypeVar("Value")
Key = tuple[Hashable, ...]
Content = tuple[bytes, ...]


class Facts(dict[Hashable, Any]):
    """What was worked out of the values of a model and its joints, by what it is; equal ones have it in common."""

    def recall(self, what: Hashable, find: Callable[[], Value]) -> Value:
        """What was found before, or is found now; nobody changes it."""
        if what not in self:
            self[what] = find()
        found: Value = self[what]
        return found


class Made(NamedTuple):
    """What tables of a builder were made into, but for the state."""

    sizes: dict[str, int]
    """Elements on the axes of model and state."""
    of_joints: dict[str, int]
    """Elements on the axes of joints."""
    model: Content
    joints: Content
    com: np.ndarray
    """Centres of mass, in the frames of the bodies, (n, 2) float64 [m]."""


class Memory(dict[Key, Value]):
    """What is remembered by keys that hold so much in all; all of it is forgotten before it is too much."""

    bytes = 0

    def keep(self, key: Key, value: Value, size: int) -> Value:
        """Remember a value, with its key of so many bytes."""
        if self.bytes + size > MOST:
            self.clear()
            self.bytes = 0
        self.bytes += size
        return self.setdefault(key, value)


_made: Memory[Made] = Memory()
_right: Memory[Facts] = Memory()
_states: weakref.WeakKeyDictionary[State, Content] = weakref.WeakKeyDictionary()


def content(group: ArrayGroup) -> Content | None:
    """The bytes of the arrays of a small group; None where one lies elsewhere than allocated."""
    return None if group.whole is None or group.whole.plan.bytes > KEPT else group.whole.content()


def key_of(model: Model, joints: Joints) -> Key | None:
    """What a small model and its joints hold, and how it lies in memory."""
    one, other = content(model), content(joints)
    if one is None or other is None:
        return None
    return model.plan(), joints.plan(), float_name(model.dtype), model.backend, one, other


def facts_of(key: Key) -> Facts | None:
    """What is known of a model that was found right; None of another one."""
    return _right.get(key)


def remember_right(key: Key | None) -> Facts:
    """Know a model, as ``key_of`` tells, to be right."""
    if key is None:
        return Facts()
    return _right.keep(key, Facts(), _size(key))


def remember_state(state: State) -> None:
    """Know that what a state holds now is right, as long as it is there."""
    held = content(state)
    if held is not None:
        _states[state] = held


def is_known(state: State) -> bool:
    """Whether a state holds what was right, for which it is asked once."""
    held = _states.pop(state, None)
    return held is not None and held == content(state)


def tables_key(settings: Iterable[Hashable], tables: Iterable[np.ndarray]) -> Key | None:
    """What a model is made of, in small tables and settings; None for large ones."""
    tables = tuple(tables)
    if sum(table.nbytes for table in tables) > KEPT:
        return None
    return (*settings, *(table.shape for table in tables), *(table.tobytes() for table in tables))


def made_of(key: Key | None) -> Made | None:
    """What equal tables were made into; None where none were."""
    return None if key is None else _made.get(key)


def remember_made(key: Key | None, model: Model, joints: Joints, com: np.ndarray) -> None:
    """Remember what tables were made into, and found to be right."""
    one, other = content(model), content(joints)
    if key is None or one is None or other is None:
        return
    _made.keep(
        key, Made(dict(model.sizes), dict(joints.sizes), one, other, com), _size((*key, one, other)) + com.nbytes
    )


def _size(parts: Iterable[Any]) -> int:
    """Bytes of what is remembered, of which numbers and names are few."""
    return sum(
        _size(part) if isinstance(part, tuple) else len(part) for part in parts if isinstance(part, tuple | bytes)
    )
