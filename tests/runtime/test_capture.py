"""Calls within ``wp.ScopedCapture`` on the CPU: part of the graph, or refused before anything is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import warp as wp

import dc_kernels as dc
from dc_kernels import delassus

DT = 0.01
STATE = ("position", "angle", "velocity", "angular_velocity", "time")
POINTS = np.random.default_rng(0).uniform(0.0, 3.0, (30, 2))


def simulation(discs=6, backend="warp", **options):
    builder = dc.ModelBuilder()
    for _ in range(2):
        builder.add_world()
        builder.add_chain(builder.add_body(type=dc.BodyType.STATIC), [(0, 9), (0, 0), (9, 0), (9, 9)])
        builder.add_discs([(1.0 + i % 7 * 1.1, 1.0 + i // 7 * 1.1) for i in range(discs)], 0.5)
    return dc.Simulation(*builder.finalize(backend=backend), **options)


def record(call):
    """The graph of a call."""
    with wp.ScopedCapture(device="cpu") as capture:
        call()
    return capture.graph


def replay(graph, times=1):
    for _ in range(times):
        wp.capture_launch(graph)


def assert_same(sim, other):
    for name in STATE:
        np.testing.assert_array_equal(sim.state.numpy(name), other.state.numpy(name))


@pytest.mark.parametrize("warm", [False, True])
@pytest.mark.parametrize("threads", [1, 2])
def test_a_step_becomes_part_of_the_graph(threads, warm):
    sim, alone = simulation(threads=threads), simulation()
    if warm:
        sim.warmup()
    before = sim.state.numpy("position").copy()
    graph = record(lambda: sim.step(DT))
    np.testing.assert_array_equal(sim.state.numpy("position"), before)  # recorded, not run
    replay(graph, 50)
    alone.run(50, DT)
    assert_same(sim, alone)


def test_steps_in_and_out_of_a_graph_mix_with_their_own_time_steps():
    sim, alone = simulation(), simulation()
    graph = record(lambda: sim.run(2, DT))
    for dt in (0.5 * DT, 2.0 * DT):
        sim.step(dt)
        replay(graph)
        alone.step(dt)
        alone.run(2, DT)
    assert_same(sim, alone)


def test_phases_become_part_of_the_graph():
    sim, alone = simulation(), simulation()
    config = replace(sim.config, max_sweeps=7)

    def step():
        sim.collide(DT)
        sim.solve(config)
        sim.advance()

    graph = record(step)
    for _ in range(20):
        replay(graph)
        alone.collide(DT)
        alone.solve(config)
        alone.advance()
    assert_same(sim, alone)


def test_a_graph_leaves_a_world_without_room_to_the_next_step():
    sim, alone = simulation(40, contacts_per_body=0.1, pairs_per_shape=0.2), simulation(40)
    version = sim.layout_version
    replay(record(lambda: sim.step(DT)), 3)
    assert sim.state.numpy("flags").all()
    assert not sim.state.numpy("time").any()
    sim.run(40, DT)
    alone.run(40, DT)
    assert sim.layout_version != version
    assert_same(sim, alone)


def lists(backend="warp"):
    return dc.neighbor_lists(POINTS, POINTS, 0.5, backend=backend)


def problem():
    one = {"row_start": [0, 1], "column": [0], "block": np.eye(2)[None], "q": [[-1.0, 0.5]], "mu": [0.3]}
    return delassus.DelassusProblem(**one)


def collided(**options):
    sim = simulation(**options)
    sim.run(30, DT)
    sim.collide(DT)
    return sim


REFUSED = {
    "start": lambda: (sim := simulation(), lambda: sim.step(DT, start=print)),
    "callback": lambda: (sim := simulation(), lambda: sim.run(1, DT, callback=print)),
    "config": lambda: (sim := simulation(), lambda: setattr(sim, "config", replace(sim.config, max_sweeps=3))),
    "schedule": lambda: (sim := simulation(schedule="color"), lambda: sim.step(DT)),
    "numpy": lambda: (sim := simulation(backend="numpy"), lambda: sim.step(DT)),
    "time steps": lambda: (sim := simulation(), lambda: sim.collide(np.array([DT, 2 * DT]))),
    "pairs": lambda: (None, lambda: dc.neighbor_pairs(POINTS, 0.5)),
    "lists": lambda: (None, lists),
    "density": lambda: (None, lambda: dc.sph_density(POINTS, np.ones(30), 0.5)),
    "Delassus": lambda: (given := problem(), lambda: delassus.solve(given)),
    "from_world": lambda: (sim := collided(), lambda: delassus.from_world(sim)),
    "refine": lambda: (sim := collided(), sim.solve(), lambda: delassus.refine(sim, 1e-9)),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_recorded_is_refused_before_anything_is(name):
    call = REFUSED[name]()[-1]
    with wp.ScopedCapture(device="cpu") as capture, pytest.raises(RuntimeError, match="cannot be recorded in a graph"):
        call()
    assert capture.graph._apic_capture.operation_count == 0


def test_what_was_refused_works_after_the_recording():
    pairs = dc.neighbor_pairs(POINTS, 0.5)
    test_what_cannot_be_recorded_is_refused_before_anything_is("pairs")
    np.testing.assert_array_equal(dc.neighbor_pairs(POINTS, 0.5), pairs)


def test_a_torch_operator_is_refused():
    torch = pytest.importorskip("torch")
    from dc_kernels.torch_ops import transfer

    points, values = torch.from_numpy(POINTS), torch.ones(30, 1, dtype=torch.float64)
    grid = dc.Grid(rows=8, columns=8, spacing=0.5)
    transfer.splat_torch(points, values, grid)
    with wp.ScopedCapture(device="cpu"), pytest.raises(RuntimeError, match="cannot be recorded in a graph"):
        transfer.splat_torch(points, values, grid)
