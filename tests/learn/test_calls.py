"""Who answers a call, what is taken back, and what is counted: rules by hand, and any state against the oracle."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels.learn.calls import CallsInFlight
from dc_kernels.learn.channels import Answer
from dc_kernels.learn.in_flight import SolveReader
from dc_kernels.learn.network import NetworkInLanes
from dc_kernels.model.arrays import ArrayGroup
from dc_kernels.runtime.backends import argument_names, bind, make_kernels
from pipeline.options import RunOptions
from pipeline.scenes import Thesis

RULES: dict[str, Any] = {"middle": 1, "most": 6, "trust": 2, "pays": 50.0, "small": 0, "harm": 3.0}
WORLDS = 4


@pytest.fixture(scope="module")
def sim() -> dc.Simulation:
    """Worlds of discs whose solves have paused after some sweeps; tests put back what they change."""
    config = dc.SolverConfig.preset("accurate", acceleration="none")
    made = RunOptions(worlds=WORLDS, seed=3).simulation(Thesis(bodies=30), config)
    made.run(100, 0.01)
    made.collide(0.01)
    made.solve(pause=0)
    made.resume(pause=6)
    assert made.running.all()
    return made


def reader_of(sim: dc.Simulation) -> SolveReader:
    reader = SolveReader(sim, dc.Grid.from_box((-8.0, -8.0), (8.0, 8.0), 2.0))
    reader.begin()
    reader.take_all()
    sim.stats.numpy("replaced").fill(0)
    return reader


def copied(group: ArrayGroup) -> SimpleNamespace:
    """The arrays of a group as the oracle takes them, copied."""
    arrays = {name: group.numpy(name).copy() for name in group.table}
    return SimpleNamespace(**{name: a.view(np.recarray) if a.dtype.names else a for name, a in arrays.items()})


def by_oracle(kernel: str, reader: SolveReader, calls: CallsInFlight, **more: Any) -> dict[str, Any]:
    """All arguments of a kernel after the oracle has run on copies of them."""
    sim = reader.sim
    values: dict[str, Any] = {name: copied(getattr(sim, name)) for name in ("state", "contacts", "stats")}
    values |= {"reading": copied(reader.reading), "calls": copied(calls.calls), "world_offset": 0, **more}
    values["rules"] = SimpleNamespace(**calls.rules, tolerance=sim.config.ends_at[1])
    bind(make_kernels("numpy", "learn.calls", "float32")[kernel], reader.worlds, values, "cpu")()
    return values


def assert_same(wanted: dict[str, Any], reader: SolveReader, calls: CallsInFlight) -> None:
    groups = {"calls": calls.calls, "reading": reader.reading, "contacts": reader.sim.contacts}
    for key, names in (
        ("calls", tuple(calls.calls.table)),
        ("reading", ("answer", "known", "before")),
        ("contacts", ("impulse",)),
    ):
        for name in names:
            np.testing.assert_allclose(groups[key].numpy(name), getattr(wanted[key], name), rtol=1e-6, err_msg=name)
    np.testing.assert_array_equal(reader.sim.stats.numpy("replaced"), wanted["stats"].replaced)


def test_backends_have_the_same_kernels():
    warp, oracle = (make_kernels(backend, "learn.calls", "float32") for backend in ("warp", "numpy"))
    assert list(warp) == list(oracle)
    for name in warp:
        assert argument_names(warp[name]) == argument_names(oracle[name])


def test_any_state_is_decided_and_settled_as_by_the_oracle(sim):
    draw = np.random.default_rng(2)
    reader = reader_of(sim)
    iteration, impulse = sim.stats.numpy("iteration"), sim.contacts.numpy("impulse")
    kept = iteration.copy(), impulse.copy()
    reader.read(np.arange(WORLDS), begin=False, what="steps")
    seen, counted = set(), set()
    counts = np.sort(sim.contacts.numpy("contact_count"))
    for i in range(60):
        calls = CallsInFlight(reader, **{**RULES, "small": int(counts[1]) * (i // 20)})
        for name, most in (("asking", 2), ("waiting", 2), ("pause", 3), ("made", 8), ("failures", 5)):
            calls.calls.numpy(name)[:] = draw.integers(0, most, WORLDS)
        scale = 10.0 ** draw.uniform(-8, 2, (3, WORLDS)).astype(np.float32)
        iteration["step_last"], iteration["step_before"], calls.calls.numpy("before")[:] = scale
        iteration["step_last"] = np.where(draw.random(WORLDS) < 0.1, np.nan, iteration["step_last"])
        iteration["finished"] = draw.random(WORLDS) < 0.2
        reader.before[:] = draw.normal(size=reader.before.shape)
        wanted = by_oracle("decide_calls", reader, calls)
        calls.decide()
        assert_same(wanted, reader, calls)
        seen |= set(calls.answer.tolist())
        sim.stats.numpy("replaced")[:] = draw.integers(0, 2, WORLDS)
        wanted = by_oracle("settle_calls", reader, calls, begin=i % 2)
        calls.settle(begin=bool(i % 2))
        assert_same(wanted, reader, calls)
        sim.stats.numpy("replaced").fill(0)
        counted |= {name for name in ("refused", "failed", "undone") if calls.calls.numpy(name).any()}
    assert seen == set(Answer) and len(counted) == 3
    iteration[:], impulse[:] = kept


def test_the_network_is_asked_where_many_sweeps_are_left(sim):
    """Steps that shrink by r a sweep need ln(step / tolerance) / ln(1 / r) more."""
    reader = reader_of(sim)
    calls = CallsInFlight(reader, **RULES)
    calls.begin(np.ones(WORLDS, bool))
    iteration = sim.stats.numpy("iteration")
    kept = iteration.copy()
    tolerance = sim.config.ends_at[1]
    last = (100.0 * tolerance) ** 2
    iteration["step_last"] = last
    rates = [math.exp(-math.log(100.0) / left) for left in (20.0, 49.0, 51.0)]
    iteration["step_before"][:3] = [last / r**2 for r in rates]
    iteration["step_before"][3] = last  # they do not shrink
    calls.decide()
    assert calls.answer.tolist() == [Answer.EVEN, Answer.EVEN, Answer.NETWORK, Answer.NETWORK]
    iteration["step_last"] = 0.5 * tolerance**2  # nothing is left to gain
    iteration["step_before"] = 0.6 * tolerance**2
    calls.decide()
    assert (calls.answer == Answer.EVEN).all()
    small = int(np.sort(sim.contacts.numpy("contact_count"))[1])  # of at most so many contacts
    calls = CallsInFlight(reader, **{**RULES, "small": small})
    calls.begin(np.ones(WORLDS, bool))
    calls.decide()
    wanted = np.where(sim.contacts.numpy("contact_count") <= small, Answer.NETWORK, Answer.EVEN)
    np.testing.assert_array_equal(calls.answer, wanted)
    iteration[:] = kept


def test_a_round_is_what_its_parts_are(sim):
    """One launch of all worlds against decide, reads of some, answers and settle; worlds that wait are left alone."""
    iteration, impulse = sim.stats.numpy("iteration"), sim.contacts.numpy("impulse")
    kept = iteration.copy(), impulse.copy()
    found = []
    for at_once in (True, False):
        reader = reader_of(sim)
        calls = CallsInFlight(reader, **{**RULES, "pays": math.inf})
        calls.begin(np.ones(WORLDS, bool))
        calls.calls.numpy("pause")[1] = 1
        network = NetworkInLanes(reader, None)
        if at_once:
            calls.round(network)
        else:
            calls.decide()
            reader.read(np.flatnonzero(calls.answer), begin=False, what="steps")
            network(begin=False)
            calls.settle(begin=False)
        found.append([*(calls.calls.numpy(name).copy() for name in calls.calls.table), impulse.copy()])
        changed = [(impulse != kept[1])[part].any() for part in parts_of(sim)]
        assert changed == [True, False, True, True]
        impulse[:] = kept[1]
    for a, b in zip(*found, strict=True):
        np.testing.assert_array_equal(a, b)
    iteration[:] = kept[0]


def parts_of(sim: dc.Simulation) -> list[slice]:
    """Slots of the contacts of each world."""
    first, count = (sim.contacts.numpy(name) for name in ("contact_start", "contact_count"))
    return [slice(a, a + n) for a, n in zip(first, count)]
