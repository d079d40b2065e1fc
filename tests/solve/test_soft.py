"""Substeps, and the method that takes them with soft contacts."""

import dataclasses

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels.model.config import check_awake
from dc_kernels.runtime.threads import usable_cores
from dc_kernels.solve.rows import SERIAL_COLOR
from tests.parity.scenes import bounce, discs, pendulum, simulation, surfaces

SOFT = dc.SolverConfig(method="tgs_soft", substeps=4)
DT = 1 / 60
G = 9.8


def boxes(backend="warp", count=5, config=SOFT):
    """A stack at rest."""
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0.0, -G))
    builder.add_box(builder.add_body(type=dc.BodyType.STATIC), 20.0, 0.5, center=(0.0, -0.5))
    for i in range(count):
        builder.add_box(builder.add_body((0.0, 0.5 + i)), 0.5, 0.5)
    return dc.Simulation(*builder.finalize("float64", backend=backend), config=config)


def disc(config, backend="warp", gravity=0.0, velocity=-3.0, height=1.5, restitution=0.0):
    """A disc above a floor."""
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0.0, -gravity))
    builder.add_box(builder.add_body(type=dc.BodyType.STATIC), 20.0, 0.5, center=(0.0, -0.5))
    builder.add_disc(builder.add_body((0.0, height), velocity=(0.0, velocity)), 0.5, restitution=restitution)
    return dc.Simulation(*builder.finalize("float64", backend=backend), config=config)


@pytest.mark.parametrize("method", ["pgs", "tgs_soft"])
@pytest.mark.parametrize("n", [1, 3, 8])
def test_a_free_fall_is_that_of_its_substeps(method, n):
    """Semi-implicit Euler falls by g h^2 k (k + 1) / 2 in k steps of h."""
    config = dc.SolverConfig(method=method, substeps=n)
    sim = disc(config, "numpy", gravity=G, velocity=0.0, height=50.0)
    sim.run(5, DT)
    k, h = 5 * n, DT / n
    np.testing.assert_allclose(sim.state.numpy("position")[1, 1], 50.0 - G * h * h * k * (k + 1) / 2, rtol=1e-13)
    np.testing.assert_allclose(sim.state.numpy("velocity")[1, 1], -G * 5 * DT, rtol=1e-13)
    np.testing.assert_allclose(sim.state.numpy("time"), 5 * DT, rtol=1e-13)


def test_whole_substeps_have_the_bits_of_as_many_steps():
    one, two = (boxes("numpy", 2, dc.SolverConfig(substeps=n)) for n in (2, 1))
    called, starts = [], []
    one.run(3, DT, start=starts.append, callback=called.append)
    two.run(6, DT / 2)
    assert (len(starts), len(called)) == (6, 3)
    for name in one.state.table:
        assert one.state.numpy(name).tobytes() == two.state.numpy(name).tobytes(), name


def test_a_stack_comes_to_rest_and_carries_its_weight():
    sim = boxes()
    sim.run(300, DT)
    assert np.abs(sim.state.numpy("velocity")).max() < 1e-5
    height = sim.state.numpy("position")[1:, 1]
    assert (np.abs(np.diff(height) - 1.0) < 4e-3).all()  # contacts give way, by more than the slop
    normal = sim.contacts.numpy("impulse")[:10, 0].reshape(5, 2).sum(axis=1) / DT
    np.testing.assert_allclose(np.sort(normal), G * np.arange(1, 6), rtol=2e-3)
    assert sim.stats.numpy("sweeps").tolist() == [8]


@pytest.mark.parametrize("restitution", [0.0, 0.5, 1.0])
def test_a_bounce_keeps_its_share_of_the_speed(restitution):
    sim = disc(SOFT, restitution=restitution)
    sim.run(60, DT)
    np.testing.assert_allclose(sim.state.numpy("velocity")[1, 1], 3.0 * restitution, atol=1e-9)


def test_the_impulses_of_an_impact_are_those_of_its_step():
    """Mass times the change of velocity, though the last of the substeps had nothing to do."""
    sim = disc(SOFT, restitution=1.0)
    mass, most = np.pi / 4, 0.0
    for _ in range(30):
        sim.step(DT)
        most = max(most, sim.contacts.numpy("impulse")[: sim.contacts.numpy("contact_count")[0], 0].max(initial=0.0))
    np.testing.assert_allclose(most, mass * 6.0, rtol=1e-9)


