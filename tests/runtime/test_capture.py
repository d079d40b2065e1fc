"""Calls within ``wp.ScopedCapture`` on the CPU: part of the graph, or refused before anything is."""

from __future__ import annotations

import gc
from dataclasses import replace

import numpy as np
import pytest
import warp as wp

import dc_kernels as dc
from dc_kernels import delassus
from dc_kernels.grid import splat as splats
from dc_kernels.model.fields import SCRATCH

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


def test_a_graph_goes_on_with_memory_of_its_own_after_a_change_of_settings():
    builder = dc.ModelBuilder()
    builder.add_world()
    for i in range(8):  # pairs of boxes are recycled
        builder.add_box(builder.add_body((0.0, 1.05 * i), type=dc.BodyType(2 * (i > 0))), 0.5 + 2.0 * (i == 0), 0.5)
    sim, alone = (dc.Simulation(*builder.finalize()) for _ in range(2))
    graph = record(lambda: sim.step(DT))
    version, sim.config = sim.layout_version, replace(sim.config, max_sweeps=7)
    gc.collect()
    others = [np.zeros(SCRATCH + 64 * k, np.uint8) for k in range(3) for _ in range(300)]
    replay(graph, 20)
    assert sim.layout_version == version and not any(other.any() for other in others)
    alone.run(20, DT)
    assert_same(sim, alone)


def test_what_is_recorded_leaves_the_turn_of_what_runs():
    """A recorded phase has not run: the simulation takes no solve for granted that only a graph holds."""
    sim, alone = simulation(), simulation()
    collide = record(lambda: sim.collide(DT))
    assert sim.phase == "advance"
    with pytest.raises(ValueError, match="needs collide"):
        sim.solve()
    replay(collide)
    solve = record(lambda: (sim.solve(), sim.advance()))  # follows the recorded one
    assert sim.phase == "advance"
    replay(solve)
    sim.collide(DT)
    step = record(lambda: sim.step(DT))
    assert sim.phase == "collide"
    sim.solve()
    advance = record(sim.advance)  # follows the solve that ran
    assert sim.phase == "solve"
    replay(advance)
    replay(step)
    alone.run(3, DT)
    assert_same(sim, alone)


def test_what_is_recorded_out_of_turn_is_refused():
    sim = simulation()
    for call in (sim.solve, sim.resume, sim.advance):
        with pytest.raises(ValueError, match="needs"):
            record(call)
    record(lambda: sim.step(DT))
    with pytest.raises(ValueError, match="needs collide"):
        record(sim.solve)


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


GRID = dc.Grid(rows=17, columns=19, spacing=0.25)


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("normalize", ["particle", "shepard"])
@pytest.mark.parametrize("size", ["small", "large"])
def test_a_splat_becomes_part_of_the_graph(monkeypatch, size, normalize, threads):
    """Large images, which go tile by tile, are recorded without tiles; the image is written anew at each replay."""
    monkeypatch.setattr(splats, "TILED_BYTES", 0 if size == "large" else 2**23)
    points, values = POINTS.copy(), np.ones((30, 1))
    out = np.full((2, 1, 17, 19), 7.0)
    options = {"start": [0, 11, 30], "stencil": dc.Stencil(normalize=normalize), "threads": threads}
    graph = record(lambda: dc.splat(points, values, GRID, out=out, **options))
    assert (out == 7.0).all()
    for step in range(3):
        points += 0.3
        values *= 1.5
        if step < 2:
            out[...] = 7.0
        replay(graph)
        np.testing.assert_array_equal(out, dc.splat(points, values, GRID, **options))


def test_what_a_recorded_splat_needs_lives_as_long_as_the_graph():
    points = POINTS.copy()
    found = []
    graph = record(lambda: found.append(dc.splat(points, np.ones((30, 1)), GRID)))
    gc.collect()
    filler = [np.full(30, 1e30) for _ in range(100)]
    replay(graph)
    np.testing.assert_array_equal(found[0], dc.splat(points, np.ones((30, 1)), GRID))
    assert len(filler) == 100


@pytest.mark.parametrize("threads", [1, 2])
def test_a_gather_becomes_part_of_the_graph(threads):
    points, image = POINTS.copy(), np.random.default_rng(1).normal(size=(2, 3, 17, 19))
    out = np.zeros((30, 3))
    options = {"start": [0, 11, 30], "threads": threads}
    graph = record(lambda: dc.gather(image, points, GRID, out=out, **options))
    assert not out.any()
    for _ in range(2):
        points += 0.3
        image *= 2.0
        replay(graph)
        np.testing.assert_array_equal(out, dc.gather(image, points, GRID, **options))


def test_images_of_a_simulation_become_part_of_the_graph():
    """Step, splat, impulses and a start from an image, as one graph."""
    sims = [simulation(20), simulation(20)]
    images = [dc.Images(sim, dc.ImageSpec(GRID)) for sim in sims]
    given = np.random.default_rng(2).normal(scale=1e-3, size=(2, 2, 17, 19)).astype(np.float32)

    def step(sim, image):
        sim.collide(DT)
        image.start_from(given)
        sim.solve()
        sim.advance()
        return image.splat(), image.impulse_image(), image.gather(given, at="bodies")

    for sim, image in zip(sims, images):
        sim.run(60, DT)
        for call in (image.splat, image.impulse_image):
            call()
    found = []
    graph = record(lambda: found.extend(step(sims[0], images[0])))
    for _ in range(5):
        replay(graph)
        wanted = step(sims[1], images[1])
        for a, b in zip(found, wanted):
            np.testing.assert_array_equal(dc.to_numpy(a), dc.to_numpy(b))
    assert_same(*sims)
    assert dc.to_numpy(found[1]).any()


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


def bound_splat():
    """A splat by tiles that was bound before the recording."""
    points = dc.Transfer(dc.Grid(rows=2001, columns=2001, spacing=0.0075)).at(POINTS)
    return points.splat(np.ones((30, 1)), np.zeros((1, 1, 2001, 2001)))


def reverse_gather_of_images():
    images = dc.Images(simulation(), dc.ImageSpec(GRID))
    return lambda: images.gather(np.ones((2, 1, 17, 19), np.float32), at="bodies", reverse=True)


def reverse_gather():
    return dc.gather(np.ones((1, 1, 17, 19)), POINTS, GRID, dc.Stencil(), reverse=True)


REFUSED = {
    "start": lambda: (sim := simulation(), lambda: sim.step(DT, start=print)),
    "callback": lambda: (sim := simulation(), lambda: sim.run(1, DT, callback=print)),
    "config": lambda: (sim := simulation(), lambda: setattr(sim, "config", replace(sim.config, max_sweeps=3))),
    "schedule": lambda: (sim := simulation(schedule="color"), lambda: sim.step(DT)),
    "numpy": lambda: (sim := simulation(backend="numpy"), lambda: sim.step(DT)),
    "time steps": lambda: (sim := simulation(), lambda: sim.collide(np.array([DT, 2 * DT]))),
    "tiles": lambda: (bound_splat(),),
    "reverse gather": lambda: (reverse_gather,),
    "reverse gather of images": lambda: (reverse_gather_of_images(),),
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
