"""The kernels of sleep do what the oracle does."""

import dataclasses

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels.stages import SLEEP, of_phase
from tests.parity.test_parity import Pair
from tests.sleep.yard import DT, EVERY, LINK, LINKED, SHELF, SLEEP_CONFIG, SOFT, asleep_in, simulation, yard


def test_backends_without_the_kernels_say_who_has_them():
    builder = dc.ModelBuilder()
    yard(builder)
    arrays = builder.finalize(backend="taichi")
    with pytest.raises(ValueError, match=r"no kernels of sleep\.wake; it must be one of \('warp', 'numpy'\)"):
        dc.Simulation(*arrays, config=SLEEP_CONFIG)
    sim = dc.Simulation(*arrays)
    with pytest.raises(ValueError, match=r"no kernels of sleep\.wake"):
        sim.config = SLEEP_CONFIG
    assert not sim.config.sleep


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_kernels_agree_with_the_oracle(dtype):
    sim = simulation(2, dataclasses.replace(SLEEP_CONFIG, acceleration="none"), dtype=dtype)
    sim.run(4, DT)
    assert not sim.asleep.any()
    pair, own = Pair(sim), {stage.kernel for stage in SLEEP}
    sim.state.worlds("velocity")[1, list(LINKED)] = (8.0, 0.0)
    for k in range(48):
        if k == 40:
            assert sim.sleepers.numpy("dormant").tolist() == [1, 0]
            sim.state.numpy("position")[SHELF] += 0.01
        sim.storage.integrator.set_time_step(DT)
        for phase in ("collide", "solve", "advance"):
            for name in of_phase(phase, sleep=True):
                # the others are compared elsewhere, and here where there is something that they must leave alone
                if name in own or k in (0, 40, 47):
                    pair.run(name)
                else:
                    pair.launch(name)
    sleeping = sim.sleepers.numpy("sleeping")
    assert sleeping[0] == 7 and 0 < sleeping[1] < 9


@pytest.mark.parametrize("config", [SLEEP_CONFIG, SOFT])
def test_the_oracle_falls_asleep_and_wakes_alike(config):
    sims = [
        simulation(dtype="float64", backend=backend, config=dataclasses.replace(config, sleep_time=0.1))
        for backend in ("warp", "numpy")
    ]
    for steps, expected in ((12, EVERY), (3, EVERY - LINK)):
        for sim in sims:
            sim.run(steps, 0.02)
            assert asleep_in(sim) == expected
            sim.state.numpy("velocity")[list(LINKED)] = (0.0, 1.0)
    np.testing.assert_allclose(*(sim.state.numpy("position") for sim in sims), atol=1e-9)
