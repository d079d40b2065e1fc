"""Rows of a caller's own Jacobians beside contacts and joints: closed forms, all methods, the oracle, errors."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels import delassus
from dc_kernels.model.config import ACCELERATIONS
from tests import backends

DT, GRAVITY = 0.01, 9.8
EXACT = dc.SolverConfig(tolerance=1e-13, max_sweeps=2000)
NO_CONTACTS = {
    "body_a": np.zeros(0, np.int32),
    "body_b": np.zeros(0, np.int32),
    "point": np.zeros((0, 2)),
    "normal": np.zeros((0, 2)),
    "gap": np.zeros(0),
}
BACKENDS = pytest.mark.parametrize("backend", backends.ALL)


def row(jacobian_a, jacobian_b, a=0, b=1, **more):
    """One row, whose values may be changed in place."""
    found = {
        "row_body_a": np.array([a], np.int32),
        "row_body_b": np.array([b], np.int32),
        "row_jacobian_a": np.array([jacobian_a], float),
        "row_jacobian_b": np.array([jacobian_b], float),
    }
    return found | {f"row_{name}": np.array([value], float) for name, value in more.items()}


def bodies(masses, inertias, velocity=None):
    """Bodies by name; masses and inertias of 0 are infinite."""
    count = len(masses)
    with np.errstate(divide="ignore"):
        inverse = [np.where(np.array(values) > 0, 1.0 / np.array(values, float), 0.0) for values in (masses, inertias)]
    given = np.zeros((count, 2)) if velocity is None else np.array(velocity, float)
    found = {"inv_mass": inverse[0], "inv_inertia": inverse[1], "velocity": given, "angular_velocity": np.zeros(count)}
    return found | {"position": np.zeros((count, 2)), "angle": np.zeros(count)}


@BACKENDS
def test_a_pendulum_by_its_own_row_swings_as_one_by_a_joint(backend):
    length, ends = 2.0, []
    for own in (True, False):
        given = bodies([0, 3.0], [0, 0.5])
        place, v, w = given["position"], given["velocity"], given["angular_velocity"]
        place[1] = length * np.sin(0.7), -length * np.cos(0.7)
        before = {"velocity_before": np.zeros((2, 2)), "angular_velocity_before": np.zeros(2)}
        rows = row((0, 0, 0), (0, 0, 0), bias=0.0, impulse=0.0)
        joints = {
            "joint_body_a": np.zeros(1, np.int32),
            "joint_body_b": np.ones(1, np.int32),
            "joint_anchor_a": np.zeros((1, 2)),
            "joint_anchor_b": np.zeros((1, 2)),
            "joint_length": np.full(1, length),
        }
        line = {"rows": rows} if own else {"joints": joints}
        solver = dc.ContactSolver(**NO_CONTACTS, **given, **before, **line, config=EXACT, backend=backend)
        path = []
        for _ in range(100):
            before["velocity_before"][...] = v
            n = place[1] / np.linalg.norm(place[1])
            rows["row_jacobian_a"][0, :2], rows["row_jacobian_b"][0, :2] = -n, n
            # what the turn of the line lengthens it by within the step, as the joint has it
            rows["row_bias"][0] = 0.5 * DT * (v[1] @ (n[1], -n[0])) ** 2 / np.linalg.norm(place[1])
            v[1, 1] -= GRAVITY * DT
            solver.solve(DT)
            place += DT * v
            path.append(place[1].copy())
        assert w[1] == 0.0
        ends.append(np.array(path))
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-12)
    assert ends[0][:, 0].min() < 0.0 < ends[0][:, 0].max()  # it has swung through
    np.testing.assert_allclose(np.linalg.norm(ends[0], axis=1), length, atol=2e-3)


@BACKENDS
def test_a_motor_gives_no_more_than_its_torque(backend):
    """A wheel of inertia I comes to its speed after I speed / torque, and keeps it."""
    inertia, torque, speed = 0.5, 2.0, 3.0
    given = bodies([0, 1.0], [0, inertia])
    rows = row((0, 0, -1), (0, 0, 1), bias=-speed, lower=-torque * DT, upper=torque * DT, impulse=0.0)
    solver = dc.ContactSolver(**NO_CONTACTS, **given, rows=rows, config=EXACT, backend=backend)
    for step in range(1, 100):
        stats = solver.solve(DT)
        wanted = min(step * torque * DT / inertia, speed)
        assert given["angular_velocity"][1] == pytest.approx(wanted, abs=1e-12)
        assert stats.numpy("residual")[0] < 1e-10  # at the bound, too, it is solved
    assert rows["row_impulse"][0] == pytest.approx(0.0, abs=1e-12)
    rows["row_bias"][0] = speed  # read anew in each call: it now brakes
    solver.solve(DT)
    assert given["angular_velocity"][1] == pytest.approx(speed - torque * DT / inertia, abs=1e-12)


@BACKENDS
@pytest.mark.parametrize("ratio", [1.0, 2.0])
def test_a_pulley_in_closed_form(backend, ratio):
    """The rope's impulse is g dt (1 + r) / (1 / m_1 + r^2 / m_2), where body 2 hangs on r parts of it."""
    masses = 3.0, 5.0
    given = bodies([0, *masses], [0, 1.0, 1.0])
    given["velocity"][1:, 1] = -GRAVITY * DT
    rows = row((0, 1, 0), (0, ratio, 0), 1, 2, lower=0.0, impulse=0.0)  # a rope does not push
    dc.ContactSolver(**NO_CONTACTS, **given, rows=rows, config=EXACT, backend=backend).solve(DT)
    pull = GRAVITY * DT * (1.0 + ratio) / (1.0 / masses[0] + ratio**2 / masses[1])
    assert rows["row_impulse"][0] == pytest.approx(pull, rel=1e-12)
    wanted = -GRAVITY * DT + np.array([pull / masses[0], ratio * pull / masses[1]])
    np.testing.assert_allclose(given["velocity"][1:, 1], wanted, atol=1e-14)
    assert wanted[0] + ratio * wanted[1] == pytest.approx(0.0, abs=1e-14)