def test_overlaps_are_pushed_out_slowly_and_leave_no_speed():
    """The relaxing sweep takes away what the softness gave."""
    sim = disc(SOFT, velocity=0.0, height=0.4)
    sim.run(1, DT)
    assert 0.4 < sim.state.numpy("position")[1, 1] < 0.45
    sim.run(200, DT)
    np.testing.assert_allclose(sim.state.numpy("position")[1, 1], 0.5, atol=2e-3)
    assert np.abs(sim.state.numpy("velocity")).max() < 1e-9


@pytest.mark.parametrize("scene", [discs, pendulum, bounce, surfaces])
def test_warp_and_the_oracle_agree(scene):
    one, two = (simulation(scene, "float64", backend, config=SOFT) for backend in ("warp", "numpy"))
    for sim in (one, two):
        sim.run(12, 0.01)
    assert one.contacts.numpy("contact_count")[0] > 2
    for group in ("state", "joints"):
        for name in getattr(one, group).table:
            want, got = (getattr(sim, group).numpy(name) for sim in (one, two))
            np.testing.assert_allclose(got, want, rtol=0, atol=1e-9, err_msg=name)


def test_rods_keep_their_length():
    sim = simulation(pendulum, "float64", "warp", config=dataclasses.replace(SOFT, substeps=8))
    sim.run(100, DT)
    a, b = (sim.joints.numpy(f"joint_body_{end}") for end in "ab")
    angle, at = sim.state.numpy("angle"), sim.state.numpy("position")

    def ends(body, anchor):
        c, s = np.cos(angle[body]), np.sin(angle[body])
        return at[body] + np.stack((c * anchor[:, 0] - s * anchor[:, 1], s * anchor[:, 0] + c * anchor[:, 1]), axis=1)

    way = ends(b, sim.joints.numpy("joint_anchor_b")) - ends(a, sim.joints.numpy("joint_anchor_a"))
    np.testing.assert_allclose(np.hypot(*way.T), sim.joints.numpy("joint_length"), atol=0.03)


@pytest.mark.parametrize("amplitude", [0.1, 1.0])
@pytest.mark.parametrize("kind", ["hinge", "rod", "rope", "lasting rod"])
def test_a_pendulum_keeps_its_period_and_energy(kind, amplitude):
    """T = 2 pi sqrt(l / g) / agm(1, cos(a / 2)), at 128 steps a period, whatever holds the point mass."""
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0.0, -G), length_scale=1.0)
    wall = builder.add_body(type=dc.BodyType.STATIC)
    bob = builder.add_body((np.sin(amplitude), -np.cos(amplitude)), angle=amplitude, mass=2.0, inertia=1e-9)
    if kind == "hinge":
        builder.add_revolute_joint(wall, bob, (0.0, 0.0), (0.0, 1.0))
    elif "rod" in kind:
        builder.add_distance_joint(wall, bob, break_force=1e6 if kind == "rod" else None)
    else:
        builder.add_rope_joint(wall, bob, max_length=1.0)
    sim = dc.Simulation(*builder.finalize("float64"), config=SOFT)
    place, energy = [], []
    for _ in range(240):
        sim.step(DT)
        x, v = sim.state.numpy("position")[bob], sim.state.numpy("velocity")[bob]
        place.append(x.copy())
        energy.append(0.5 * v @ v + G * x[1])
    place = np.array(place)
    np.testing.assert_allclose(np.hypot(*place.T), 1.0, atol=1e-3)
    np.testing.assert_allclose(energy[20:], energy[20], atol=0.015 * G * (1 - np.cos(amplitude)))
    angle = np.arctan2(place[:, 0], -place[:, 1])
    i = np.flatnonzero((angle[:-1] > 0) & (angle[1:] <= 0))
    down = (i + angle[i] / (angle[i] - angle[i + 1])) * DT
    np.testing.assert_allclose(down[1] - down[0], {0.1: 2.0083451, 1.0: 2.1402287}[amplitude], rtol=1e-3)


