"""Settings are refused by type and range where they are made, with the name of the field."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pytest

import dc_kernels as dc
from bench.faults.calls import all_settings, examples
from bench.faults.values import out_of_range, required, wrong_types
from dc_kernels.model import settings as module
from dc_kernels.model.settings import Count, Limits, Positive, Settings, checker, field_types, numeric, plain_type

ALL = all_settings()


def example(settings: type) -> Any:
    """Valid settings."""
    return settings(**{name: examples()[settings.__name__][name] for name in required(settings)})


def test_all_settings_are_found():
    names = {settings.__name__ for settings in ALL}
    assert {"SolverConfig", "Stencil", "ImageSpec", "Grid", "SimulationOptions", "SolveOptions"} <= names
    assert {"Thesis", "Incline", "RunOptions", "SolverOptions", "Output", "Recipe", "GenerateOptions"} <= names


@pytest.mark.parametrize("settings", ALL, ids=lambda settings: f"{settings.__module__}.{settings.__name__}")
def test_every_field_refuses_what_it_cannot_be(settings):
    good = example(settings)
    cases = [
        (name, error, value)
        for name, hint in field_types(settings).items()
        for error, values in ((TypeError, wrong_types(hint)), (ValueError, out_of_range(hint)))
        for value in values
    ]
    for name, error, value in cases:
        with pytest.raises(error, match=rf"\b{name}\b") as caught:
            replace(good, **{name: value})
        text = str(caught.value)
        assert isinstance(caught.value, ValueError)  # who catches ValueError misses nothing
        assert "\n" not in text
        assert len(text) < 400


@pytest.mark.parametrize("settings", ALL, ids=lambda settings: f"{settings.__module__}.{settings.__name__}")
def test_numpy_scalars_become_pythons(settings):
    good = example(settings)
    for name, hint in field_types(settings).items():
        value, kind = getattr(good, name), plain_type(hint)
        if kind in (int, float, bool):
            scalar = {int: np.int64, float: np.float64, bool: np.bool_}[kind](value)
            made = getattr(replace(good, **{name: scalar}), name)
            assert type(made) is kind
            assert made == value
        if kind is float and value == int(value) and math.isfinite(value):
            assert type(getattr(replace(good, **{name: int(value)}), name)) is float


@dataclass(frozen=True, kw_only=True)
class Sample(Settings):
    """Fields of every kind."""

    count: Count = 1
    size: Positive = 1.0
    share: Annotated[float, Limits(least=0.0, below=1.0)] = 0.5
    any_size: Annotated[float, Limits(size=math.inf)] = math.inf
    choice: Literal["a", "b", 3] = "a"
    flag: bool = False
    maybe: Count | None = None
    either: int | str = 1
    pair: tuple[float, float] = (0.0, 0.0)
    many: tuple[Count, ...] = ()
    path: Path = Path("x")
    inner: dc.Stencil | None = None

    def check(self) -> None:
        if self.count == 13:
            raise ValueError("count is 13, and flag is not set")


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("count", 0, "count is 0; it must be an integer in [1, 2147483647]"),
        ("count", 2.0, "count is 2.0; it must be an integer in [1, 2147483647]"),
        ("count", -(10**400), "count is -1000"),
        ("count", 13, "count is 13, and flag is not set"),
        ("size", 0, "size is 0.0; it must be finite and > 0"),
        ("size", "1", "size is '1'; it must be a number, finite and > 0"),
        ("size", 1e39, "size is 1e+39; its magnitude must be at most 3.4e+38"),
        ("share", 1.0, "share is 1.0; it must be in [0, 1)"),
        ("any_size", math.nan, "any_size is nan; it must be no NaN"),
        ("choice", "c", "choice is 'c'; it must be one of ('a', 'b', 3)"),
        ("choice", True, "choice is True; it must be one of"),
        ("flag", 1, "flag is 1; it must be True or False"),
        ("maybe", 0, "maybe is 0; it must be an integer in [1, 2147483647]"),
        ("either", 1.5, "either is 1.5; it must be an int or str"),
        ("pair", (1, 2, 3), "pair is (1, 2, 3), of 3; it must be a tuple of 2"),
        ("pair", (1, math.nan), "pair[1] is nan; it must be finite"),
        ("pair", "12", "pair is '12'; it must be a tuple of 2"),
        ("many", (1, 2, 0), "many[2] is 0; it must be an integer in [1, 2147483647]"),
        ("many", {1}, "many is {1}; it must be a tuple"),
        ("path", "a\0b", "path is 'a\\x00b'; it must be a path"),
        (
            "inner",
            dc.Stencil,
            "inner is <class 'dc_kernels.grid.stencil.Stencil'>; it must be a Stencil, such",
        ),
    ],
)
def test_errors_say_what_is_and_what_must_be(name, value, message):
    with pytest.raises(ValueError, match="^" + re.escape(message)):
        Sample(**{name: value})


def test_values_are_kept_as_pythons_own():
    made = Sample(count=np.int8(3), size=2, pair=[1, np.float32(0.5)], many=np.array([1, 2]), path="a/b", either="z")
    assert made == Sample(count=3, size=2.0, pair=(1.0, 0.5), many=(1, 2), path=Path("a/b"), either="z")
    assert [type(value) for value in (made.count, *made.pair, *made.many)] == [int, float, float, int, int]


def test_an_annotation_without_a_check_is_refused_when_it_is_read():
    with pytest.raises(TypeError, match="has no check"):
        checker("a string")


class Hostile:
    """Cannot even be shown."""

    def __repr__(self) -> str:
        raise RuntimeError

    def __array__(self) -> np.ndarray:
        raise RuntimeError


@pytest.mark.parametrize(
    "values",
    ["12", b"12", bytearray(b"12"), {1, 2}, {1: 2}, [[1], [1, 2]], [1, None], [1j], [10**400], Hostile(), object()],
)
def test_what_is_no_array_of_numbers_is_named(values):
    with pytest.raises(TypeError, match="positions"):
        numeric("positions", values)


def test_what_is_an_array_of_numbers_is_taken():
    for values in ([1, 2], (1.0, 2.0), np.array([1, 2]), range(1, 3), np.array([1, 2], np.float16)):
        np.testing.assert_array_equal(numeric("positions", values), (1, 2))


def test_long_values_are_cut():
    assert len(module.shown("x" * 10**6)) < 100
    assert module.shown(10**5000) == "an int that cannot be shown"
