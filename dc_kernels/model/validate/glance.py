"""Glances at large arrays, by compiled code: whether all is right, in one pass.

Small arrays are left to NumPy, which is done with all of them, in one piece, before code is loaded, let alone compiled.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from dc_kernels.model.enums import Element
from dc_kernels.model.fields import Field
from dc_kernels.model.rules import UNIT_TOLERANCE, Code, Number, Rule, Unit
from dc_kernels.runtime.backends import make_kernels, on_numpy

Arrays = Mapping[str, np.ndarray]
LEAST = 2**13
"""Numbers from which on an array is looked at; fewer take NumPy about a millisecond."""
_BODIES = (
    *("body_type", "mass", "inertia", "inv_mass", "inv_inertia"),
    *("body_start", "shape_start", "shape_body"),
)
_SHAPES = (
    *("shape_type", "shape_radius", "shape_center", "shape_extent"),
    *("vertex_start", "vertices", "vertex_normals"),
)
_SCENE = ("body_start", "shape_start", "shape_body", "body_type")
_CONTACTS = ("key", "body_a", "body_b", "color")

_Bounds = tuple[tuple[str, ...], np.ndarray, np.ndarray]  # names of arrays, least and largest of all their elements
_bounds: dict[tuple[Any, ...], tuple[Mapping[str, Field], list[_Bounds]]] = {}
KEPT = 64  # of them: for worlds that are made again and again


class Glance:
    """Looks at arrays of a model, or of its contacts; each tells what is right.

    It says nothing of what may be wrong; nor of large arrays where the calling thread records a graph, or the backend
    has no compiled code.
    """

    def __init__(self, backend: str, dtype: Any) -> None:
        """Look at nothing yet.

        Args:
            backend: whose arrays they are.
            dtype: scalar of the model.
        """
        self._backend, self._dtype = backend, np.dtype(dtype)

    def keeping(self, arrays: Arrays, table: Mapping[str, Field]) -> set[str]:
        """The names of arrays whose elements keep to the rules of their fields, where those look at each alone.

        Args:
            arrays: by name.
            table: their fields.
        """
        kept = self._together({name: values for name, values in arrays.items() if values.size < LEAST}, table)
        held = {name: np.ascontiguousarray(values) for name, values in arrays.items() if values.size >= LEAST}
        if not held or not self._looks(LEAST):
            return kept
        limits = {name: _limits(self._dtype, values.dtype, table[name].rule) for name, values in held.items()}
        names = [name for name, found in limits.items() if found]
        if not names:
            return kept
        kinds, lows, highs = zip(*(limits[name] for name in names))
        numbers = [held[name].size // (2 if kind == Element.UNITS else 1) for name, kind in zip(names, kinds)]
        wrong = self._launch(
            "fields",
            len(names),
            kind=np.array(kinds, np.int32),
            low=np.array(lows, np.float64),
            high=np.array(highs, np.float64),
            address=np.array([held[name].__array_interface__["data"][0] for name in names], np.uint64),
            count=np.array(numbers, np.int64),
        )
        return kept | {name for name, bad in zip(names, wrong) if not bad}

    def _together(self, arrays: Arrays, table: Mapping[str, Field]) -> set[str]:
        """The names of small arrays of which NumPy shows in one piece that their elements keep to their rules."""
        key = id(table), self._dtype, tuple((name, values.dtype, values.size) for name, values in arrays.items())
        _, bounds = _bounds.get(key, (table, None))
        if bounds is None:
            bounds = list(_bounds_of(arrays, table, self._dtype))
            if len(_bounds) >= KEPT:
                _bounds.clear()
            if sum(len(least) for _, least, _ in bounds) <= LEAST:
                _bounds[key] = table, bounds  # the table is kept, as its id is in the key
        kept: set[str] = set()
        for names, least, most in bounds:
            whole = np.concatenate([arrays[name].reshape(-1) for name in names])
            if ((whole >= least) & (whole <= most)).all():
                kept.update(names)
        return kept

    def bodies(self, model: Arrays) -> bool:
        """Whether masses fit types and inverses, and shapes bodies of their world; offsets and types must be right."""
        if not self._looks(len(model["body_type"])):
            return False
        return not self._launch("bodies", **{name: model[name] for name in _BODIES})[0]

    def shapes(self, model: Arrays) -> bool:
        """Whether shapes are what a builder makes of them; offsets and types must be right."""
        if not self._looks(len(model["shape_type"])):
            return False
        return not self._launch("shapes", **{name: model[name] for name in _SHAPES})[0]

    def contacts(self, contacts: Arrays, model: Arrays, start: np.ndarray) -> bool:
        """Whether keys rise in each world and name its shapes and the bodies given, and colours come once at a body.

        Args:
            contacts: "key", and maybe bodies and colours, which must be in range.
            model: of the contacts, which must be right.
            start: first contact of each world, and their number, int64.
        """
        if ("body_a" in contacts) != ("body_b" in contacts) or not self._looks(len(contacts["key"])):
            return False
        given = {name: contacts.get(name, np.empty(0, np.int32)) for name in _CONTACTS}
        taken = np.empty(int(np.diff(model["body_start"]).max()), np.uint64)
        scene = {name: model[name] for name in _SCENE}
        return not self._launch("contacts", contact_start=start, taken=taken, **given, **scene)[0]

    def _looks(self, size: int) -> bool:
        """Whether so many elements are looked at."""
        if size < LEAST or on_numpy(self._backend):
            return False
        from dc_kernels.runtime.capture import recording

        return not recording()

    def _launch(self, name: str, fields: int = 1, /, **values: np.ndarray) -> np.ndarray:
        """Launch a kernel; what it finds wrong."""
        arrays = {key: np.ascontiguousarray(array) for key, array in values.items()}
        wrong = np.ones(fields, np.int32)
        _calls(self._backend, self._dtype.name, name)({**arrays, "wrong": wrong}, 1, 1)
        return wrong


def _bounds_of(arrays: Arrays, table: Mapping[str, Field], real: np.dtype) -> Iterator[_Bounds]:
    """The limits of the elements of arrays whose rules look at each alone, for each dtype."""
    found: dict[np.dtype, list[tuple[str, int, float, float]]] = {}
    for name, values in arrays.items():
        limits = _limits(real, values.dtype, table[name].rule)
        if limits is not None and limits[0] != Element.UNITS:
            found.setdefault(values.dtype, []).append((name, values.size, *limits[1:]))
    for dtype, group in found.items():
        names, sizes, low, high = zip(*group)
        yield names, np.array(low, dtype).repeat(sizes), np.array(high, dtype).repeat(sizes)


@functools.cache
def _calls(backend: str, dtype: str, name: str) -> Any:
    from dc_kernels.runtime.launches import Calls

    return Calls(make_kernels(backend, "model.validate.glance", dtype)[f"look_at_{name}"])


@functools.cache
def _limits(real: np.dtype, dtype: np.dtype, rule: Rule | None) -> tuple[int, float, float] | None:
    """What the elements of an array are, and the least and largest number that keeps to a rule; None: unknown.

    Args:
        real: scalar of the model.
        dtype: of the array.
        rule: of its field.
    """
    if isinstance(rule, Unit) and dtype == real:
        return (int(Element.UNITS), *_range(dtype, Number(1.0 - UNIT_TOLERANCE, 1.0 + UNIT_TOLERANCE)))
    if isinstance(rule, Code) and sorted(rule.values) == list(range(len(rule.values))):
        rule = Number(0, len(rule.values) - 1)
    kind = {real: Element.NUMBERS, np.dtype(np.int32): Element.INTEGERS}.get(dtype)
    if kind is None or not isinstance(rule, Number) or rule.zero:
        return None
    return (int(kind), *_range(dtype, rule))


def _range(dtype: np.dtype, rule: Number) -> tuple[float, float]:
    """The least and the largest number of a dtype that keep to a rule."""
    if dtype.kind == "i":
        info = np.iinfo(dtype)
        low = info.min if rule.low == -math.inf else max(math.ceil(rule.low), info.min)
        high = info.max if rule.high == math.inf else min(math.floor(rule.high), info.max)
        return low + (rule.open and low == rule.low), high
    most = np.finfo(dtype).max
    low, high = max(dtype.type(rule.low), -most), min(dtype.type(rule.high), most)
    if low < rule.low or (rule.open and low == rule.low):
        low = np.nextafter(low, most)
    if high > rule.high:
        high = np.nextafter(high, -most)
    return float(low), float(high)
