"""The tree keeps its shape: ``python -m bench house`` stays at or below a bound in each figure."""

from __future__ import annotations

import pytest

from bench import house
from tests.conftest import FIRST, TOGETHER

# Where a bar is not reached yet, today's figure is the bound: it may fall, and then it is lowered here, but not rise.


@pytest.fixture(scope="module")
def values():
    return house.measure(quick=True)


@pytest.mark.parametrize("key", house.KEYS)
def test_figure_stays_within_its_bound(values, key):
    where = values["where"].get(key)
    assert values[key] <= house.BARS[key], f"{key} is {values[key]}, at most {house.BARS[key]}: {where}"


def test_report_names_what_is_above_its_bar(values):
    assert values["above"] == sum(values[key] > bar for key, bar in house.BARS.items())
    text = house.report(values)
    assert all(key in text for key in house.KEYS)
    assert values["where"]["longest_module"] in text


def test_files_that_are_run_first_are_there():
    missing = [file for file in (*TOGETHER, *FIRST) if not (house.ROOT / "tests" / file).is_file()]
    assert not missing and len({*TOGETHER, *FIRST}) == len(TOGETHER) + len(FIRST)
