"""Belts that carry, platforms that hold from one side."""

import numpy as np
import pytest

import dc_kernels as dc
from pipeline.scenes import scene

DT = 0.01


@pytest.mark.parametrize("slope", [0.0, 0.15])
def test_what_lies_on_a_belt_reaches_its_speed_and_then_the_bin(slope):
    """Friction pulls a crate by (mu cos - sin) g t until it has the speed of the belt, which it keeps."""
    mu, speed = 0.4, 2.0
    conveyor = scene("conveyor", bodies=5, friction=mu, speed=speed, slope=slope)
    sim = dc.Simulation(*conveyor.build().finalize("float64"))
    crates = np.flatnonzero(sim.model.numpy("inv_mass"))
    pull = (mu * np.cos(slope) - np.sin(slope)) * conveyor.gravity
    for step in range(1, 90):
        sim.step(DT)
        found = sim.state.numpy("velocity")[crates[:-1]] @ [np.cos(slope), np.sin(slope)]  # the last one falls off soon
        assert found == pytest.approx(4 * [min(pull * step * DT, speed)], rel=1e-2)
    sim.run(2000, DT)
    x, y = sim.state.numpy("position")[crates].T
    assert y.max() < -1.0 * conveyor.size and y.min() > -12.5 * conveyor.size
    assert x.max() < 2.0 * conveyor.size and x.min() > -5.0 * conveyor.size
    assert abs(sim.state.numpy("velocity")[crates]).max() < 0.1


def test_what_is_thrown_up_comes_to_lie_on_platforms_and_ground():
    """Nothing is lost through a platform or the ground, whatever threw it through them."""
    platforms = scene("platforms", bodies=12)
    sim = dc.Simulation(*platforms.build(2, 3).finalize("float64"))
    bodies = np.flatnonzero(sim.model.numpy("inv_mass"))
    below = sim.state.numpy("position")[bodies, 1] < 0.0
    assert below.sum() == 6
    sim.run(60, DT)
    assert (sim.state.numpy("position")[bodies, 1] > 0.0).all()  # all have passed the ground
    sim.run(400, DT)
    y = sim.state.numpy("position")[bodies, 1]
    assert y.min() > 0.5 * platforms.size
    assert (np.bincount((y / platforms.height).astype(int), minlength=4)[:3] > 0).all()  # some lie on each level
    boxes = bodies.reshape(2, -1)[:, ::2]  # discs may roll on
    assert abs(sim.state.numpy("velocity")[boxes]).max() < 0.05