@BACKENDS
def test_a_soft_row_gives_way(backend):
    """An implicit damper of c = 1 / (softness): the impulse is -m v / (1 + m softness)."""
    given = bodies([0, 2.0], [0, 1.0], [(0, 0), (1.5, 0)])
    rows = row((-1, 0, 0), (1, 0, 0), softness=0.25, impulse=0.0)
    stats = dc.ContactSolver(**NO_CONTACTS, **given, rows=rows, config=EXACT, backend=backend).solve(DT)
    assert rows["row_impulse"][0] == pytest.approx(-2.0 * 1.5 / 1.5, rel=1e-12)
    assert given["velocity"][1, 0] == pytest.approx(0.5, abs=1e-12)
    assert stats.numpy("residual")[0] < 1e-12


# ---------------------------------------------------------------------- beside contacts and joints


def heap(worlds=3):
    """Columns of discs on the ground with a joint each, and rows of all kinds between them; arguments by name."""
    rng = np.random.default_rng(5)
    each, touch, extra = 6, 7, 4  # bodies with the ground, contacts, rows of each world
    found = {name: [] for name in ("body_a", "body_b", "point", "normal", "gap")}
    given = {name: [] for name in ("inv_mass", "inv_inertia", "velocity", "angular_velocity", "position", "angle")}
    rows = {name: [] for name in ("body_a", "body_b", "jacobian_a", "jacobian_b", "bias", "lower", "upper", "softness")}
    for w in range(worlds):
        first = each * w
        place = np.array([(0.0, 0.0), *((i % 2, 0.5 + i // 2) for i in range(each - 1))])
        given["position"] += place.tolist()
        given["inv_mass"] += [0.0, *rng.uniform(0.5, 2.0, each - 1)]
        given["inv_inertia"] += [0.0, *rng.uniform(2.0, 8.0, each - 1)]
        given["velocity"] += [(0.0, 0.0), *(rng.normal(size=(each - 1, 2)) - (0.0, 0.3))]
        given["angular_velocity"] += [0.0, *rng.normal(size=each - 1)]
        given["angle"] += [0.0] * each
        for a, b in ((0, 1), (0, 2), (1, 3), (2, 4), (3, 5), (1, 2), (3, 4)):
            n = place[b] - place[a] if a else np.array([0.0, 1.0])
            found["body_a"].append(first + a)
            found["body_b"].append(first + b)
            found["point"].append(place[b] - 0.5 * n)
            found["normal"].append(n)
            found["gap"].append(0.0)
        for k in range(extra):
            a, b = rng.choice(each, 2, replace=False)
            rows["body_a"].append(first + a)
            rows["body_b"].append(first + b)
            rows["jacobian_a"].append(rng.normal(size=3))
            rows["jacobian_b"].append(rng.normal(size=3))
            rows["bias"].append(0.3 * rng.normal())
            rows["lower"].append((-np.inf, -0.05, 0.0, 0.01)[k])
            rows["upper"].append((np.inf, 0.05, np.inf, 0.2)[k])
            rows["softness"].append((0.0, 0.0, 0.3, 0.0)[k])
    integers = ("body_a", "body_b")
    arrays = {n: np.array(v, np.int32 if n in integers else float) for n, v in (found | given).items()}
    arrays["joints"] = {
        "joint_body_a": np.arange(worlds, dtype=np.int32) * each + 4,
        "joint_body_b": np.arange(worlds, dtype=np.int32) * each + 5,
        "joint_anchor_a": np.zeros((worlds, 2)),
        "joint_anchor_b": np.zeros((worlds, 2)),
        "joint_length": np.full(worlds, 1.5),
        "joint_impulse": np.zeros(worlds),
    }
    arrays["rows"] = {f"row_{n}": np.array(v, np.int32 if n in integers else float) for n, v in rows.items()}
    arrays["rows"]["row_impulse"] = np.zeros(worlds * extra)
    arrays["impulse"] = np.zeros((worlds * touch, 2))
    starts = {"body": each, "contact": touch, "joint": 1, "row": extra}
    arrays |= {f"{name}_start": count * np.arange(worlds + 1) for name, count in starts.items()}
    return arrays | {"friction": 0.5}


SOLVED = ("velocity", "angular_velocity", "impulse")


def assert_alike(one, two, bound):
    for name in SOLVED:
        np.testing.assert_allclose(one[name], two[name], rtol=0, atol=bound, err_msg=name)
    np.testing.assert_allclose(one["rows"]["row_impulse"], two["rows"]["row_impulse"], rtol=0, atol=bound)


def solved(**options):
    given = heap()
    stats = dc.ContactSolver(**given, **{"config": EXACT, **options}).solve(DT)
    return given, stats


def test_the_solution_has_the_law_of_each_row():
    given, stats = solved()
    assert stats.numpy("change").max() < 1e-13 and stats.numpy("residual").max() < 1e-10
    rows = given["rows"]
    motion = np.column_stack([given["velocity"], given["angular_velocity"]])
    speed = rows["row_bias"] + rows["row_softness"] * rows["row_impulse"]
    for side in "ab":
        speed = speed + (rows[f"row_jacobian_{side}"] * motion[rows[f"row_body_{side}"]]).sum(axis=1)
    lower, upper, impulse = rows["row_lower"], rows["row_upper"], rows["row_impulse"]
    assert (lower <= impulse).all() and (impulse <= upper).all()
    free = (impulse > lower) & (impulse < upper)
    np.testing.assert_allclose(speed[free], 0.0, atol=1e-10)
    assert (speed[impulse == lower] > -1e-10).all() and (speed[impulse == upper] < 1e-10).all()
    assert free.any() and (impulse == lower).any() and (impulse == upper).any()
    assert np.abs(given["velocity"][given["inv_mass"] == 0]).max() == 0.0


@pytest.mark.parametrize("acceleration", ACCELERATIONS)
@pytest.mark.parametrize("method", ["pgs", "jacobi"])
def test_all_methods_find_the_same_velocities(method, acceleration):
    wanted, _ = solved()
    config = dataclasses.replace(EXACT, method=method, acceleration=acceleration, omega=1.0, max_sweeps=60_000)
    found, stats = solved(config=config)
    assert stats.numpy("change").max() < 1e-13
    for name in ("velocity", "angular_velocity"):
        np.testing.assert_allclose(found[name], wanted[name], atol=1e-8)


@pytest.mark.parametrize(
    "options",
    [
        {"schedule": "color"},
        {"threads": 2},
        pytest.param({"backend": "taichi"}, marks=backends.NEEDS_TAICHI),
    ],
)
def test_schedules_threads_and_compilers_give_the_same_bits(options):
    config = dataclasses.replace(EXACT, max_sweeps=15)
    (one, _), (two, _) = solved(config=config), solved(config=config, **options)
    assert_alike(one, two, 0.0)


@pytest.mark.parametrize("acceleration", ["none", "nncg", "adaptive"])
@pytest.mark.parametrize("method", ["pgs", "jacobi"])
def test_the_oracle_agrees(method, acceleration):
    config = dataclasses.replace(EXACT, method=method, acceleration=acceleration, max_sweeps=25, tolerance=0.0)
    (one, of_warp), (two, of_numpy) = (solved(config=config, backend=name) for name in ("warp", "numpy"))
    assert_alike(one, two, 1e-10)
    np.testing.assert_allclose(of_warp.numpy("residual"), of_numpy.numpy("residual"), rtol=1e-8, atol=1e-14)


def test_impulses_warm_start_the_next_call():
    given = heap()
    config = dataclasses.replace(EXACT, tolerance=1e-9, min_sweeps=1)
    solver = dc.ContactSolver(**given, config=config)
    first = solver.solve(DT).numpy("sweeps").copy()
    fresh = heap()
    for name in ("velocity", "angular_velocity"):
        given[name][...] = fresh[name]
    again = solver.solve(DT).numpy("sweeps").copy()
    assert (again == 1).all() and (first > 3).all()
    for name in ("velocity", "angular_velocity"):
        given[name][...] = fresh[name]
    assert (solver.solve(kept=True).numpy("sweeps") == 1).all()


# ---------------------------------------------------------------------- what is refused


@BACKENDS
@pytest.mark.parametrize(
    ("name", "index", "value", "message"),
    [
        ("row_body_a", 5, 99, r"row_body_a\[5\] is 99"),
        ("row_body_b", 5, 3, r"row_body_b\[5\] is 3"),  # of another world
        ("row_jacobian_a", (6, 2), np.nan, r"row_jacobian_a\[6, 2\] is nan; it must be finite"),
        ("row_jacobian_b", (6, 0), np.inf, r"row_jacobian_b\[6, 0\] is inf; it must be finite"),
        ("row_bias", 4, np.nan, r"row_bias\[4\] is nan; it must be finite"),
        ("row_softness", 4, -1.0, r"row_softness\[4\] is -1.0"),
        ("row_lower", 5, 1.0, r"row_lower\[5\] is 1.0; it must be at most row_upper"),
        ("row_upper", 7, np.nan, r"row_lower\[7\] is 0.01; it must be at most row_upper"),
        ("row_lower", 4, np.inf, r"row_lower\[4\] is inf; it must be at most row_upper, and below infinity"),
        ("row_impulse", 7, np.nan, r"row_impulse\[7\] is nan; it must be finite"),
    ],
)
def test_values_out_of_range_are_named(name, index, value, message, backend):
    given, fresh = heap(), heap()
    given["rows"][name][index] = value
    with pytest.raises(ValueError, match=message):
        dc.ContactSolver(**given, backend=backend).solve(DT)
    world = slice(6, 12)
    np.testing.assert_array_equal(given["velocity"][world], fresh["velocity"][world])


def test_arguments_are_checked_when_they_are_given():
    good = heap()

    def make(**changes):
        rows = {name: array for name, array in (good["rows"] | changes).items() if array is not None}
        dc.ContactSolver(**(good | {"rows": rows}))

    make(row_bias=None, row_lower=-1.0, row_upper=2, row_softness=None, row_impulse=None)
    for changes, message in (
        ({"row_jacobian_a": None}, "row_jacobian_a is missing; rows need their bodies and Jacobians"),
        ({"bias": 0.0}, "bias is unknown; rows have"),
        ({"row_jacobian_b": np.zeros((12, 2))}, r"row_jacobian_b has shape \(12, 2\); it must be \(12, 3\)"),
        ({"row_bias": np.zeros(12, np.float32)}, "row_bias has dtype float32; it must be float64"),
    ):
        with pytest.raises(ValueError, match=message):
            make(**changes)
    with pytest.raises(ValueError, match="row_start is of 2 worlds, body_start of 3"):
        dc.ContactSolver(**(good | {"row_start": np.array([0, 6, 12])}))
    with pytest.raises(ValueError, match="rows of own Jacobians have bounds"):
        delassus.from_solver(dc.ContactSolver(**good), DT)
