"""Conservation laws and rest; closed forms are in ``test_accuracy.py``. g = 9.8 m/s^2; float64 unless said."""

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels import measure

G = 9.8
DT = 0.01
EXACT = dc.SolverConfig(tolerance=1e-12, max_sweeps=20_000, acceleration="none")
ELASTIC = dc.SolverConfig(tolerance=1e-12, max_sweeps=20_000, acceleration="none", restitution_threshold=0.0)


def build(gravity=(0.0, -G), **material):
    """A builder with one world and a static floor, the half plane y < 0."""
    builder = dc.ModelBuilder()
    builder.add_world(gravity=gravity)
    builder.add_box(builder.add_body((0.0, -5.0), type=dc.BodyType.STATIC), 50.0, 5.0, **material)
    return builder


def finish(builder, config=EXACT):
    return dc.Simulation(*builder.finalize("float64"), config=config)


def gas(seed, config, count=40, spread=1.0, friction=0.0, restitution=1.0, boxes=False):
    """Bodies without gravity, thrown at each other at random, no walls; discs of several sizes, or boxes."""
    rng = np.random.default_rng(seed)
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0.0, 0.0))
    side = int(np.ceil(np.sqrt(count)))
    cells = np.stack(np.divmod(np.arange(count), side), axis=1).astype(float)
    positions = spread * (cells - (side - 1) / 2) + rng.uniform(-0.1, 0.1, (count, 2))
    velocity = rng.normal(0, 2, (count, 2)) - 1.5 * positions  # inwards, so that they meet
    spin = rng.normal(0, 5, count)
    if boxes:
        for p, v, w in zip(positions, velocity, spin):
            body = builder.add_body(p, rng.uniform(0, 6), v, w)
            builder.add_box(body, rng.uniform(0.1, 0.25), 0.15, friction=friction, restitution=restitution)
    else:
        radius, density = rng.uniform(0.1, 0.35, count), rng.uniform(0.5, 5, count)
        material = {"density": density, "friction": friction, "restitution": restitution}
        builder.add_discs(positions, radius, velocity=velocity, angular_velocity=spin, **material)
    return finish(builder, config)


# ---------------------------------------------------------------- conservation


@pytest.mark.parametrize(("friction", "restitution", "boxes"), [(0.5, 0.5, False), (0.5, 0.0, True), (0.0, 1.0, False)])
def test_momentum_is_conserved_to_round_off(friction, restitution, boxes):
    """Newton's third law: each impulse acts on both bodies at one point, so P and L = sum r x p + I w stay.

    Position correction is off: it moves bodies without changing velocities, which changes r x p.
    """
    config = dc.SolverConfig(position_correction="none", tolerance=1e-10)
    sim = gas(1, config, friction=friction, restitution=restitution, boxes=boxes)
    linear, angular = measure.momentum(sim)
    size = np.abs(sim.model.numpy("mass")[:, None] * sim.state.numpy("velocity")).sum()
    hits = 0
    for _ in range(100):
        sim.step(DT)
        hits += int((sim.contacts.numpy("impulse")[measure.contact_slots(sim.contacts)[0], 0] > 0).sum())
    assert hits > 50
    now = measure.momentum(sim)
    np.testing.assert_allclose(now.linear, linear, atol=1e-13 * size)
    np.testing.assert_allclose(now.angular, angular, atol=1e-12 * size)


def test_single_precision_conserves_momentum_to_its_round_off():
    """The same in float32, sums in float64."""
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0.0, 0.0))
    rng = np.random.default_rng(2)
    positions = np.stack(np.divmod(np.arange(36), 6), axis=1) - 2.5
    builder.add_discs(positions, 0.3, velocity=rng.normal(0, 1, (36, 2)) - positions, friction=0.5)
    sim = dc.Simulation(*builder.finalize("float32"))
    before = measure.momentum(sim)
    sim.run(100, DT)
    now = measure.momentum(sim)
    np.testing.assert_allclose(now.linear, before.linear, atol=2e-5)


@pytest.mark.parametrize("seed", range(3))
def test_frictionless_elastic_discs_conserve_energy(seed):
    """Restitution 1 without friction: u+ = -u-, so lambda (u+ + u-) = 0 and kinetic energy stays (Moreau 1988).

    The gas is thin: where a disc is hit and pushes the next one in the same step, their gap closes without a bounce.
    """
    sim = gas(seed, ELASTIC, count=64, spread=3.0)
    before = measure.kinetic_energy(sim)
    hits = 0
    for _ in range(100):
        sim.step(0.004)
        hits += int((sim.contacts.numpy("impulse")[measure.contact_slots(sim.contacts)[0], 0] > 0).sum())
    assert hits > 10
    np.testing.assert_allclose(measure.kinetic_energy(sim), before, rtol=1e-10)