def test_a_spring_swings_with_its_frequency_and_damping():
    """As implicit Euler has it over the substeps, to rounding."""
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0.0, 0.0), length_scale=1.0)
    body = builder.add_body((1.5, 0.0), mass=3.0, inertia=1.0)
    wall = builder.add_body(type=dc.BodyType.STATIC)
    builder.add_distance_joint(wall, body, length=1.0, frequency=2.0, damping_ratio=0.1)
    sim = dc.Simulation(*builder.finalize("float64"), config=SOFT)
    sim.run(40, DT)
    x, v = 0.5, 0.0
    w, h = 4 * np.pi, DT / 4
    for _ in range(160):
        v = (v - h * w * w * x) / (1 + 2 * 0.1 * w * h + (w * h) ** 2)
        x += h * v
    np.testing.assert_allclose(sim.state.numpy("position")[body, 0], 1.0 + x, atol=1e-12)
    np.testing.assert_allclose(sim.state.numpy("velocity")[body, 0], v, atol=1e-12)


def test_the_serial_colour_solves_joints_as_the_lanes_do():
    """Seventy bodies on one, by hinges with limits, springs and motors, one by one in scalar arithmetic."""

    def star(backend):
        builder = dc.ModelBuilder()
        builder.add_world(gravity=(0.0, -G), length_scale=1.0)
        hub = builder.add_discs([(0.0, 0.0)], 2.0, mask=0)[0]
        for i in range(72):
            c, s = np.cos(i / 72 * 2 * np.pi), np.sin(i / 72 * 2 * np.pi)
            arm = builder.add_discs([(2.5 * c, 2.5 * s)], 0.2, mask=0)[0]
            if i % 3 == 0:
                builder.add_revolute_joint(
                    hub, arm, (2.1 * c, 2.1 * s), lower=-0.1, upper=0.1, motor_speed=2.0, max_motor_torque=0.1
                )
            elif i % 3 == 1:
                builder.add_weld_joint(hub, arm, (2.1 * c, 2.1 * s), frequency=3.0, damping_ratio=0.2)
            else:
                builder.add_rope_joint(hub, arm, (2.0 * c, 2.0 * s), max_length=0.51)
        return dc.Simulation(*builder.finalize("float64", backend=backend), config=SOFT)

    one, two = star("warp"), star("numpy")
    for sim in (one, two):
        sim.run(3, DT)
    assert (one.rows.numpy("row_color") == SERIAL_COLOR).any()
    for name in ("position", "angle", "velocity", "angular_velocity"):
        np.testing.assert_allclose(one.state.numpy(name), two.state.numpy(name), atol=1e-9, err_msg=name)


