"""The thesis protocol: its loop, its statistics, its options."""

from __future__ import annotations

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels.measure import contact_slots
from pipeline.evaluate.comparison import protocol
from pipeline.evaluate.options import ProtocolOptions
from pipeline.evaluate.runs import Run
from pipeline.evaluate.worlds import filled
from pipeline.run.trajectory import pressing
from pipeline.scenes import Thesis
from pipeline.seeds import HELD_OUT_SEED
from pipeline.starts.impulses import Zero

SMALL = ProtocolOptions(worlds=2, bodies=8, steps=120)


@pytest.fixture(scope="module")
def runs() -> list[Run]:
    return protocol(SMALL, progress=False)


def test_protocol_compares_the_starts(runs):
    assert [run.start for run in runs] == ["none", "builtin", "copy"]
    none, builtin, copy = (run.summary() for run in runs)
    assert none["states"] > 40
    assert copy["median_sweeps"] <= 2 < builtin["median_sweeps"]
    assert copy["mean_sweeps"] < builtin["mean_sweeps"] < none["mean_sweeps"]
    assert copy["done_in"]["10"] > 0.7
    assert none["start_error_normal"] > copy["start_error_normal"]
    for run in runs:
        shares = list(run.summary()["done_in"].values())
        assert shares == sorted(shares)
        assert run.sweeps.shape == (SMALL.steps, SMALL.worlds)
        assert run.decay.shape == (1000,)


def test_protocol_is_its_worlds_own_closed_loop(runs):
    """Builtin equals plain stepping, and the error of None is the mean square of its own impulses."""
    config = dc.SolverConfig.preset("thesis")
    sim = dc.Simulation(*Thesis(bodies=8).build(2, HELD_OUT_SEED).finalize(), config=config)
    sweeps, contacts = [], []
    for _ in range(SMALL.steps):
        sim.step(0.01)
        sweeps.append(dc.to_numpy(sim.stats.sweeps).copy())
        contacts.append(pressing(sim))
    np.testing.assert_array_equal(runs[1].sweeps, sweeps)
    np.testing.assert_array_equal(runs[1].contacts, contacts)
    sim = dc.Simulation(*Thesis(bodies=8).build(2, HELD_OUT_SEED).finalize(), config=config)
    squares, none = [], Zero(sim)
    for _ in range(SMALL.steps):
        sim.step(0.01, start=none)
        squares.append(sim.contacts.numpy("impulse")[contact_slots(sim.contacts)[0]].astype(float) ** 2)
    np.testing.assert_allclose(runs[0].start_error, np.concatenate(squares).mean(axis=0), rtol=1e-6)


def test_statistics_count_states_with_contacts():
    run = Run(
        start="none",
        solver="PGS",
        max_sweeps=100,
        tolerance=1e-4,
        sweeps=np.array([[0, 7], [40, 100], [100, 60]]),
        change=np.array([[0.0, 5e-5], [9e-5, 2e-4], [1e-5, 3e-5]]),
        contacts=np.array([[0, 2], [3, 4], [5, 6]]),
        start_error=(0.0, 0.0),
        wall_s=1.0,
        strategy_s=0.0,
    )
    row = run.summary()
    assert row["states"] == 5
    assert row["mean_sweeps"] == pytest.approx((7 + 40 + 100 + 100 + 60) / 5)
    assert row["median_sweeps"] == 60
    assert row["contacts"] == 4.0
    # of the two at the cap one has converged
    assert row["done_in"] == {"10": 0.2, "50": 0.4, "100": 0.8, "200": 0.8, "1000": 0.8}


def test_history_is_filled_with_its_last_change():
    history = np.array([[3.0, 2.0, 0.0, 0.0], [5.0, 4.0, 3.0, 2.0], [0.0, 0.0, 0.0, 0.0]])
    np.testing.assert_array_equal(filled(history, np.array([2, 4, 0])), [[3, 2, 2, 2], [5, 4, 3, 2], [0, 0, 0, 0]])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"starts": ()}, "starts and accelerations"),
        ({"starts": ("none", "best")}, "start is 'best'"),
        ({"steps": 0}, "steps is 0"),
        ({"max_sweeps": 0}, "max_sweeps is 0"),
        ({"worlds": 0}, "worlds is 0"),
        ({"dt": -1.0}, "dt is -1.0"),
    ],
)
def test_wrong_protocol_options_raise(options, message):
    with pytest.raises(ValueError, match=message):
        protocol(ProtocolOptions(**options), progress=False)
