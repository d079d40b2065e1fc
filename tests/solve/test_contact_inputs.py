"""The solver as a stage: bad input is named before anything is written."""

from __future__ import annotations

import numpy as np
import pytest

import dc_kernels as dc
from tests import backends
from tests.solve.piles import DT, arrays_of, drop, pile


@pytest.mark.parametrize("backend", backends.ALL)
@pytest.mark.parametrize(
    ("name", "index", "value", "message"),
    [
        ("body_a", 0, 9, r"body_a\[0\] is 9; it must be a body of its world 0 \(bodies 0 .. 1\)"),
        ("body_b", 0, -1, r"body_b\[0\] is -1; it must be a body of its world"),
        ("body_b", 0, 0, r"body_b\[0\] is 0; it must be another body than body A"),
        ("normal", (0, 1), 2.0, r"normal\[0\] is \(0.0, 2.0\); it must be a unit vector"),
        ("normal", (0, 1), np.nan, r"normal\[0\] is \(0.0, nan\); it must be a unit vector"),
        ("point", (0, 1), np.inf, r"point\[0, 1\] is inf; it must be finite"),
        ("gap", 0, np.nan, r"gap\[0\] is nan; it must be finite"),
        ("friction", 0, -0.1, r"friction\[0\] is -0.1; it must be finite and >= 0"),
        ("restitution", 0, 1.5, r"restitution\[0\] is 1.5; it must be in \[0, 1\]"),
        ("inv_mass", 1, -1.0, r"inv_mass\[1\] is -1.0; it must be in \[0, 8e\+37\]"),
        ("inv_mass", 1, 1e38, r"inv_mass\[1\] is 1e\+38; it must be in \[0, 8e\+37\]"),
        ("inv_inertia", 0, np.inf, r"inv_inertia\[0\] is inf; it must be in \[0, 8e\+37\]"),
        ("position", (1, 0), np.nan, r"position\[1, 0\] is nan; it must be finite"),
        ("velocity", (1, 0), np.nan, r"velocity\[1, 0\] is nan; it must be finite"),
        ("angular_velocity", 1, np.inf, r"angular_velocity\[1\] is inf; it must be finite"),
        ("impulse", (0, 0), np.nan, r"impulse\[0, 0\] is nan; it must be finite"),
        ("count", 0, 2, r"count\[0\] is 2; it must lie in \[0, 1\], the room of world 0"),
        ("count", 0, -1, r"count\[0\] is -1; it must lie in \[0, 1\]"),
    ],
)
def test_values_out_of_range_are_named_and_nothing_is_written(name, index, value, message, backend):
    given = drop(friction=np.full(1, 0.5), restitution=np.zeros(1), count=np.ones(1, np.int32))
    solver = dc.ContactSolver(**given, gravity=9.81, backend=backend)
    good = given[name][index]
    given[name][index] = value
    before = {key: array.copy() for key, array in given.items()}
    with pytest.raises(ValueError, match=message):
        solver.solve(DT)
    for key, array in given.items():
        np.testing.assert_array_equal(array, before[key])
    given[name][index] = good
    solver.solve(DT)
    np.testing.assert_allclose(given["velocity"][1], (0.5, 0.0), atol=1e-3)


def test_a_disc_has_no_normal_arm():
    given = drop(point=np.array([[0.1, -0.5]]), inv_inertia=np.ones(2))
    with pytest.raises(ValueError, match="discs is True, but a contact of world 0 has an arm"):
        dc.ContactSolver(**given, discs=True).solve(DT)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"normal": np.zeros((1, 2), int)}, "normal has dtype int64; it must be float32 or float64"),
        ({"normal": np.zeros((1, 3))}, r"normal has shape \(1, 3\); it must be \(1, 2\)"),
        ({"body_a": np.zeros(1, np.int64)}, "body_a has dtype int64; it must be int32"),
        ({"gap": np.zeros(1, np.float32)}, "gap has dtype float32; it must be float64"),
        ({"inv_mass": np.zeros(4)[::2]}, "inv_mass has strides"),
        ({"impulse": np.zeros((3, 2))}, r"impulse has shape \(3, 2\); it must be \(1, 2\)"),
        ({"velocity": np.broadcast_to(0.0, (2, 2))}, "velocity has strides"),
        ({"point": None}, "either point or both of arm_a and arm_b"),
        ({"arm_a": np.zeros((1, 2))}, "either point or both"),
        ({"position": None}, "point needs position"),
        ({"body_start": [0, 3]}, r"body_start\[1\] is 3; it must be"),
        ({"body_start": [0, 1, 2]}, "contact_start is of 1 worlds, body_start of 2"),
        ({"length_scale": 0.0}, r"length_scale\[0\] is 0.0; it must be finite and > 0"),
        ({"weight": np.ones(3)}, r"weight has shape \(3,\)"),
        ({"schedule": "lanes"}, "schedule is 'lanes'"),
        ({"backend": "cuda"}, "backend is 'cuda'"),
        ({"threads": 0}, "threads is 0"),
        ({"friction": "high"}, "friction"),
        ({"friction": -1.0}, "^friction is -1.0; it must be finite and >= 0"),
        ({"restitution": 1.5, "gravity": 9.8}, r"^restitution is 1.5; it must be in \[0, 1\]"),
        ({"joints": {"joint_body_a": np.zeros(1, np.int32)}}, "joints need position and angle"),
        ({"joints": {"spring": 1}, "angle": np.zeros(2)}, "spring is unknown; joints have joint_body_a, .* as rows"),
        ({"joints": {"joint_frequency": np.ones(1)}, "angle": np.zeros(2)}, "joint_frequency is unknown; joints have"),
        ({"joints": [3], "angle": np.zeros(2)}, r"joints is a list; it must be a Mapping"),
        ({"config": dc.SolverConfig(contact_events=True)}, "contact_events is True; only a Simulation tells of events"),
        ({"config": dc.SolverConfig(contact_switches=True)}, "contact_switches is True; only a Simulation"),
        ({"velocity_before": np.zeros((2, 2))}, "velocity_before and angular_velocity_before go together"),
    ],
)
def test_arguments_are_checked_when_they_are_given(changes, message):
    with pytest.raises(ValueError, match=message):
        dc.ContactSolver(**drop(**changes)).solve(DT)