def test_threads_within_a_world_change_no_bit():
    """A heap in which colours have enough blocks for two threads to share."""
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0.0, -G))
    builder.add_box(builder.add_body(type=dc.BodyType.STATIC), 100.0, 0.5, center=(0.0, -0.5))
    builder.add_discs([(0.99 * (i % 100) + 0.3 * (i // 100 % 2), 0.5 + 0.95 * (i // 100)) for i in range(2100)], 0.5)
    groups = builder.finalize("float64")
    one, two = (dc.Simulation(groups[0], groups[1].copy(), config=SOFT, threads=threads) for threads in (1, 2))
    for sim in (one, two):
        sim.run(6, DT)
    assert two.threads == min(2, usable_cores())
    for name in ("position", "angle", "velocity"):
        assert one.state.numpy(name).tobytes() == two.state.numpy(name).tobytes(), name


def test_a_method_may_follow_another_between_steps():
    sim = boxes("numpy", 2, dc.SolverConfig())
    sim.run(3, DT)
    sim.config = SOFT
    sim.run(3, DT)
    sim.config = dc.SolverConfig()
    sim.collide(DT)
    sim.solve()
    with pytest.raises(ValueError, match=r"config\.method is 'tgs_soft', of the step in flight 'pgs'"):
        sim.config = SOFT
    sim.advance()
    sim.run(3, DT)
    np.testing.assert_allclose(sim.state.numpy("position")[1:, 1], [0.5, 1.5], atol=2e-3)


def test_what_it_has_not_got_is_said():
    with pytest.raises(ValueError, match="schedule is 'color'; method 'tgs_soft' runs with 'world' only"):
        dc.Simulation(*dc_scene(), config=SOFT, schedule="color")
    with pytest.raises(ValueError, match="only a solve of sweeps can pause"):
        sim = dc.Simulation(*dc_scene(), config=SOFT)
        sim.collide(DT)
        sim.solve(pause=2)
    with pytest.raises(ValueError, match="only a Simulation takes substeps"):
        check_awake(SOFT)
    pytest.importorskip("taichi")
    with pytest.raises(ValueError, match=r"no kernels of solve.soft; it must be one of \('warp', 'numpy'\)"):
        dc.Simulation(*dc_scene("taichi"), config=SOFT)


def dc_scene(backend="numpy", **shape):
    builder = dc.ModelBuilder()
    builder.add_world()
    builder.add_disc(builder.add_body(), 0.5, **shape)
    return builder.finalize(backend=backend)


def tangle(seed: int) -> tuple[dc.Simulation, float]:
    """Up to five bodies of masses 1 : 1000 that fly, on joints of any kind without a motor; a substep [s]."""
    draw = np.random.default_rng(seed)
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0.0, -G) if seed % 3 else (0.0, 0.0))
    bodies = [builder.add_body(type=dc.BodyType.STATIC)]
    for i in range(int(draw.integers(1, 6))):
        place = (1.2 * (i + 1), draw.uniform(-0.5, 0.5))
        body = builder.add_body(
            place, draw.uniform(-0.5, 0.5), velocity=draw.normal(0, 3, 2), angular_velocity=draw.normal(0, 5)
        )
        builder.add_box(body, 0.4, draw.uniform(0.05, 0.3), density=1000 ** draw.uniform(-0.5, 0.5))
        pair = (bodies[draw.integers(len(bodies))], body)
        bodies.append(body)
        spring = {"frequency": 10 ** draw.uniform(-1, 1.7), "damping_ratio": draw.choice([0.0, 0.1, 1.0])}
        limits = {"lower": -draw.uniform(), "upper": draw.uniform()} if draw.random() < 0.5 else {}
        turn, end = draw.uniform(0, 6.28), draw.uniform(-0.4, 0.4, 2)
        axis = (np.cos(turn), np.sin(turn))
        kind = seed % 8
        if kind == 0:
            builder.add_distance_joint(*pair, end, (0.3, 0.0))
        elif kind == 1:
            builder.add_distance_joint(*pair, end, (0.3, 0.0), **spring)
        elif kind == 2:
            builder.add_rope_joint(*pair, end, (0.3, 0.0))
        elif kind == 3:
            builder.add_revolute_joint(*pair, end, **limits)
        elif kind == 4:
            builder.add_prismatic_joint(*pair, axis, end, **limits)
        elif kind == 5:
            builder.add_weld_joint(*pair, end, **spring)
        elif kind == 6:
            builder.add_wheel_joint(*pair, axis, end, **spring, **limits)
        else:
            builder.add_gear_joint(*pair, draw.normal(0, 2))
    n = int(draw.integers(1, 9))
    config = dc.SolverConfig(method="tgs_soft", substeps=n)
    return dc.Simulation(*builder.finalize("float64"), config=config), n * 1e-3 * 16 ** draw.uniform()


@pytest.mark.parametrize("part", range(8), ids=["rod", "spring", "rope", "hinge", "slider", "weld", "wheel", "gear"])
def test_what_hangs_together_in_any_way_gains_no_energy(part):
    """Substeps of 1 to 16 ms; in docs/limits.md are longer ones."""
    for seed in range(part, 32, 8):
        sim, dt = tangle(seed)

        def energy(sim: dc.Simulation = sim) -> float:
            return float((dc.kinetic_energy(sim) + dc.potential_energy(sim))[0])

        start = energy()
        weight = float(sim.model.numpy("mass").sum()) * G
        most = 0.2 * (float(dc.kinetic_energy(sim)[0]) + weight)
        for _ in range(10):
            sim.run(10, dt)
            assert energy() - start < most, seed
        assert not sim.state.numpy("flags").any()
