"""Settings and arguments that users give, checked by type and range from their annotations, where they are made.

A dataclass that derives from ``Settings`` says with the annotation of each field what the field may hold::

    @dataclass(frozen=True, kw_only=True)
    class Options(Settings):
        threads: Count = 1
        width: Annotated[float, Limits(above=0.0, most=16.0)] = 1.0
        method: Literal["pgs", "jacobi"] = "pgs"

Its fields are checked when an object is made, or made anew with ``dataclasses.replace``, and hold Python's own numbers
then, whatever kind of scalar was given. A function checks an argument by the same rules with ``checker``.
"""

from __future__ import annotations

import difflib
import functools
import inspect
import math
import os
import sys
import types
import typing
from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Union

import numpy as np

Check = Callable[[str, Any], Any]
"""Takes the name of a value and the value; returns it as Python's own type, or raises an error with the name."""

MAX_INT = 2**31 - 1
"""Kernels count in int32."""
MAX_FLOAT = float(np.finfo(np.float32).max)
"""Settings reach kernels in float32 too."""
_FIELD_CHECKS: dict[type, dict[str, Check]] = {}
SHOWN = 80  # characters of a value in an error


class WrongType(TypeError, ValueError):
    """A value of the wrong type; a ``ValueError`` too, so that those who catch that miss nothing."""


