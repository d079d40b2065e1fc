"""Scenes that break solvers, in the short form of ``python -m bench stability``: the same criteria, fewer bodies."""

import pytest

from bench.stability import stability as bench_stability

CASES = bench_stability.cases()


@pytest.mark.parametrize("name", CASES.names(quick=True))
def test_scene(name):
    checks = list(CASES.all[name](True))
    assert checks
    assert all(check.passed for check in checks), "\n".join(str(c) for c in checks if not c.passed)
