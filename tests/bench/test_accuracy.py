"""Closed forms of mechanics; each case in ``bench/accuracy_*.py`` has formula and source in its docstring."""

import pytest

from bench.accuracy.accuracy import CASES, MODULES, measure
from bench.accuracy.common import cases, order


@pytest.mark.parametrize("name", CASES.names(quick=True))
def test_closed_form(name):
    checks = list(CASES.all[name](True))
    failed = [str(check) for check in checks if not check.passed]
    assert checks and not failed, "\n".join([CASES.all[name].__doc__, *failed])


def test_every_module_adds_its_cases():
    found = {case.__module__ for case in cases.all.values()}
    assert found == {module.__name__ for module in MODULES}


def test_a_wrong_closed_form_fails(monkeypatch, tmp_path):
    """A case is judged by what it yields: with g off by 1 % free fall fails, and is the only one that is named."""
    from bench import verdicts
    from bench.accuracy import friction as accuracy_friction

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(accuracy_friction, "G", 9.9)
    monkeypatch.setattr(CASES, "all", {name: CASES.all[name] for name in ("free_fall", "applied_force_and_torque")})
    values = measure(quick=True)
    assert values["cases"] == 2 and values["failures"] == ["free_fall"]
    assert any(not row["passed"] for row in values["rows"])
    assert isinstance(verdicts.table(values["rows"]), str)


def test_orders_are_slopes_of_at_least_four_time_steps():
    steps = (1.0, 0.5, 0.25, 0.125)
    assert order(steps, [-3 * dt**2 for dt in steps]) == pytest.approx(2)
    with pytest.raises(ValueError, match="3 time steps; an order needs at least four"):
        order(steps[:3], steps[:3])