class UnknownName(ValueError, KeyError):
    """A name of nothing; a ``ValueError`` as any other bad value, and a ``KeyError``, as names are looked up."""

    __str__ = Exception.__str__  # a KeyError would show a literal of its text


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What a number may be: metadata of an annotation."""

    least: float | None = None
    """The number is at least this."""
    above: float | None = None
    """The number is larger than this."""
    most: float | None = None
    """The number is at most this."""
    below: float | None = None
    """The number is smaller than this."""
    size: float = MAX_FLOAT
    """A float is at most so far from zero; inf: even inf is allowed."""

    def hold(self, value: float) -> bool:
        """Tell whether a number lies within the limits; NaN does not."""
        return (
            value == value
            and (self.least is None or value >= self.least)
            and (self.above is None or value > self.above)
            and (self.most is None or value <= self.most)
            and (self.below is None or value < self.below)
        )

    def hold_all(self, values: np.ndarray) -> np.ndarray:
        """Tell of each of many numbers whether it lies within the limits and is finite."""
        good = np.isfinite(values) & (np.abs(values) <= self.size)
        for bound, compare in (
            (self.least, np.greater_equal),
            (self.above, np.greater),
            (self.most, np.less_equal),
            (self.below, np.less),
        ):
            if bound is not None:
                good &= compare(values, bound)
        return good

    def demand(self, value: float, kind: type = float) -> str:
        """Say what is wrong with a number that was refused."""
        if kind is float and math.isfinite(value) and self.hold(value):
            return f"its magnitude must be at most {self.size:.3g}"
        return f"it must be {self.words(kind)}"

    def words(self, kind: type = float) -> str:
        """Say what a float or an int may be: "in [0, 1)", "finite and > 0", "an integer >= 1"."""
        low, high = _first(self.least, self.above), _first(self.most, self.below)
        start = "an integer" if kind is int else "" if self.size == math.inf else "finite"
        if high is not None and low is not None:
            brackets = "[" if self.above is None else "(", "]" if self.below is None else ")"
            words = f"in {brackets[0]}{_plain(low)}, {_plain(high)}{brackets[1]}"
            return f"{start} {words}" if kind is int else words
        bounds = []
        if low is not None:
            bounds.append(f"{'>=' if self.above is None else '>'} {_plain(low)}")
        if high is not None:
            bounds.append(f"{'<=' if self.below is None else '<'} {_plain(high)}")
        if kind is int:
            return " ".join([start, *bounds])
        return " and ".join([*filter(None, [start]), *bounds]) or "no NaN"


Count = Annotated[int, Limits(least=1, most=MAX_INT)]
"""How many there are, at least one."""
Whole = Annotated[int, Limits(least=0, most=MAX_INT)]
"""How many there are, or which one; none, or the first, is 0."""
Seed = Annotated[int, Limits(least=0, most=2**63 - 1)]
"""Seed of random numbers, which files hold in 64 bits."""
Positive = Annotated[float, Limits(above=0.0)]
NotNegative = Annotated[float, Limits(least=0.0)]


def shown(value: Any) -> str:
    """Return the representation of any value in one line of bounded length."""
    try:
        text = " ".join(repr(value).split())
    except Exception:  # of anybody's class, or an int of too many digits
        text = f"{with_article(type(value).__name__)} that cannot be shown"
    return text if len(text) <= SHOWN else f"{text[:SHOWN]}..."


class Settings:
    """Base of dataclasses whose fields are checked by their annotations when an object is made."""

    settings_prefix: ClassVar[str] = ""
    """Stands before the name of a field in errors."""

    def __post_init__(self) -> None:
        """Check all fields, then what ``check`` looks at.

        Raises:
            TypeError: naming the field, for a value of another type.
            ValueError: naming the field and its limits.
        """
        for name, check in field_checks(type(self)).items():
            value = getattr(self, name)
            checked = check(self.settings_prefix + name, value)
            if checked is not value:
                object.__setattr__(self, name, checked)
        self.check()

    def check(self) -> None:
        """Raise a ``ValueError``, naming the fields, for fields that do not go together; all have been checked."""


def field_types(settings: type) -> dict[str, Any]:
    """Return the annotation of each field of a dataclass, resolved where its class was written, with its metadata.

    Raises:
        NameError: naming the field, for an annotation of names that its module does not have.
    """
    found = {}
    for f in fields(settings):
        if f.init and isinstance(f.type, str):
            owner = next(one for one in settings.__mro__ if f.name in inspect.get_annotations(one))
            names = {**vars(typing), **vars(sys.modules.get(owner.__module__, typing))}
            try:
                found[f.name] = eval(f.type, names)
            except NameError as error:
                raise NameError(f"{owner.__name__}.{f.name} is annotated {f.type!r}: {error}") from error
        elif f.init:
            found[f.name] = f.type
    # a dataclass whose module is not loaded takes the name of a ClassVar for a field
    return {name: hint for name, hint in found.items() if typing.get_origin(hint) is not ClassVar}


def field_checks(settings: type) -> dict[str, Check]:
    """Return the check of each field of a dataclass, by name."""
    if settings not in _FIELD_CHECKS:
        _FIELD_CHECKS[settings] = {name: checker(hint) for name, hint in field_types(settings).items()}
    return _FIELD_CHECKS[settings]


def required(hint: Any) -> Any:
    """Return an annotation without None, where it is one type or None."""
    some = [member for member in typing.get_args(hint) if member is not type(None)]
    return some[0] if len(some) == 1 and type(None) in typing.get_args(hint) else hint


def plain_type(hint: Any) -> Any:
    """Return an annotation without its metadata: ``int`` of ``Annotated[int, ...]``."""
    return typing.get_args(hint)[0] if typing.get_origin(hint) is Annotated else hint


def number_limits(hint: Any) -> tuple[type, Limits]:
    """Return whether an annotation is that of an int or a float, and its limits."""
    limits = [given for given in typing.get_args(hint)[1:] if isinstance(given, Limits)]
    return plain_type(hint), limits[0] if limits else Limits()


def counted(number: int, name: str) -> str:
    """Return a number with its noun, as "1 body", "2 bodies", "3 boxes"."""
    if number == 1:
        return f"1 {name}"
    for end, plural in (("y", "ies"), ("ex", "ices"), ("x", "xes")):
        if name.endswith(end):
            return f"{number} {name.removesuffix(end)}{plural}"
    return f"{number} {name}s"


def meant(name: str, known: Sequence[str]) -> str:
    """Ask for the known names that a wrong one may stand for; empty where none is near."""
    near = [other for other in known if name in other] or difflib.get_close_matches(name, known)
    return f" (did you mean {' or '.join(near)}?)" if near else ""


def numeric(
    name: str, values: Any, wanted: str = "numbers", kinds: str = "iuf", inner: tuple[int, ...] = ()
) -> np.ndarray:
    """Return numbers of any shape as an array: what is one, or a nested list, and no text, set, mapping or object.

    Args:
        name: of the argument.
        values: of the user.
        wanted: what the values must be, for errors.
        kinds: of the dtypes that are allowed, as numpy has them.
        inner: shape of one element; an empty list, whose shape is (0,), is none of them.

    Raises:
        TypeError: naming it, for anything else.
        ValueError: for a tensor that requires a gradient, which would be lost.
    """
    array = None
    if not isinstance(values, str | bytes | bytearray | Set | Mapping | np.ma.MaskedArray):  # whose mask would be lost
        try:
            array = np.asarray(values)
        except (TypeError, ValueError, OverflowError, RuntimeError):  # ragged, of anybody's class, of torch
            array = None
        if array is not None and not array.size and isinstance(values, list | tuple):
            array = array.astype(np.intp if "i" in kinds else bool)  # an empty list holds nothing of another kind
    if array is None and getattr(values, "requires_grad", False):
        raise ValueError(f"{name} requires a gradient, which would be lost; give {name}.detach()")
    if array is None or array.dtype.kind not in kinds:
        found = f"has dtype {values.dtype}" if isinstance(values, np.ndarray) else f"is {shown(values)}"
        raise WrongType(f"{name} {found}; it must be {wanted}") from None
    return array.reshape(0, *inner) if array.shape == (0,) else array


def check_choice(name: str, value: Any, allowed: Any) -> Any:
    """Return the one of the allowed values that a value is.

    Raises:
        TypeError, ValueError: naming it and what is allowed.
    """
    for choice in (allowed := tuple(allowed)):
        if isinstance(value, type(choice)) and isinstance(value, bool) == isinstance(choice, bool) and value == choice:
            return choice
    error = ValueError if isinstance(value, tuple({type(choice) for choice in allowed})) else WrongType
    raise error(f"{name} is {shown(value)}; it must be one of {allowed}")


def checker(hint: Any) -> Check:
    """Return the check of an annotation.

    Args:
        hint: bool, int, float, str or Path, with ``Limits`` or without; ``Literal``; a tuple; a class; a union.

    Raises:
        TypeError: for any other annotation.
    """
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if hint is Any:
        return lambda name, value: value
    if plain_type(hint) in (int, float):
        return _number(*number_limits(hint))
    if origin is Annotated:
        return checker(arguments[0])
    if hint in _SIMPLE:
        return _SIMPLE[hint]
    if origin is Literal:
        return lambda name, value: check_choice(name, value, arguments)
    if origin in (Union, types.UnionType):
        return _union(arguments)
    if origin is tuple:
        return _tuple(arguments)
    if origin is Callable:
        return _callable
    if isinstance(kind := origin or hint, type):
        return functools.partial(_instance, kind)
    raise TypeError(f"the annotation {hint} has no check")


def with_article(name: str) -> str:
    """Return a noun with its article, as "a list", "an int"."""
    return f"{'an' if name[0] in 'AEIOUaeiou' else 'a'} {name}"


def _plain(bound: float) -> str:
    return str(bound) if isinstance(bound, int) else f"{bound:.15g}"


def _first(*values: float | None) -> float | None:
    return next((value for value in values if value is not None), None)


def _number(kind: type, limits: Limits) -> Check:
    """Return the check of an int or a float within limits."""

    def check(name: str, value: Any) -> Any:
        if type(value) is not kind:
            value = _converted(name, value, kind, limits)
        if limits.hold(value) and (kind is int or -limits.size <= value <= limits.size):
            return value
        raise ValueError(f"{name} is {shown(value)}; {limits.demand(value, kind)}")

    return check


def _converted(name: str, value: Any, kind: type, limits: Limits) -> Any:
    """Return a scalar of another type as Python's int or float; no truth value is a number, no float an integer."""
    numbers = (int, np.integer) if kind is int else (int, float, np.integer, np.floating)
    if isinstance(value, numbers) and not isinstance(value, bool):
        try:
            return kind(value)
        except OverflowError:
            raise ValueError(f"{name} is {shown(value)}; {limits.demand(math.inf, kind)}") from None
    wanted = limits.words(kind) if kind is int else f"a number, {limits.words(kind)}"
    raise WrongType(f"{name} is {shown(value)}; it must be {wanted}")