@pytest.mark.parametrize("dt", [0.0, -1.0, np.nan, None, "1"])
def test_time_steps_are_checked(dt):
    with pytest.raises(ValueError, match="dt is"):
        dc.ContactSolver(**drop()).solve(dt)


def test_no_contacts_and_no_worlds():
    given = drop()
    empty = {name: np.zeros((0, *given[name].shape[1:]), given[name].dtype) for name in CONTACTS_ONLY}
    solver = dc.ContactSolver(**(given | empty))
    assert solver.solve(DT).numpy("sweeps")[0] == 0
    np.testing.assert_array_equal(given["velocity"][1], (1.5, -2.0))
    nothing = {name: array[:0].copy() for name, array in given.items()} | empty
    none = dc.ContactSolver(**nothing, body_start=[0], contact_start=[0])
    assert len(none.solve(DT, np.zeros((0, 2))).numpy("sweeps")) == 0


CONTACTS_ONLY = ("body_a", "body_b", "point", "normal", "gap", "impulse")


def test_whatever_stands_in_any_array_is_named_or_harmless():
    """Wrong numbers put into any array at random: an error that names an array, or finite velocities."""
    draw = np.random.default_rng(5)
    good = arrays_of(pile(joints=True))
    fixed = ("contact_start", "body_start", "joint_start", "length_scale", "weight", "gravity")
    held = {name: array.copy() if isinstance(array, np.ndarray) else array for name, array in good.items()}
    held["joints"] = {name: array.copy() for name, array in good["joints"].items()}
    solver = dc.ContactSolver(**held)
    arrays = {name: array for name, array in held.items() if isinstance(array, np.ndarray) and name not in fixed}
    arrays |= held["joints"]
    named = set()
    for _ in range(300):
        for name, array in arrays.items():
            array[...] = {**good, **good["joints"]}[name]
        for name in draw.choice(list(arrays), 2):
            place = tuple(draw.integers(0, n) for n in arrays[name].shape)
            numbers = [-(2**31), 2**31 - 1, -1, 0, 63, 64, 200]
            odd = numbers if arrays[name].dtype.kind == "i" else [np.nan, np.inf, -np.inf, 1e38, -1.0, 0.0, -1e30]
            arrays[name][place] = draw.choice(odd)
        try:
            solver.solve(DT)
            solver.solve(kept=True)
        except ValueError as error:
            # a place or an anchor of 1e38 is a number: what becomes of it is found out
            named.add("ran off" if "ran off" in str(error) else str(error).split("[")[0])
        else:
            assert np.isfinite(held["velocity"]).all() and all(
                np.isfinite(held["impulse"][a : a + n]).all() for a, n in zip(held["contact_start"], held["count"])
            )
    assert len(named) > 15 and named <= {*arrays, "ran off"}


@pytest.mark.parametrize(
    ("name", "other"), [("impulse", "point"), ("velocity", "position"), ("angular_velocity", "inv_inertia")]
)
def test_what_is_written_shares_no_memory_with_what_is_read(name, other):
    given = drop()
    given[other] = given[name]
    before = given[name].copy()
    with pytest.raises(ValueError, match=f"{name} shares memory with {other}; it is written to"):
        dc.ContactSolver(**given).solve(DT)
    np.testing.assert_array_equal(given[name], before)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"gap": None}, "gap is missing; it must be an array"),
        ({"inv_inertia": 0.5}, r"inv_inertia is a float; it must be a numpy array"),
        ({"point": True}, r"point is a bool; it must be a numpy array"),
        ({"gap": np.ma.masked_array(np.zeros(1), [True])}, "gap is a MaskedArray; it must be a numpy array"),
        ({"friction": 10**400}, r"friction is 1000.*; it"),
        ({"length_scale": "12"}, r"length_scale is '12'; it must be a number or have shape \(1,\)"),
        ({"body_start": 2.5}, r"body_start is 2\.5; it must"),
        (
            {"joints": {"joint_body_a": np.zeros(1, np.int32)}, "angle": np.zeros(2)},
            "joint_body_b is missing; it must be an array",
        ),
    ],
)
def test_what_is_no_array_is_refused(changes, message):
    with pytest.raises((ValueError, TypeError, OverflowError), match=message):
        dc.ContactSolver(**drop(**changes)).solve(DT)


def test_arrays_of_a_call_share_no_memory():
    solver, spin, whole = dc.ContactSolver(**drop()), np.zeros(2), np.zeros((3, 2))
    with pytest.raises(ValueError, match="impulse shares memory with velocity; it is written to"):
        solver.solve(DT, whole[:2], impulse=whole[1:2])
    velocity = whole[:2]
    solver.solve(DT, velocity, spin, whole[2:], velocity_before=velocity, angular_velocity_before=spin)
