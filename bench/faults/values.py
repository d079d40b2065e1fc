"""Values that a setting or an argument must refuse, from its annotation."""

from __future__ import annotations

import math
import types
import typing
from collections.abc import Callable, Iterator
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any, Literal, Union

import numpy as np

from dc_kernels.model.settings import Settings, field_types, number_limits, plain_type

OBJECTS: tuple[Any, ...] = (
    b"ab",
    bytearray(b"ab"),
    {1, 2},
    {"a": 1},
    1j,
    object(),
    ...,
    int,
    np.array([[1.0, 2.0], [3.0, 4.0]], complex),
    np.array(["a", "b"]),
    np.array([None, 1]),
    np.datetime64("2000-01-01"),
    [[1.0], [1.0, 2.0]],
)
"""Nothing that any argument takes."""
HUGE: tuple[Any, ...] = (2**64, 10**400, -(10**5000))


class Array:
    """Stands for an annotation of arrays of numbers whose last axis has a length, which must be finite."""

    def __init__(
        self,
        *shape: int,
        whole: bool = False,
        optional: bool = False,
        strict: bool = True,
        finite: bool = True,
        fixed: bool = True,
        ranged: bool = True,
    ) -> None:
        """Remember the shape and what the array may be.

        Args:
            shape: that it must have.
            whole: integers.
            optional: None will do.
            strict: another dtype than float32 or float64 is refused.
            finite: NaN and inf are refused.
            fixed: another shape is refused.
            ranged: integers far below 0 or beyond any index are refused.
        """
        self.shape, self.whole, self.optional, self.strict = shape, whole, optional, strict
        self.finite, self.fixed, self.ranged = finite, fixed, ranged

    def bad(self) -> list[Any]:
        """Values that are no such array."""
        good = np.ones(self.shape, np.int64 if self.whole else np.float32)
        values: list[Any] = ["12", "", True, 10**400, lambda: 1]
        if self.fixed:
            values += [np.zeros((3, 3, 3, 3, 3)), np.ones((*self.shape, 5)), np.ones(max(self.shape, default=1) + 5)]
            values += [math.nan, 2.5]
        values += [] if self.optional else [None]
        if not self.whole and self.finite:
            for number in (math.nan, math.inf, -math.inf):
                values.append(good.copy())
                values[-1].flat[0] = number
        elif self.whole:
            values += [good + 0.5, good - 100, good.astype(np.float64)]
            values += [(good - 100).astype(np.int32), np.full(self.shape, 2**31 - 1, np.int32)] if self.ranged else []
        if self.strict and not self.whole:
            values += [good.astype(np.int64), good.astype(np.float16), good.tolist()]
        return values


class Numbers(Array):
    """A number, or as many as there are discs: a single number is right."""

    def __init__(self) -> None:
        super().__init__(2, strict=False)

    def bad(self) -> list[Any]:
        """Values that are neither."""
        return [value for value in super().bad() if not isinstance(value, float) or value != value]


class Given:
    """Stands for an annotation: what is bad beside ``OBJECTS`` is listed."""

    def __init__(self, *values: Any) -> None:
        self.values = values


TimeStep = Given(
    "12", "", None, True, math.nan, math.inf, -math.inf, 0.0, -1.0, 1e39, 10**400, np.ones(3), [0.01, 0.01]
)
"""A time step of all worlds, or of each of one."""
Vector = Array(2, strict=False)
"""Two numbers."""


def bad_values(hint: Any) -> list[Any]:
    """Values of another type or range than an annotation allows."""
    if isinstance(hint, Array):
        return [*OBJECTS, *hint.bad()]
    if isinstance(hint, Given):
        return [*OBJECTS, *hint.values]
    return [*wrong_types(hint), *out_of_range(hint)]


def subclasses(base: type = Settings) -> Iterator[type]:
    """Every dataclass of settings that has been imported, and belongs to the project."""
    one: type
    for one in base.__subclasses__():
        if one.__module__.startswith(("dc_kernels", "pipeline")):
            yield one
        yield from subclasses(one)


def required(settings: type) -> list[str]:
    """Names of the fields without a default."""
    return [f.name for f in fields(settings) if f.init and f.default is MISSING and f.default_factory is MISSING]


def wrong_types(hint: Any) -> list[Any]:
    """Values of another type than an annotation asks for."""
    members, optional = members_of(hint)
    kinds = {plain_type(member) for member in members}
    values = [value for value in OBJECTS if not (Callable in {typing.get_origin(k) for k in kinds} and callable(value))]
    values += [] if optional else [None]
    if int in kinds and float not in kinds:
        values += [2.5, 2.0, np.float32(2.0), math.nan, math.inf]
    if kinds & {int, float}:
        values += ["12", "", True, np.True_, np.array(1), np.array([1])]
    elif bool in kinds:
        values += [0, 1, 1.0, "True", "", np.int64(1), math.nan]
    elif str in kinds or any(typing.get_origin(kind) is Literal for kind in kinds):
        values += [0, 1.5, True, math.nan, math.inf, np.array(1)]
    elif Path not in kinds:
        values += [0, 1.5, True, "x", "", math.nan, math.inf, np.array(1)]
    else:
        values += [0, 1.5, True, math.nan, "a\0b"]
    if any(typing.get_origin(kind) is tuple for kind in kinds):  # whose items decide
        return [value for value in values if not isinstance(value, list) and getattr(value, "dtype", None) != "<U1"]
    return [*values, [[1]], (1,), []]


def out_of_range(hint: Any) -> list[Any]:
    """Values of the right type beyond an annotation's limits."""
    values: list[Any] = []
    for member in members_of(hint)[0]:
        kind = plain_type(member)
        if typing.get_origin(kind) is Literal:
            values += ["no such choice", ""]
        if kind not in (int, float):
            continue
        limits = number_limits(member)[1]
        step = 1 if kind is int else 1e-3
        values += [limits.least - step] if limits.least is not None else []
        values += [limits.most + step] if limits.most is not None else []
        values += [kind(bound) for bound in (limits.above, limits.below) if bound is not None]
        if kind is int and limits.most is not None:
            values += HUGE
        if kind is float:
            values += [math.nan, -math.inf] if limits.least is not None or limits.size < math.inf else [math.nan]
        if kind is float and limits.size < math.inf:
            values += [math.inf, 10**400, np.float64(1e300)]
    return values


def members_of(hint: Any) -> tuple[list[Any], bool]:
    """Members of a union but None, and whether None is one."""
    union = typing.get_origin(hint) in (Union, types.UnionType)
    members = list(typing.get_args(hint)) if union else [hint]
    return [member for member in members if member is not type(None)], type(None) in members


def cases(settings: type) -> list[tuple[str, Any]]:
    """Field and value of everything that a dataclass of settings must refuse."""
    return [(name, value) for name, hint in field_types(settings).items() for value in bad_values(hint)]
