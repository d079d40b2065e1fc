"""Checks of one array against the rule of its field, and where the elements of each world lie."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from dc_kernels.model.fields import PER_CONTACT, Field
from dc_kernels.model.rules import UNIT_TOLERANCE, Ascending, Code, Index, Number, Unit, refuse
from dc_kernels.model.validate.glance import Arrays, Glance

PART = 2**14  # elements that are checked together
_ELEMENTS = {"body": "bodies", "shape": "shapes", "joint": "joints", "contact": "contacts"}


class Layout:
    """Where the elements of each world lie on the axes of a scene, and of its contacts.

    Attributes:
        start: first element of each world and the number of elements, (W + 1,), by axis.
        glance: compiled looks at arrays of the scene.
    """

    def __init__(self, model: Arrays, contact_count: np.ndarray | None = None, backend: str = "numpy") -> None:
        """Take the offsets of a model, which must be right, and contacts packed world after world.

        Args:
            model: fields of ``model.fields.MODEL`` by name.
            contact_count: of each world; None: there are no contacts.
            backend: that may look at large arrays, if it has compiled code.
        """
        self.glance = Glance(backend, model["mass"].dtype)
        self.start = {axis: model[f"{axis}_start"] for axis in ("body", "shape", "joint")}
        if contact_count is not None:
            start = np.concatenate(([0], np.cumsum(contact_count, dtype=np.int64)))
            self.start |= dict.fromkeys(PER_CONTACT, start)
        self._world: dict[str, np.ndarray] = {}

    def world(self, axis: str) -> np.ndarray:
        """World of each element of an axis, made once."""
        if axis not in self._world:
            start = self.start[axis]
            self._world[axis] = np.repeat(np.arange(len(start) - 1), np.diff(start))
        return self._world[axis]

    def shapes_of_contacts(self, part: slice) -> tuple[np.ndarray, np.ndarray]:
        """First shape of the world of some contacts, and one past its last."""
        start = self.start["contact"]
        stop = min(part.stop, int(start[-1]))
        w0, w1 = np.searchsorted(start, (part.start, stop - 1), "right") - 1
        edges = np.clip(start[w0 : w1 + 2], part.start, stop)
        shapes, count = self.start["shape"][w0 : w1 + 2].astype(np.int64), np.diff(edges)
        return np.repeat(shapes[:-1], count), np.repeat(shapes[1:], count)


def check_field(label: str, field: Field, values: np.ndarray, layout: Layout, part: slice = slice(0, None)) -> None:
    """Hold an array to the rule of its field; one of offsets is held to its axis by ``check_start``.

    Args:
        label: what errors call the array.
        field: whose rule it is.
        values: the array.
        layout: for indices and what is sorted within a world.
        part: rows of the array to look at.

    Raises:
        BrokenRule: naming label, index, value and limit.
    """
    rule, first = field.rule, part.start
    values = values[part]
    if not values.size:
        return
    if isinstance(rule, Number | Code | Unit):
        check_rule(label, values, rule, first)
    elif isinstance(rule, Index):
        start, world = layout.start[rule.axis], layout.world(field.per)[part]
        bad = (values < start[world]) | (values >= start[world + 1])
        if bad.any():
            w = int(world[bad.argmax()])
            within = f"{_ELEMENTS[rule.axis]} {start[w]} .. {start[w + 1] - 1}"
            refuse(label, values, bad, f"a {rule.axis} of its world {w} ({within})", first)
    elif isinstance(rule, Ascending):
        if values.min() < 0:
            refuse(label, values, values < 0, ">= 0", first)
        falls = values[1:] <= values[:-1]
        start = layout.start[field.per]
        inner = start[np.searchsorted(start, first + 1) : np.searchsorted(start, first + len(values))]
        falls[inner - (first + 1)] = False  # the first element of a world may be smaller than the one before
        refuse(label, values[1:], falls, "larger than the one before it in its world", first + 1)


def check_rule(label: str, values: np.ndarray, rule: Number | Code | Unit, first: int = 0) -> None:
    """Hold values to a rule that looks at each alone.

    Args:
        label: what errors call the array.
        values: the array, or a part of it.
        rule: what they must satisfy.
        first: row of the array at which the part begins.

    Raises:
        BrokenRule: naming label, index, value and limit.
    """
    if not values.size:
        return
    if isinstance(rule, Number):
        if _within(values, rule):
            return
        bad = ~np.isfinite(values) | (values < rule.low) | (values > rule.high)
        if rule.open:
            bad |= values == rule.low
        if rule.zero:
            bad &= values != 0
        refuse(label, values, bad, rule.limits, first)
    elif isinstance(rule, Code):
        codes = sorted(int(value) for value in rule.values)
        if codes == list(range(len(codes))) and values.min() >= 0 and values.max() < len(codes):
            return
        names = ", ".join(f"{value.value} ({value.name})" for value in rule.values)
        refuse(label, values, ~np.isin(values, codes), f"one of {names}", first)
    else:
        square = values * values
        length = square[:, 0] + square[:, 1]
        if not (length.min() >= 1.0 - UNIT_TOLERANCE and length.max() <= 1.0 + UNIT_TOLERANCE):
            refuse(label, values, ~(np.abs(length - 1.0) <= UNIT_TOLERANCE), "a unit vector", first)


def _within(values: np.ndarray, rule: Number) -> bool:
    """Whether a glance shows that all values keep to a rule; it may miss that they do, but not that one does not."""
    low = values.min() if rule.low > -np.inf else 0.0  # NaN is neither the least nor the most of anything
    if not (low > rule.low if rule.open else low >= rule.low):
        return False
    if rule.high < np.inf:
        return bool(values.max() <= rule.high)
    if values.dtype.kind != "f":
        return True
    flat = values.reshape(-1)
    with np.errstate(over="ignore", invalid="ignore"):
        return bool(np.isfinite(np.dot(flat, flat)))  # a finite sum has finite terms


def check_start(label: str, values: np.ndarray, length: int, spare: bool = False) -> None:
    """Hold offsets to an axis of some length; ``spare``: elements may lie behind the last one that they lead to.

    Raises:
        BrokenRule: naming label, index, value and limit.
    """
    refuse(label, values, np.array(values[:1] != 0), "0")
    refuse(label, values[1:], values[1:] < values[:-1], "ascending, at least the one before it", 1)
    last = len(values) - 1
    end = values[last:]
    if spare:
        refuse(label, end, np.array(end > length), f"at most {length}, the length of its axis", last)
    else:
        refuse(label, end, np.array(end != length), f"{length}, the length of its axis", last)


def parts_of(length: int) -> Iterator[slice]:
    """Parts of an array; each begins with the last element of the one before, so that neighbours are compared."""
    for first in range(0, length, PART):
        yield slice(max(first - 1, 0), first + PART)


def sane(table: Mapping[str, Field], arrays: Arrays, layout: Layout, flags: np.ndarray | None) -> Arrays:
    """The arrays, with numbers of worlds that have flags replaced by what passes."""
    if flags is None or not flags.any():
        return arrays
    found = dict(arrays)
    for name, values in arrays.items():
        field = table[name]
        if values.dtype.kind == "f" and field.per in layout.start:
            found[name] = values.copy()
            found[name][flags[layout.world(field.per)] != 0] = (1.0, 0.0) if isinstance(field.rule, Unit) else 0.0
    return found
