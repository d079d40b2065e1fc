"""Where a solve stops: the absolute tolerance, or what a typical body's weight gives in a step."""

from __future__ import annotations

import numpy as np
import pytest

import dc_kernels as dc
from pipeline.scenes import Thesis

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
        sim.schedule = schedule
        weight = 0.3**2 * 9.8
        np.testing.assert_allclose(sim.motion.numpy("weight"), weight)
        sim.collide(DT)
        sim.contacts.numpy("impulse")[...] = 0.0
        sim.solve()
        assert sim.stats.numpy("change")[0] < sim.config.relative_tolerance * weight * DT
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
    for relative in (dc.SolverConfig().relative_tolerance, float("inf")):
        config = dc.SolverConfig(relative_tolerance=relative)
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
