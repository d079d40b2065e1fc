"""Where a solve stops: the absolute tolerance, or what a typical body's weight gives in a step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels.solve.iteration import ASKEW, FAR, SCARCE
from dc_kernels.solve.rows import COLUMNS, LANES
from pipeline.scenes import Thesis
from tests.backends import NEEDS_TAICHI

DT = 0.01


def stack(side: float, dtype: str = "float32", **config) -> dc.Simulation:
    """Ten boxes of that side [m] and 1 kg/m^2 on a floor."""
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0.0, -9.8))
    builder.add_box(builder.add_body((0.0, -side), type=dc.BodyType.STATIC), 50 * side, side)
    for k in range(10):
        builder.add_box(builder.add_body((0.0, side * (k + 0.5))), side / 2, side / 2)
    return dc.Simulation(*builder.finalize(dtype), config=dc.SolverConfig(**config))


def drift(sim: dc.Simulation, side: float, dt: float, steps: int = 300) -> float:
    """How far a body has moved, relative to its side."""
    before = sim.state.numpy("position").copy()
    sim.run(steps, dt)
    return float(np.abs(sim.state.numpy("position") - before).max() / side)


@pytest.mark.parametrize(("side", "dt"), [(1.0, DT), (0.1, DT), (0.01, 0.003), (1e-3, 1e-3)])
def test_light_bodies_rest_at_the_default_settings(side, dt):
    """To 1e-4 N s alone, boxes of 10 g and less fall through each other; ten slops are 0.005 of the drift."""
    assert drift(stack(side), side, dt) < 0.05


def test_without_it_only_the_tolerance_counts():
    assert drift(stack(0.1, relative_tolerance=float("inf"), min_sweeps=1), 0.1, DT) > 1.0


@pytest.mark.parametrize("schedule", ["world", "color"])
def test_the_smaller_bound_ends_a_solve(schedule):
    """By the change that is reported: below the bound, and above it a sweep before."""
    sims = [stack(0.3, "float64", tolerance=1e-3, max_sweeps=5000, relative_tolerance=r) for r in (1e-3, 1e-6)]
    for sim in sims:
        vars(sim)["schedule"] = schedule
        weight = 0.3**2 * 9.8
        np.testing.assert_allclose(sim.motion.numpy("weight"), weight)
        sim.collide(DT)
        sim.contacts.numpy("impulse")[...] = 0.0
        sim.solve()
        assert sim.stats.numpy("change")[0] < sim.config.ends_at[2] * weight * DT
    few, many = (int(sim.stats.numpy("sweeps")[0]) for sim in sims)
    assert few < many < 5000


def test_weight_is_the_geometric_mean_of_what_moves():
    builder = dc.ModelBuilder()
    for gravity in ((0.0, -10.0), (3.0, 4.0), (0.0, 0.0), (0.0, -9.8)):
        builder.add_world(gravity=gravity)
        builder.add_disc(builder.add_body((0.0, -9.0), type=dc.BodyType.STATIC), 1.0)
        if gravity[1] != -9.8:
            for i, mass in enumerate((1.0, 100.0)):
                builder.add_disc(builder.add_body((3.0 * i, 0.0), mass=mass), 1.0)
    sim = dc.Simulation(*builder.finalize("float64"))
    np.testing.assert_allclose(sim.motion.numpy("weight"), [100.0, 50.0, 0.0, 0.0])
    sim.run(3, DT)


def test_the_theses_discs_are_solved_to_their_tolerance():
    """The relative bound lies above 1e-4 N s there, so not a bit changes."""
    bits = []
    for relative in (None, float("inf")):
        config = dc.SolverConfig.preset("accurate", relative_tolerance=relative)
        sim = dc.Simulation(*Thesis(bodies=30).build(2, 0).finalize(), config=config)
        sim.run(100, DT)
        bits.append(sim.state.numpy("position").tobytes())
    assert bits[0] == bits[1]


@pytest.mark.parametrize(("stop", "most", "sweeps"), [("change", 1000, 12), ("residual", 1000, 15), ("change", 4, 4)])
def test_every_solve_takes_its_least_number_of_sweeps(stop, most, sweeps):
    """Though the start is the solution; never more than the cap, and at the residual's next look."""
    sim = stack(1.0, "float64", tolerance=1e-3, min_sweeps=12, max_sweeps=most, stop=stop)
    sim.run(200, DT)
    assert sim.stats.numpy("sweeps")[0] == sweeps


