"""Values that a field of a dataclass of settings must refuse, from the field's annotation."""

from __future__ import annotations

import math
import types
import typing
from collections.abc import Iterator
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any, Literal, Union

import numpy as np

from dc_kernels.model.settings import Settings, field_types, number_limits, plain_type

OBJECTS: tuple[Any, ...] = (b"ab", {1, 2}, {"a": 1}, 1j, object(), np.array([[1.0]]), int, Ellipsis)
"""Nothing that any field takes."""


def subclasses(base: type = Settings) -> Iterator[type]:
    """Every dataclass of settings that has been imported, and belongs to the project."""
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
    values = [*OBJECTS, *([] if optional else [None])]
    kinds = {plain_type(member) for member in members}
    if int in kinds and float not in kinds:
        values += [2.5, 2.0, np.float32(2.0), math.nan, math.inf]
    if kinds & {int, float}:
        values += ["12", "", True, np.True_, np.array(1), np.array([1])]
    elif bool in kinds:
        values += [0, 1, 1.0, "True", "", np.int64(1)]
    elif str in kinds or any(typing.get_origin(kind) is Literal for kind in kinds):
        values += [0, 1.5, True, math.nan]
    elif Path not in kinds:
        values += [0, 1.5, True, "x"]
    if not any(typing.get_origin(kind) is tuple for kind in kinds):
        values += [[[1]], (1,), []]
    return values


def out_of_range(hint: Any) -> list[Any]:
    """Values of the right type beyond an annotation's limits."""
    values: list[Any] = []
    for member in members_of(hint)[0]:
        kind = plain_type(member)
        if typing.get_origin(kind) is Literal:
            values += ["no such choice", ""]
        if kind is float:
            values.append(math.nan)
        if kind not in (int, float):
            continue
        limits = number_limits(member)[1]
        step = 1 if kind is int else 1e-3
        values += [limits.least - step] if limits.least is not None else []
        values += [limits.most + step] if limits.most is not None else []
        values += [kind(bound) for bound in (limits.above, limits.below) if bound is not None]
        if kind is int and limits.most is not None:
            values += [2**64, 10**400, -(10**5000)]
        if kind is float and limits.size < math.inf:
            values += [math.inf, -math.inf, 1e39, 10**400, np.float64(1e300)]
    return values


def members_of(hint: Any) -> tuple[list[Any], bool]:
    """Members of a union but None, and whether None is one."""
    union = typing.get_origin(hint) in (Union, types.UnionType)
    members = list(typing.get_args(hint)) if union else [hint]
    return [member for member in members if member is not type(None)], type(None) in members


def cases(settings: type) -> list[tuple[str, type[Exception], Any]]:
    """Field, error and value of everything that a dataclass of settings must refuse."""
    found = []
    for name, hint in field_types(settings).items():
        found += [(name, TypeError, value) for value in wrong_types(hint)]
        found += [(name, ValueError, value) for value in out_of_range(hint)]
    return found