def _truth(name: str, value: Any) -> bool:
    if isinstance(value, bool | np.bool_):
        return bool(value)
    raise WrongType(f"{name} is {shown(value)}; it must be True or False")


def _text(name: str, value: Any) -> str:
    if isinstance(value, str):
        return str(value)
    raise WrongType(f"{name} is {shown(value)}; it must be a str")


def _path(name: str, value: Any) -> Path:
    if isinstance(value, str | os.PathLike) and "\0" not in (text := str(os.fspath(value))):
        return value if isinstance(value, Path) else Path(text)
    raise WrongType(f"{name} is {shown(value)}; it must be a path")


def _none(name: str, value: Any) -> None:
    if value is not None:
        raise WrongType(f"{name} is {shown(value)}; it must be None")


def _callable(name: str, value: Any) -> Any:
    if callable(value):
        return value
    raise WrongType(f"{name} is {shown(value)}; it must be callable")


def _instance(kind: type, name: str, value: Any) -> Any:
    if isinstance(value, kind):
        return value
    hint = f", such as {kind.__name__}()" if value is kind and is_dataclass(kind) else ""
    what = shown(value) if isinstance(value, type) else with_article(type(value).__name__)
    raise WrongType(f"{name} is {what}; it must be {with_article(kind.__name__)}{hint}")