def test_what_rests_lies_still():
    """What a step leaves is met by the next: with one sweep where that is enough for the tolerance, a stack creeps."""
    creep = []
    for least in (1, 10):
        sim = stack(1.0, min_sweeps=least)
        sim.run(900, DT)
        creep.append(drift(sim, 1.0, DT, 100))
    assert creep[1] < 0.05 * creep[0]


def still(sim: dc.Simulation) -> tuple[int, int, bool]:
    """Contacts that the last sweep moved, contacts that can move, and whether it moved one far, by the formula."""
    config, columns = sim.config, COLUMNS[sim.variant]
    block = sim.rows.numpy("color_block")
    blocks = slice(int(block[0]), int(block[-1]))
    column = sim.rows.numpy("column").reshape(-1, len(columns), LANES)[blocks].astype(np.float64)
    change = np.abs(sim.rows.numpy("change").reshape(-1, 2, LANES)[blocks].astype(np.float64))
    bodies = sim.rows.numpy("body").reshape(-1, 2, LANES)[blocks]
    given = (sim.motion.numpy("solved") - sim.motion.numpy("predicted"))[:, :2].astype(np.float64)
    gravity = float(np.hypot(*sim.model.numpy("gravity")[0]))
    beyond = np.maximum(np.abs(given).max(axis=1)[bodies].max(axis=1) - 1.5 * gravity * DT, 0.0)
    slop = config.slop * float(sim.model.numpy("length_scale")[0])
    size = np.abs(given).max(axis=1)
    touched = size > 0
    weight = 1.0 / sim.motion.numpy("solved")[touched, 3].astype(np.float64)
    mean = (weight * np.maximum(size[touched] - 1.5 * gravity * DT, 0.0)).sum() / weight.sum()
    rise = 2.0 * float(np.abs(sim.motion.numpy("predicted")[: sim.model.body_count, :2]).max())
    share = np.maximum(config.motion_share * np.minimum(beyond, rise), config.motion_mean * min(mean, rise))
    limit = config.motion_tolerance * slop / DT + share
    mass = column[:, [columns.index("en"), columns.index("et")]]
    excess = np.divide(change, limit[:, None] * mass, out=np.zeros_like(change), where=mass > 0).max(axis=1)
    return int((excess > 1.0).sum()), int((mass[:, 0] > 0).sum()), bool((excess > FAR).any())


@pytest.mark.parametrize(("schedule", "preset"), [("world", "default"), ("color", "default"), ("world", "strict")])
def test_motion_ends_a_solve_where_few_contacts_still_move(schedule, preset):
    """In steps of an impact: where a solve ends the criterion holds, and five sweeps before it did not."""
    config = dc.SolverConfig.preset(preset, acceleration="none")
    sim = dc.Simulation(*Thesis(bodies=60).build(1, 3).finalize("float64"), config=config, schedule=schedule)
    sim.run(80, DT)
    bound = min(1e-4, 1.3e-3 * float(sim.motion.numpy("weight")[0]) * DT)
    looked = 0
    for _ in range(12):
        sim.collide(DT)
        start = sim.contacts.numpy("impulse").copy()
        sim.solve()
        sweeps = int(sim.stats.numpy("sweeps")[0])
        if 10 < sweeps < 1000 and sim.stats.numpy("change")[0] > bound:
            moving, able, far = still(sim)
            assert sweeps % 5 == 0 and 10 * moving <= able and not far
            sim.contacts.numpy("impulse")[...] = start
            sim.solve(replace(config, max_sweeps=sweeps - 5))
            moving, able, far = still(sim)
            assert 10 * moving > able or far
            sim.contacts.numpy("impulse")[...] = start
            sim.solve()
            looked += 1
        sim.advance()
    assert looked > 5