@pytest.mark.parametrize("boxes", [False, True])
@pytest.mark.parametrize(("friction", "restitution"), [(0.0, 1.0), (0.0, 0.5), (0.0, 0.0), (0.8, 0.0)])
def test_no_step_creates_energy(friction, restitution, boxes):
    """At restitution <= 1 without friction, or at restitution 0 with it, impacts dissipate (Moreau 1988).

    With both, Newton's restitution may add energy in one impact of boxes (Kane 1984), which is no solver's fault.
    """
    sim = gas(3, ELASTIC, friction=friction, restitution=restitution, boxes=boxes)
    energy = [measure.kinetic_energy(sim)[0]]
    for _ in range(150):
        sim.step(DT)
        energy.append(measure.kinetic_energy(sim)[0])
    assert np.diff(energy).max() < 1e-9 * energy[0]
    if restitution < 1:
        assert energy[-1] < 0.9 * energy[0]


@pytest.mark.parametrize("restitution", [0.3, 0.8])
def test_discs_with_friction_and_restitution_lose_energy(restitution):
    """A disc's normal impulse does not turn it, so friction takes energy from a pair.

    Only where several impacts meet in one step can Newton's restitution add some: a stated limit of its law, here at
    most 0.2 % of the energy in a step, which the other impacts outweigh.
    """
    sim = gas(4, ELASTIC, friction=0.5, restitution=restitution)
    energy = [measure.kinetic_energy(sim)[0]]
    for _ in range(150):
        sim.step(DT)
        energy.append(measure.kinetic_energy(sim)[0])
    gains = np.maximum(np.diff(energy), 0.0)
    assert gains.max() < 2e-3 * energy[0]
    assert (gains > 1e-9 * energy[0]).sum() <= 2
    assert energy[-1] < 0.95 * energy[0]


def test_falling_bodies_in_a_box_never_gain_energy():
    """Kinetic plus potential energy: symplectic Euler loses m g^2 dt^2 / 2 a step in free fall, contacts dissipate.

    Position correction is off, as it lifts bodies out of an overlap.
    """
    rng = np.random.default_rng(5)
    builder = build(friction=0.4)
    positions = np.stack((rng.uniform(-1, 1, 15), 0.4 + 0.45 * np.arange(15)), axis=1)
    builder.add_discs(positions, rng.uniform(0.1, 0.2, 15), friction=0.4)
    sim = finish(builder, dc.SolverConfig(position_correction="none", tolerance=1e-10, max_sweeps=5000))
    energy = []
    sim.run(200, DT, callback=lambda s: energy.append((measure.kinetic_energy(s) + measure.potential_energy(s))[0]))
    assert np.diff(energy).max() < 1e-9 * energy[0]
    assert energy[-1] < 0.5 * energy[0]


# ---------------------------------------------------------------- statics


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_a_box_at_rest_stays_at_rest(dtype):
    builder = build()
    body = builder.add_body((0.3, 0.5))
    builder.add_box(body, 0.5, 0.5)
    sim = dc.Simulation(*builder.finalize(dtype))
    sim.run(500, DT)
    np.testing.assert_allclose(sim.state.numpy("position")[body], (0.3, 0.5), atol=1e-3)
    np.testing.assert_allclose(sim.state.numpy("position")[body, 0], 0.3, atol=1e-5)
    assert abs(sim.state.numpy("angle")[body]) < 1e-5
    assert np.abs(sim.state.numpy("velocity")[body]).max() < 1e-4


# ---------------------------------------------------------------- bounces of every size


def bounces(size, restitution=0.7, steps=240, **options):
    """Heights over the size of a disc of that size after each step of a fall, in time steps of sqrt(size) / 64."""
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0, -10))
    floor = builder.add_body(type=dc.BodyType.STATIC)
    builder.add_box(floor, 50 * size, 0.5 * size, center=(0, -0.5 * size), restitution=restitution)
    body = builder.add_body((0, 2 * size))
    builder.add_disc(body, 0.5 * size, restitution=restitution)
    sim = dc.Simulation(*builder.finalize(), config=dc.SolverConfig(**options))
    heights = []
    for _ in range(steps):
        sim.step(size**0.5 / 64)
        heights.append(sim.state.numpy("position")[body, 1] / size)
    return np.array(heights)


@pytest.mark.parametrize("size", [4.0, 0.25, 1 / 16, 1 / 64])
def test_bounces_scale_with_the_world(size):
    """The speed below which nothing bounces is relative: a scene scaled by a power of four keeps its bits."""
    assert np.array_equal(bounces(size), bounces(1.0))


@pytest.mark.parametrize("size", [1.0, 1 / 64])
def test_only_what_is_not_elastic_comes_to_rest(size):
    inelastic, elastic = bounces(size, 0.7, steps=600), bounces(size, 1.0, steps=600)
    assert np.ptp(inelastic[-100:]) < 1e-5
    assert elastic[-150:].max() > 1.9
    low = bounces(size, 1.0, steps=600, restitution_threshold=100.0)
    assert np.array_equal(low, elastic)
    assert np.ptp(bounces(size, 0.9, steps=600, restitution_threshold=100.0)[-100:]) < 1e-5
