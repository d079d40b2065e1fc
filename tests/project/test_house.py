"""The tree keeps its shape: ``python -m bench house`` stays at or below a bound in each figure."""

from __future__ import annotations

import pytest

from bench import house

# Where a bar is not reached yet, today's figure is the bound: it may fall, and then it is lowered here, but not rise.


@pytest.fixture(scope="module")
def figures():
    return house.count()


@pytest.mark.parametrize("key", house.KEYS)
def test_figure_stays_within_its_bound(figures, key):
    value, where = figures[key]
    assert value <= house.BARS[key], f"{key} is {value}, at most {house.BARS[key]}: {where}"