@pytest.mark.parametrize(
    ("backend", "schedule"),
    [("warp", "world"), ("warp", "color"), ("numpy", "world"), pytest.param("taichi", "world", marks=NEEDS_TAICHI)],
)
def test_of_thousands_of_contacts_a_few_may_be_far(backend, schedule, monkeypatch):
    """A heavy disc on a light one, whose contacts take long: alone, and beside 15 000 discs.

    They are solved all the same where they are too far, or one disc is far heavier than the other.
    """
    others = 3 * SCARCE
    if backend == "numpy":  # which takes minutes for that many
        monkeypatch.setattr("dc_kernels._numpy.solve.world.SCARCE", SCARCE // 100)
        others //= 100
    found = []
    for mass, pull, beside in ((9.0, 29.4, 0), (9.0, 29.4, others), (9.0, 98.0, others), (60.0, 9.8, others)):
        builder = dc.ModelBuilder()
        builder.add_world(gravity=(0.0, -pull))
        builder.add_box(builder.add_body((9_000.0, -1.0), type=dc.BodyType.STATIC), 9_100.0, 1.0)
        builder.add_disc(builder.add_body((0.0, 0.5), mass=1.0), 0.5)
        builder.add_disc(builder.add_body((0.0, 1.5), mass=mass), 0.5)
        if beside:
            builder.add_discs([(1.2 * (k + 2), 0.5) for k in range(beside)], 0.5)
        config = dc.SolverConfig(acceleration="none")
        sim = dc.Simulation(*builder.finalize(backend=backend), config=config, schedule=schedule)
        sim.collide(DT)
        start = sim.contacts.numpy("impulse").copy()
        sim.solve()
        found.append(int(sim.stats.numpy("sweeps")[0]))
        sim.contacts.numpy("impulse")[...] = start
        sim.solve(replace(config, motion_mean=0.0))  # the preset "strict"
        assert sim.stats.numpy("sweeps")[0] > 10
    assert found[0] > 10 and found[1] == 10 and found[2] > 10 and found[3] > 10


@pytest.mark.parametrize(("backend", "schedule"), [("warp", "world"), ("warp", "color"), ("numpy", "world")])
def test_speeds_that_no_body_had_make_no_change_small(backend, schedule):
    """Discs at rest that overlap are given theirs by the solve alone, as light ones are that a wrong start throws."""
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0.0, 0.0))
    builder.add_discs([(0.9 * (k % 5 + 0.5 * (k // 5 % 2)), 0.8 * (k // 5)) for k in range(25)], 0.5)
    config = dc.SolverConfig(position_correction="baumgarte", acceleration="none")
    sim = dc.Simulation(*builder.finalize("float64", backend=backend), config=config, schedule=schedule)
    sim.collide(DT)
    sim.solve()
    moving, able, far = still(sim)
    assert 10 * moving <= able and not far and np.abs(sim.motion.numpy("solved")).max() > 1.0


@pytest.mark.parametrize(("backend", "schedule"), [("warp", "world"), ("warp", "color"), ("numpy", "world")])
def test_no_solve_ends_by_motion_far_from_its_solution(backend, schedule):
    """A tower hits the floor: as the shock has to go up box by box, ten sweeps leave most of it unsolved."""
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0.0, -9.8))
    builder.add_box(builder.add_body((0.0, -1.0), type=dc.BodyType.STATIC), 50.0, 1.0)
    for k in range(12):
        builder.add_box(builder.add_body((0.0, k + 0.5), velocity=(0.0, -5.0)), 0.5, 0.5)
    config = dc.SolverConfig(motion_tolerance=1e9, acceleration="none")  # any change of speed counts as none
    sim = dc.Simulation(*builder.finalize("float64", backend=backend), config=config, schedule=schedule)
    sim.collide(DT)
    found = []
    for most in (10, 1000):
        sim.contacts.numpy("impulse")[...] = 0.0
        sim.solve(replace(config, max_sweeps=most))
        found.append((int(sim.stats.numpy("sweeps")[0]), float(sim.stats.numpy("residual")[0])))
    (few, early), (sweeps, residual) = found
    assert few == 10 and early > ASKEW
    assert sweeps == 15 and residual < ASKEW


def test_what_ends_a_solve_is_what_was_asked_for():
    """A tolerance that is given is kept to, and else a solve ends by motion."""
    assert dc.SolverConfig().ends_at == ("motion", 1e-4, 1.3e-3)
    assert dc.SolverConfig(tolerance=1e-4).ends_at == ("change", 1e-4, 1.3e-3)
    assert dc.SolverConfig(relative_tolerance=1e-5).ends_at == ("change", 1e-4, 1e-5)
    assert dc.SolverConfig(stop="residual").ends_at == ("residual", 1e-4, 1.3e-3)
    assert dc.SolverConfig(stop="motion", tolerance=1e-8).ends_at == ("motion", 1e-8, 1.3e-3)


def test_presets():
    assert dc.SolverConfig.preset("default") == dc.SolverConfig()
    with pytest.raises(TypeError, match=r"no setting 'maxsweeps' \(did you mean max_sweeps"):
        dc.SolverConfig.preset("fast", maxsweeps=3)
    assert dc.SolverConfig.preset("strict") == dc.SolverConfig(motion_mean=0.0)
    assert dc.SolverConfig.preset("accurate").ends_at[0] == "change"
    assert dc.SolverConfig.preset("fast", min_sweeps=3) == dc.SolverConfig(max_sweeps=10, min_sweeps=3)
    thesis = dc.SolverConfig.preset("thesis")
    assert (thesis.acceleration, thesis.slop, thesis.speculative_max, thesis.min_sweeps) == ("none", 5e-3, 0.0, 1)
    with pytest.raises(ValueError, match="preset is 'best'"):
        dc.SolverConfig.preset("best")
    with pytest.raises(ValueError, match=r"SolverConfig\.min_sweeps is 100; the preset 'fast' allows 10 sweeps"):
        dc.SolverConfig.preset("fast", min_sweeps=100)
    assert dc.SolverConfig.preset("fast", min_sweeps=100, max_sweeps=200).max_sweeps == 200


def test_a_pile_overlaps_little_more_than_where_it_is_solved_to_the_tolerance():
    """An impact of 300 discs: by less than a tenth of the slop, at the default a quarter, in far fewer sweeps."""
    found = {}
    for preset in ("accurate", "strict", "default"):
        sim = dc.Simulation(*Thesis(bodies=300).build(1, 5).finalize(), config=dc.SolverConfig.preset(preset))
        overlaps, sweeps = [], 0
        for _ in range(20):
            sim.run(10, DT)
            overlaps.append(float(dc.measure.overlap(sim, DT).mean[0]))
            sweeps += int(sim.stats.numpy("sweeps")[0])
        found[preset] = np.mean(overlaps), sweeps
    assert found["strict"][0] < found["accurate"][0] + 5e-4 / 10
    assert found["strict"][1] < 0.6 * found["accurate"][1]
    assert found["default"][0] < found["accurate"][0] + 5e-4 / 4
    assert found["default"][1] < 0.6 * found["strict"][1]


def test_impacts_elsewhere_leave_a_stack_in_peace():
    """Ten boxes on each other beside 60 discs that fall: they lean by at most two millimetres more."""
    leans, sweeps = [], []
    for preset in ("strict", "default"):
        builder = Thesis(bodies=60).build(1, 3)
        builder.add_box(builder.add_body((-40.0, -1.0), type=dc.BodyType.STATIC), 5.0, 1.0)
        tower = [builder.add_body((-40.0, 0.5 + i)) for i in range(10)]
        for body in tower:
            builder.add_box(body, 0.5, 0.5)
        sim = dc.Simulation(*builder.finalize(), config=dc.SolverConfig.preset(preset))
        before = sim.state.numpy("position")[tower].copy()
        taken = 0
        for _ in range(120):
            sim.step(DT)
            taken += int(sim.stats.numpy("sweeps")[0])
        leans.append(np.abs(sim.state.numpy("position")[tower] - before).max())
        sweeps.append(taken)
    assert leans[1] < leans[0] + 2e-3
    assert sweeps[1] < 0.8 * sweeps[0]  # there were impacts


@pytest.mark.parametrize("backend", ["warp", "numpy"])
def test_what_weighs_nothing_is_solved_at_any_size(backend):
    """A row of boxes that another one hits: by an impulse of 1e-4 N s those of a gram are at 0.1 m/s."""
    found = []
    for size in (1.0, 1.0 / 64):  # a power of four, times and speeds by its root: the same bits
        root = size**0.5
        builder = dc.ModelBuilder()
        builder.add_world(gravity=(0.0, 0.0))
        for k in range(12):
            body = builder.add_body((k * size, 0.0), velocity=(-8.0 * root * (k == 11), 0.0))
            builder.add_box(body, size / 2, size / 2)
        sim = dc.Simulation(*builder.finalize(backend=backend))
        sim.step(root / 64)
        found.append(sim.state.numpy("velocity") / root)
    assert (found[0] == found[1]).all()
    assert (found[0][:, 0] < -0.4).all()


@pytest.mark.parametrize("backend", ["warp", "numpy"])
def test_a_world_with_joints_is_solved_to_the_tolerance(backend):
    """What a joint lacks shows as stretch, so motion does not end its solve."""
    sweeps = []
    for stop in ("change", "motion"):
        builder = dc.ModelBuilder()
        builder.add_world(gravity=(0.0, -9.8))
        bodies = [builder.add_body((0.0, 0.0), type=dc.BodyType.STATIC)]
        for i in range(8):
            bodies.append(builder.add_body((0.0, -float(i + 1))))
            builder.add_disc(bodies[-1], 0.1, density=1.0 if i < 7 else 1000.0)
            builder.add_distance_joint(bodies[-2], bodies[-1])
        model, state, joints = builder.finalize(backend=backend)
        sim = dc.Simulation(model, state, joints, config=dc.SolverConfig(stop=stop, acceleration="none"))
        sim.step(DT)
        sweeps.append(int(sim.stats.numpy("sweeps")[0]))
    assert sweeps[0] == sweeps[1] > 50
