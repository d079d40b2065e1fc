"""Solvers that ``from_contacts`` keeps give each problem as a new one would."""

import dataclasses

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels import delassus
from dc_kernels.delassus import kept, world

DT = 0.01


def contacts(count, seed, **changed):
    """Contacts between consecutive bodies, at places and in directions drawn at random."""
    draw = np.random.default_rng(seed)
    bodies = 40
    a = draw.integers(0, bodies - 1, count).astype(np.int32)
    turn = draw.uniform(0.0, 2.0 * np.pi, count)
    return {
        "body_a": a,
        "body_b": a + np.int32(1),
        "point": draw.normal(size=(count, 2)),
        "normal": np.stack([np.cos(turn), np.sin(turn)], axis=1),
        "gap": draw.uniform(-0.01, 0.0, count),
        "friction": draw.uniform(0.0, 1.0, count),
        "inv_mass": draw.uniform(0.5, 2.0, bodies),
        "inv_inertia": draw.uniform(0.5, 2.0, bodies),
        "position": draw.normal(size=(bodies, 2)),
        "velocity": draw.normal(size=(bodies, 2)),
        "angular_velocity": draw.normal(size=bodies),
        "length_scale": 0.5,
        **changed,
    }


@pytest.fixture
def solvers(monkeypatch):
    """Those that are kept, none at first."""
    monkeypatch.setattr(world, "_kept", found := kept.KeptSolvers())
    return found


def assert_as_new(given):
    problem = delassus.from_contacts(**given, dt=DT)
    wanted = delassus.from_solver(dc.ContactSolver(**given), DT)
    for field in dataclasses.fields(problem):
        one, two = getattr(problem, field.name), getattr(wanted, field.name)
        assert np.array_equal(one, two), field.name


def test_problems_are_those_of_new_solvers(solvers):
    cases = [contacts(count, seed) for seed, count in enumerate((50, 64, 30, 65, 128, 1))]
    for given in [*cases, contacts(50, 9, friction=0.25), contacts(50, 10, length_scale=2.0)]:
        assert_as_new(given)
    assert len(solvers._free) == 4  # for up to 64 and up to 128 contacts, and for two other numbers


def test_what_is_wrong_is_named_and_harms_no_later_call(solvers):
    assert_as_new(contacts(50, 0))
    bad = contacts(50, 1)
    bad["normal"][7] = 2.0
    with pytest.raises(ValueError, match=r"normal\[7"):
        delassus.from_contacts(**bad, dt=DT)
    with pytest.raises(ValueError, match="gap has shape"):
        delassus.from_contacts(**contacts(50, 1, gap=np.zeros(49)), dt=DT)
    with pytest.raises(ValueError, match="friction is missing"):
        delassus.from_contacts(**contacts(50, 1, friction=None), dt=DT)
    with pytest.raises(ValueError, match="friction"):
        delassus.from_contacts(**contacts(50, 1, friction=-1.0), dt=DT)
    assert_as_new(contacts(50, 2))


@pytest.mark.parametrize("name", kept.CONSTANT)
def test_what_a_solver_reads_when_it_is_made_is_read_anew(solvers, name):
    for value in (0.5, 2.0):
        assert_as_new(contacts(20, 3, **{"restitution": 0.0, name: np.full(1, value)}))
    assert not solvers._free


def test_only_so_many_are_kept(solvers):
    for k in range(kept.KEPT + 3):
        delassus.from_contacts(**contacts(20, k, friction=0.1 * k), dt=DT)
    assert len(solvers._free) == kept.KEPT
