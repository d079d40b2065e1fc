"""On a GPU: the CPU's results to round-off, the same bits in each schedule, and refusals of what runs on a CPU only."""

from dataclasses import replace

import numpy as np
import pytest
import warp as wp

import dc_kernels as dc
from dc_kernels import delassus, measure
from dc_kernels.runtime.building import start_warp
from dc_kernels.runtime.threads import map_threads
from pipeline.scenes import scene

DT = 0.01
STATE = ("position", "angle", "velocity", "angular_velocity")
SCENES = {"thesis": (2, {}), "mixed": (2, {"bodies": 60}), "pyramid": (1, {}), "chain": (1, {}), "stack": (1, {})}


@pytest.fixture(scope="module")
def gpu():
    """The first CUDA device."""
    start_warp()
    if not wp.is_cuda_available():
        pytest.skip("no CUDA device")
    return "cuda:0"


def simulation(name, device, config=None, worlds=None, dtype="float64", **options):
    count, parameters = SCENES.get(name, (2, {}))
    arrays = scene(name, **parameters).build(worlds or count, 7).finalize(dtype=dtype, device=device)
    return dc.Simulation(*arrays, config=replace(dc.SolverConfig(), **(config or {})), **options)


def assert_close(a, b, bound):
    """The same contacts and sweeps, and states within a bound [m, m/s]."""
    assert (a.contacts.numpy("contact_count") == b.contacts.numpy("contact_count")).all()
    assert (a.stats.numpy("sweeps") == b.stats.numpy("sweeps")).all()
    assert (a.state.numpy("flags") == b.state.numpy("flags")).all()
    for name in STATE:
        np.testing.assert_allclose(a.state.numpy(name), b.state.numpy(name), rtol=0, atol=bound, err_msg=name)


def assert_same(a, b):
    """The same bits."""
    for name in STATE:
        assert (a.state.numpy(name) == b.state.numpy(name)).all(), name


@pytest.mark.parametrize("name", list(SCENES))
def test_steps_are_those_of_the_cpu_to_round_off(gpu, name):
    """A change of the last bit at the start grows as much: to 4e-10 m in 50 steps of the stack, else to 2e-14 m."""
    world, color, cpu = (simulation(name, d, schedule=s) for d, s in ((gpu, "world"), (gpu, "color"), ("cpu", "world")))
    for sim in (world, color, cpu):
        sim.run(50, DT)
    assert cpu.stats.numpy("sweeps").any()
    assert_close(world, cpu, 1e-7 if name == "stack" else 1e-11)
    assert_same(world, color)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("acceleration", ["none", "sor"])
def test_discs_have_the_bits_of_the_cpu_where_nothing_is_summed(gpu, acceleration, dtype):
    """Rows are swept without contraction on both, and discs need neither sine nor cosine."""
    config = {"acceleration": acceleration}
    a, b = (simulation("thesis", device, config, dtype=dtype) for device in (gpu, "cpu"))
    a.run(50, DT)
    b.run(50, DT)
    assert b.contacts.numpy("contact_count").any()
    assert_same(a, b)


@pytest.mark.parametrize(
    "config",
    [
        {"acceleration": "aitken"},
        {"acceleration": "nncg"},
        {"method": "jacobi", "max_sweeps": 60},
        {"stop": "residual"},
    ],
    ids=str,
)
def test_settings_are_those_of_the_cpu(gpu, config):
    a, b = (simulation("mixed", device, config) for device in (gpu, "cpu"))
    a.run(50, DT)
    b.run(50, DT)
    assert_close(a, b, 1e-11)


def test_worlds_grow(gpu):
    few = {"pairs_per_shape": 0.1, "contacts_per_body": 0.1}
    a, b = simulation("settled", gpu, worlds=4, **few), simulation("settled", gpu, worlds=4)
    a.run(5, DT)
    b.run(5, DT)
    assert_same(a, b)
    for room in a.capacity().values():
        assert 0 < room["used"] / 4 <= room["peak_of_a_world"] <= room["reserved"]
    full = simulation("settled", gpu, on_overflow="raise", **few)
    before = full.state.numpy("position")
    with pytest.raises(OverflowError, match="the step was not taken"):
        full.step(DT)
    assert (full.state.numpy("position") == before).all()


def test_simulations_run_on_several_threads(gpu):
    """Warp changes the stream of the device while it copies to the host, which two threads would not undo."""
    stream = wp.get_device(gpu).stream
    sims = [simulation("settled", gpu, worlds=4, threads=2) for _ in range(4)]
    map_threads(lambda sim: sim.run(20, DT), sims[1:], 3)
    sims[0].run(20, DT)
    for sim in sims[1:]:
        assert_same(sim, sims[0])
    assert wp.get_device(gpu).stream is stream


def test_a_solve_pauses_and_goes_on(gpu):
    a, b = simulation("settled", gpu), simulation("settled", gpu, {"acceleration": "aitken"})
    for sim in (a, b):
        sim.collide(DT)
    a.solve(pause=10)
    assert a.running.any()
    while a.running.any():
        a.resume(pause=10)
    b.solve()
    a.advance()
    b.advance()
    assert_same(a, b)


def test_a_snapshot_goes_on_with_the_same_bits(gpu, tmp_path):
    a = simulation("mixed", gpu)
    a.run(20, DT)
    a.save(tmp_path / "gpu.h5")
    b = dc.Simulation.load(tmp_path / "gpu.h5")
    assert b.device == gpu
    a.run(10, DT)
    b.run(10, DT)
    assert_same(a, b)


def test_what_a_gpu_cannot_do_is_refused(gpu):
    sim = simulation("settled", gpu)
    sim.collide(DT)
    problem = delassus.from_world(sim, 0)
    sim.solve()
    points = wp.zeros((4, 2), dtype=wp.float64, device=gpu)
    grid = dc.Grid(rows=8, columns=8, spacing=0.5)
    calls = (
        lambda: dc.Images(sim, dc.ImageSpec(grid)),
        lambda: dc.splat(points, np.ones((4, 1)), grid),
        lambda: dc.gather(wp.zeros((1, 1, 8, 8), dtype=wp.float64, device=gpu), np.zeros((4, 2)), grid),
        lambda: dc.neighbor_pairs(points, 0.5),
        lambda: dc.sph_density(points, np.ones(4), 0.5),
        lambda: dc.choose_grid(points, lower=(0.0, 0.0), upper=(1.0, 1.0)),
        lambda: delassus.refine(sim, 1e-10),
        lambda: delassus.write_impulses(sim, 0, problem, delassus.solve(problem)),
        lambda: delassus.solve(problem, start=points),
    )
    for call in calls:
        with pytest.raises(ValueError, match=r"cuda:0.*CPU|CPU.*cuda:0"):
            call()
    sim.advance()
    before = sim.state.numpy("position")
    with wp.ScopedCapture(device=gpu), pytest.raises(RuntimeError, match="cannot be recorded in a graph"):
        sim.step(DT)
    assert (sim.state.numpy("position") == before).all()
    sim.step(DT)
    assert (sim.state.numpy("position") != before).any()
    assert np.isfinite(measure.kinetic_energy(sim)).all()
