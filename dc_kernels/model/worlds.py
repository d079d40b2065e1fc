"""Views of the arrays of a group, in the same memory: those that may not be written to, and those world by world."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from dc_kernels.model.fields import ROLLING, TRAITS, Field
from dc_kernels.model.rules import Start

WorldViews = np.ndarray | list[np.ndarray]
"""(W, n, ...) where each world has n elements; else an array (n, ...) of each world."""


_WITHIN = {"vertex": "shape", "joint row": "joint"}  # axes whose offsets are those of the elements of another


class Locked(np.ndarray):
    """A read-only view, whose errors say how its field is written; what is computed from it is a plain array."""

    way = ""
    """How, a sentence."""

    def __array_wrap__(self, array: np.ndarray, context: Any = None, return_scalar: bool = False) -> Any:
        """What has been computed."""
        return array[()] if return_scalar else array.view(np.ndarray)

    def __reduce_ex__(self, protocol: Any) -> Any:
        """Pickle the values."""
        return self.view(np.ndarray).__reduce_ex__(protocol)

    def __repr__(self) -> str:
        """The values, as any array shows them."""
        return repr(self.view(np.ndarray))

    def copy(self, order: Any = "C") -> np.ndarray:  # type: ignore[override]
        """Copy the values into a plain array."""
        return self.view(np.ndarray).copy(order)


def _guarded(name: str) -> Callable[..., Any]:
    """A method of an array that writes to it, where it may be written to."""
    method = getattr(np.ndarray, name)

    @functools.wraps(method)
    def call(self: Locked, *arguments: Any, **options: Any) -> Any:
        if not self.flags.writeable:  # an array that was picked out of one by indices is
            raise ValueError(f"the array is read-only: {self.way}")
        return method(self, *arguments, **options)

    return call


OPERATORS = ("add", "sub", "mul", "truediv", "floordiv", "mod", "pow", "and", "or", "xor", "lshift", "rshift", "matmul")
for _name in ("__setitem__", "fill", "put", "sort", "partition", *(f"__i{name}__" for name in OPERATORS)):
    setattr(Locked, _name, _guarded(_name))


@functools.cache
def _locked(way: str) -> type[Locked]:
    """The class of views with one way of writing, which their slices have too."""
    return type("Locked", (Locked,), {"way": way})


def locked(array: np.ndarray, way: str) -> np.ndarray:
    """An array that cannot be written to; ``way`` is how it can be changed, which its errors say."""
    view = array.view(_locked(way))
    view.flags.writeable = False
    return view


class Segments(NamedTuple):
    """Elements of each world on an axis."""

    start: np.ndarray
    """First of each world and their number, (W + 1,)."""
    each: int | None
    """How many each world has; None where they differ."""

    @classmethod
    def of(cls, start: np.ndarray) -> Segments:
        """Elements of worlds that begin at ``start``, (W + 1,)."""
        count = np.diff(start)
        return cls(start, int(count[0]) if (count == count[0]).all() else None)


class WorldSegments(dict[str, Segments]):
    """Elements of each world by axis; those of an axis are looked for when they are first asked for."""

    def __init__(self, array_of: Callable[[str], np.ndarray], row_start: np.ndarray) -> None:
        """Take the arrays of a model by name, and the first row of each of its joints."""
        super().__init__()
        self._start = {axis: array_of(f"{axis}_start") for axis in ("body", "shape", "joint", "vertex")}
        self._start["joint row"] = row_start

    def __missing__(self, axis: str) -> Segments:
        start = self._start[axis]
        if axis in _WITHIN:
            start = start[self._start[_WITHIN[axis]]]
        return self.setdefault(axis, Segments.of(start))


def by_world(
    label: str, field: Field, values: np.ndarray, segments: Mapping[str, Segments] | None, slots: Any
) -> WorldViews:
    """Views of an array, world by world.

    Args:
        label: what errors call the array.
        field: whose array it is.
        values: the array.
        segments: elements of each world by axis; None: not known yet.
        slots: first slot of each world (W + 1,) and slots in use (W,) of a field of contacts; else None.

    Raises:
        ValueError: for an array that is not divided among worlds, or before a simulation has it.
    """
    axis = field.axes[0]
    if axis == "world":
        return values
    if slots is not None and (axis == "contact" or (axis == ROLLING and len(values))):
        start, count = slots
        return [values[first : first + n] for first, n in zip(start.tolist(), count.tolist())]
    axis = axis.removesuffix("+1")  # of bodies, behind which lie padding ones
    if axis in TRAITS and len(values):
        axis = TRAITS[axis]
    if isinstance(field.rule, Start) or axis not in ("body", "shape", "vertex", "joint", "joint row"):
        raise ValueError(f"{label} is not divided among worlds")
    if segments is None:
        raise ValueError(f"{label} is of no simulation yet, which knows what belongs to which world")
    start, each = segments[axis]
    if each is not None:
        used = values[: start[-1]]
        return used.reshape((len(start) - 1, each, *used.shape[1:]))
    edges = start.tolist()
    return [values[first:last] for first, last in itertools.pairwise(edges)]
