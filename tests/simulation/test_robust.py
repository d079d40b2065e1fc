"""What must not crash, go on unseen, or be taken in silence."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels.solve.rows import COLORS
from pipeline.scenes import Thesis

ROOT = Path(__file__).resolve().parents[2]
DISCS = """
import os, signal, sys, threading, time
import numpy as np
import warp as wp
import dc_kernels as dc
wp.config.log_level = wp.LOG_WARNING

def discs(counts, **options):
    builder = dc.ModelBuilder()
    for count in counts:
        builder.add_world()
        ground = builder.add_body(type=dc.BodyType.STATIC)
        builder.add_chain(ground, [(0, 40), (0, 0), (40, 0), (40, 40)])
        builder.add_discs([(1 + i % 30 * 1.1, 1 + i // 30 * 1.1) for i in range(count)], radius=0.5)
    return dc.Simulation(*builder.finalize(), **options)
"""


def run(code: str) -> str:
    """What a process of its own prints, so that a crash is a failed test."""
    done = subprocess.run([sys.executable, "-c", DISCS + code], cwd=ROOT, capture_output=True, text=True, timeout=280)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


def test_no_thread_works_on_after_an_interrupt():
    printed = run(
        """
from dc_kernels.runtime import stepping
stepping.GRACE = 60.0  # that a busy machine has for what the world of 900 discs is behind
apart, level = [], stepping.Shards.level
def leveled(shards, *rounds):
    apart.append(max(shards.left) - min(shards.left))
    return level(shards, *rounds)
stepping.Shards.level = leveled
sim = discs((2, 900), threads=2)
sim.step(0.01)
try:
    threading.Timer(1.0, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
    sim.run(1_000_000, 0.01)
except KeyboardInterrupt:
    at = sim.state.numpy("time").copy()
    # the world of two discs may not have run so far ahead that the other takes long to follow, or sweeps no more
    assert 0 < len(apart) and max(apart) <= (stepping.APART + 1) * stepping.AT_ONCE // 900, apart
    assert not sim.running.any(), sim.running
    time.sleep(0.3)
    print("rests", (sim.state.numpy("time") == at).all(), "together", (at == at[0]).all())
"""
    )
    assert "rests True together True" in printed


def test_a_graph_that_growth_made_stale_does_no_harm():
    printed = run(
        """
sim = discs((60, 60), contacts_per_body=0.1)
sim.step(0.01)
with wp.ScopedCapture(device="cpu") as capture:
    sim.step(0.01)
version = sim.layout_version
for _ in range(200):
    wp.capture_launch(capture.graph)
sim.run(300, 0.01)
assert sim.layout_version != version
for _ in range(50):
    wp.capture_launch(capture.graph)
print("alive", np.isfinite(sim.state.numpy("position")).all())
"""
    )
    assert "alive True" in printed


def simulation(**options) -> dc.Simulation:
    return dc.Simulation(*Thesis(bodies=12).build(2, 1).finalize(), **options)


def test_steps_are_integers_of_any_kind():
    sim = simulation()
    sim.run(np.int64(3), 0.01)
    np.testing.assert_allclose(sim.state.numpy("time"), 0.03)
    for steps in (2.0, -1, True):
        with pytest.raises(ValueError, match=r"steps is .*; it must be an integer in \[0, 2147483647\]"):
            sim.run(steps, 0.01)


@pytest.mark.parametrize("dt", [1e39, "0.01", 1e-50])
def test_a_time_step_that_does_not_fit_is_refused(dt):
    with pytest.raises(ValueError, match=r"dt is .*; it (does not fit float32|must be a number)"):
        simulation().step(dt)
    with pytest.raises(ValueError, match=r"dt\[1\] is -0\.01; it must be finite and > 0"):
        simulation().step([0.01, -0.01])


@pytest.mark.parametrize("dt", [9e-19, 2e18, 1e-40])
def test_time_steps_whose_ratio_is_no_number_are_refused(dt):
    """Start impulses are scaled by the ratio of two time steps."""
    sim = simulation()
    limits = r"in \[1e-18, 1e\+18\]"
    with pytest.raises(ValueError, match=f"dt is {re.escape(str(dt))}; it must be {limits} s"):
        sim.step(dt)
    sim.step(0.01)
    contacts = {name: sim.contacts.numpy(name)[:0] for name in ("key", "impulse", "color", "age")}
    with pytest.raises(ValueError, match=rf"contact_dt\[1\] is .*; it must be 0, or {limits}"):
        sim.restore_contacts([0, 0], contacts, [0.0, dt])


def test_settings_of_another_type_leave_those_there_are():
    sim = simulation()
    before = sim.config
    with pytest.raises(TypeError, match="config is a str; it must be a SolverConfig"):
        sim.config = "adaptive"
    assert sim.config is before


@pytest.mark.parametrize("color", [-2, COLORS, 100_000])
def test_restored_colours_lie_in_the_mask(color):
    sim = simulation()
    sim.run(100, 0.01)
    count = sim.contacts.numpy("contact_count").copy()
    slots, _ = dc.contact_slots(sim.contacts)
    arrays = {name: sim.contacts.numpy(name)[slots].copy() for name in ("key", "impulse", "color", "age")}
    arrays["color"][1] = color
    with pytest.raises(ValueError, match=rf"color\[1\] is {color}; it must be in \[-1, {COLORS - 1}\]"):
        sim.restore_contacts(count, arrays, np.full(2, 0.01))


def test_what_is_read_only_is_not_written_to():
    points, values = np.ones((3, 2), np.float32), np.ones((3, 1), np.float32)
    image = np.zeros((1, 1, 8, 8), np.float32)
    image.flags.writeable = False
    with pytest.raises(ValueError, match="out is read-only; it must be writable"):
        dc.splat(points, values, dc.Grid(rows=8, columns=8, spacing=0.5), out=image)


@pytest.mark.parametrize("backend", ["warp", "numpy"])
def test_a_world_that_met_nan_is_named_and_revived(backend):
    builder = dc.ModelBuilder()
    for _ in range(2):
        builder.add_world()
        builder.add_discs([(0, 0), (3, 0)], 0.5)
    sim = dc.Simulation(*builder.finalize(backend=backend))
    assert repr(sim) == f"<Simulation of 2 worlds and 4 bodies, float32, {backend} on cpu>"
    sim.state.numpy("velocity")[2] = np.nan
    sim.run(3, 0.01)
    assert sim.state.numpy("flags").tolist() == [0, dc.Flag.NONFINITE]
    assert "stopped: world 1 (NONFINITE)" in repr(sim) and "world 1: stopped (NONFINITE)" in sim.explain()
    assert sim.state.numpy("time") == pytest.approx([0.03, 0.0])

    sim.state.assign("velocity", np.nan_to_num(sim.state.numpy("velocity")))
    sim.state.assign("flags", np.zeros(2))
    sim.run(3, 0.01)
    assert not sim.state.numpy("flags").any() and "stopped" not in repr(sim) + sim.explain()
    assert sim.state.numpy("time") == pytest.approx([0.06, 0.03])
    assert (sim.state.numpy("velocity")[2:, 1] < -0.2).all()  # it falls


@pytest.mark.parametrize("on_overflow", ["grow", "raise"])
@pytest.mark.parametrize("flag", [dc.Flag.PAIR_OVERFLOW, dc.Flag.CONTACT_OVERFLOW, dc.Flag.ROW_OVERFLOW])
def test_a_flag_of_room_that_was_set_by_hand_costs_no_step(flag, on_overflow):
    sim, alone = simulation(on_overflow=on_overflow), simulation()
    for one in (sim, alone):
        one.run(60, 0.01)
    sim.state.numpy("flags")[1] = flag
    for one in (sim, alone):
        one.run(10, 0.01)
    assert not sim.state.numpy("flags").any()
    for name in ("position", "velocity", "time"):
        np.testing.assert_array_equal(sim.state.numpy(name), alone.state.numpy(name))