def _union(members: tuple[Any, ...]) -> Check:
    """Return the check of a union; where it is one type or None, errors are those of the type."""
    some = [member for member in members if member is not type(None)]
    checks = [checker(member) for member in some]
    optional = len(some) < len(members)

    def check(name: str, value: Any) -> Any:
        if value is None and optional:
            return None
        if len(checks) == 1:
            return checks[0](name, value)
        for one in checks:
            try:
                return one(name, value)
            except ValueError:
                continue
        wanted = " or ".join(getattr(plain_type(member), "__name__", str(member)) for member in some)
        raise WrongType(f"{name} is {shown(value)}; it must be {with_article(wanted)}")

    return check


def _tuple(members: tuple[Any, ...]) -> Check:
    """Return the check of a tuple, of so many members or of any number of one kind; lists and 1-d arrays will do."""
    if any_number := len(members) == 2 and members[1] is Ellipsis:
        members = members[:1]
    checks = [checker(member) for member in members]
    wanted = "a tuple" if any_number else f"a tuple of {len(checks)}"

    def check(name: str, value: Any) -> tuple[Any, ...]:
        array = isinstance(value, np.ndarray) and value.ndim == 1
        if not array and (not isinstance(value, Sequence) or isinstance(value, str | bytes | bytearray)):
            raise WrongType(f"{name} is {shown(value)}; it must be {wanted}")
        if not any_number and len(value) != len(checks):
            raise ValueError(f"{name} is {shown(value)}, of {len(value)}; it must be {wanted}")
        each = checks * len(value) if any_number else checks
        result = tuple(one(f"{name}[{i}]", item) for i, (one, item) in enumerate(zip(each, value)))
        unchanged = type(value) is tuple and all(a is b for a, b in zip(result, value))
        return value if unchanged else result

    return check


_SIMPLE: dict[Any, Check] = {bool: _truth, str: _text, Path: _path, type(None): _none}
