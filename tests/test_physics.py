"""Closed forms of mechanics. Discs are solid, I = m r^2 / 2; g = 9.8 m/s^2; float64 unless said."""

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


# ---------------------------------------------------------------- impacts


@pytest.mark.parametrize("restitution", [0.0, 0.4, 1.0])
def test_oblique_impact_of_two_discs(restitution):
    """Along the normal v1' - v1 = -(1 + e) m2 / (m1 + m2) u, v2' - v2 = (1 + e) m1 / (m1 + m2) u; tangents stay."""
    normal = np.array([np.cos(0.4), np.sin(0.4)])
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0.0, 0.0))
    v = np.array([[3.0, 0.5], [-1.0, 0.25]])
    gap = 0.02
    material = {"friction": 0.0, "restitution": restitution}
    builder.add_discs([(0.0, 0.0), (0.8 + gap) * normal], [0.5, 0.3], velocity=v, density=[1.0, 4.0], **material)
    sim = finish(builder)
    m1, m2 = sim.model.numpy("mass")
    sim.run(40, 1e-4)  # flies, and both normals turn a little
    while not sim.contacts.numpy("impulse")[:1].any():
        sim.step(1e-4)
    n = sim.contacts.numpy("normal")[0].copy()
    sim.run(2, 1e-4)
    now = sim.state.numpy("velocity").copy()
    u = (v[0] - v[1]) @ n
    jump = (1 + restitution) * u * n / (m1 + m2)
    expected = v + np.array([-m2 * jump, m1 * jump])
    np.testing.assert_allclose(now, expected, atol=1e-10 if restitution else 2e-2)
    assert (now[1] - now[0]) @ n > -1e-3
    assert not sim.state.numpy("angular_velocity").any()


@pytest.mark.parametrize("spin", [-40.0, -3.0, 0.0, 2.0, 40.0])
def test_impact_of_a_spinning_disc_with_friction(spin):
    """Coulomb: the slip s = vx + w r ends if |s| <= 3 mu (1 + e) vn (dvx = -s / 3), else dvx = -mu (1 + e) vn sign(s).

    The spin changes by 2 dvx / r (I = m r^2 / 2). Routh 1905, for a solid disc.
    """
    r, mu, e, vx, vn = 0.3, 0.25, 0.6, 1.5, 4.0
    builder = build(gravity=(0.0, 0.0), friction=mu, restitution=e)
    material = {"friction": mu, "restitution": e}
    # the contact point lies in the middle of the gap, so the impact is to begin with hardly one
    gap = 3 * vn * DT + 1e-9
    builder.add_discs([(0.0, r + gap)], r, velocity=(vx, -vn), angular_velocity=spin, **material)
    sim = finish(builder)
    sim.run(10, DT)
    slip = vx + spin * r
    change = -slip / 3 if abs(slip) <= 3 * mu * (1 + e) * vn else -mu * (1 + e) * vn * np.sign(slip)
    np.testing.assert_allclose(sim.state.numpy("velocity")[1], (vx + change, e * vn), rtol=1e-7)
    np.testing.assert_allclose(sim.state.numpy("angular_velocity")[1], spin + 2 * change / r, rtol=1e-7)


def test_slow_impacts_do_not_bounce():
    """Below the threshold (1 m/s) a contact does not bounce, above it does."""
    for speed, bounces in ((0.9, False), (1.1, True)):
        builder = build(gravity=(0.0, 0.0), restitution=0.5)
        builder.add_discs([(0.0, 0.6)], 0.5, velocity=(0.0, -speed))
        sim = finish(builder)
        sim.run(30, DT)
        velocity = sim.state.numpy("velocity")[1, 1]
        np.testing.assert_allclose(velocity, 0.5 * speed if bounces else 0.0, atol=1e-12)


@pytest.mark.parametrize("speed", [0.5, 3.0, 30.0])
def test_a_gap_closes_exactly(speed):
    """A speculative contact lets v = gap / dt, so a body arrives with gap 0, neither short of it nor through it."""
    builder = build(gravity=(0.0, 0.0))
    builder.add_discs([(0.0, 1.237)], 0.5, velocity=(0.0, -speed))
    sim = finish(builder)
    lowest = []
    sim.run(round(1.5 / speed / DT) + 5, DT, callback=lambda s: lowest.append(s.state.numpy("position")[1, 1]))
    np.testing.assert_allclose(lowest[-1], 0.5, atol=1e-12)
    assert min(lowest) > 0.5 - 1e-12


# ---------------------------------------------------------------- friction and rolling


def test_sliding_box_stops_after_its_distance():
    """Way v^2 / (2 mu g), less v dt / 2 in steps of dt (semi-implicit Euler)."""
    v, mu = 3.0, 0.4
    builder = build(friction=mu)
    body = builder.add_body((0.0, 0.1), velocity=(v, 0.0))
    builder.add_box(body, 0.5, 0.1, friction=mu)
    sim = finish(builder)
    sim.run(round(1.2 * v / (mu * G) / DT), DT)
    x = sim.state.numpy("position")[body, 0]
    np.testing.assert_allclose(x, v * v / (2 * mu * G) - v * DT / 2, atol=mu * G * DT**2)
    assert np.abs(sim.state.numpy("velocity")[body]).max() < 1e-9


@pytest.mark.parametrize(("degrees", "mu"), [(20.0, 0.40), (20.0, 0.33), (35.0, 0.75), (35.0, 0.3), (10.0, 0.0)])
def test_box_on_an_incline(degrees, mu):
    """It rests if mu >= tan(theta), else a = g (sin(theta) - mu cos(theta))."""
    theta = np.radians(degrees)
    along, out = np.array([np.cos(theta), np.sin(theta)]), np.array([-np.sin(theta), np.cos(theta)])
    builder = dc.ModelBuilder()
    builder.add_world()
    builder.add_box(builder.add_body(-out, angle=theta, type=dc.BodyType.STATIC), 40.0, 1.0, friction=mu)
    body = builder.add_body(0.1 * out, angle=theta)
    builder.add_box(body, 0.4, 0.1, friction=mu)
    sim = finish(builder)
    sim.run(100, DT)
    a = max(0.0, G * (np.sin(theta) - mu * np.cos(theta)))
    np.testing.assert_allclose(sim.state.numpy("velocity")[body] @ -along, a * 1.0, atol=1e-6)
    np.testing.assert_allclose(sim.state.numpy("velocity")[body] @ out, 0.0, atol=1e-6)
    np.testing.assert_allclose(sim.state.numpy("angle")[body], theta, atol=1e-6)


@pytest.mark.parametrize(("degrees", "mu"), [(10.0, 0.5), (30.0, 0.3), (30.0, 0.1)])
def test_disc_on_an_incline(degrees, mu):
    """It rolls with a = 2/3 g sin(theta) if mu >= tan(theta) / 3, else slides with g (sin(theta) - mu cos(theta))."""
    theta, r = np.radians(degrees), 0.25
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(G * np.sin(theta), -G * np.cos(theta)))
    builder.add_box(builder.add_body((0.0, -5.0), type=dc.BodyType.STATIC), 50.0, 5.0, friction=mu)
    body = int(builder.add_discs([(0.0, r)], r, friction=mu)[0])
    sim = finish(builder)
    sim.run(100, DT)
    rolls = mu >= np.tan(theta) / 3
    a = 2 / 3 * G * np.sin(theta) if rolls else G * (np.sin(theta) - mu * np.cos(theta))
    np.testing.assert_allclose(sim.state.numpy("velocity")[body], (a, 0.0), atol=1e-9)
    spin = -a / r if rolls else -2 * mu * G * np.cos(theta) / r
    np.testing.assert_allclose(sim.state.numpy("angular_velocity")[body], spin, rtol=1e-9)
    np.testing.assert_allclose(sim.state.numpy("position")[body, 0], a / 2 * (1 + DT), rtol=1e-9)


def test_sliding_disc_begins_to_roll_at_two_thirds_of_its_speed():
    """Angular momentum about a point of the floor: m r v0 = m r v + I v / r, so v = 2/3 v0 whatever mu."""
    for mu in (0.1, 0.6):
        builder = build(friction=mu)
        builder.add_discs([(0.0, 0.4)], 0.4, velocity=(3.0, 0.0), friction=mu)
        sim = finish(builder)
        sim.run(150, DT)
        np.testing.assert_allclose(sim.state.numpy("velocity")[1], (2.0, 0.0), atol=1e-9)
        np.testing.assert_allclose(sim.state.numpy("angular_velocity")[1], -2.0 / 0.4, rtol=1e-9)


# ---------------------------------------------------------------- statics


@pytest.mark.parametrize("kind", ["discs", "boxes"])
def test_loads_in_a_stack_are_the_weights_above(kind):
    """Statics: contact k carries what stands on it, N = g sum of the masses above."""
    builder = build()
    masses = np.array([3.0, 0.5, 2.0, 1.0])
    bodies = []
    for k, mass in enumerate(masses):
        body = builder.add_body((0.0, 0.25 + 0.5 * k), mass=mass)
        if kind == "discs":
            builder.add_disc(body, 0.25)
        else:
            builder.add_box(body, 0.4, 0.25)
        bodies.append(body)
    sim = finish(builder, dc.SolverConfig(tolerance=1e-11, max_sweeps=50_000, acceleration="none"))
    sim.run(20, DT)
    slots, _ = measure.contact_slots(sim.contacts)
    upper = sim.contacts.numpy("body_b")[slots]
    loads = np.array([sim.contacts.numpy("impulse")[slots, 0][upper == body].sum() for body in bodies]) / DT
    np.testing.assert_allclose(loads, G * masses[::-1].cumsum()[::-1], rtol=1e-6)
    if kind == "boxes":
        assert len(slots) == 2 * len(masses)
        pairs = sim.contacts.numpy("impulse")[slots, 0].reshape(-1, 2)
        np.testing.assert_allclose(pairs[:, 0], pairs[:, 1], rtol=1e-4)  # both corners alike


def test_a_disc_in_a_notch_is_carried_by_both_walls():
    """Between planes of slope alpha without friction each carries N = m g / (2 cos(alpha))."""
    alpha = np.radians(35.0)
    builder = dc.ModelBuilder()
    builder.add_world()
    ground = builder.add_body(type=dc.BodyType.STATIC)
    reach = 3 * np.array([np.cos(alpha), np.sin(alpha)])
    builder.add_chain(ground, ((-reach[0], reach[1]), (0.0, 0.0), tuple(reach)), friction=0.0)
    builder.add_discs([(0.0, 0.5 / np.cos(alpha))], 0.5, friction=0.0, density=2.0)
    sim = finish(builder)
    sim.run(10, DT)
    slots, _ = measure.contact_slots(sim.contacts)
    loads = sim.contacts.numpy("impulse")[slots, 0] / DT
    weight = sim.model.numpy("mass")[1] * G
    np.testing.assert_allclose(loads, weight / (2 * np.cos(alpha)), rtol=1e-6)


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


@pytest.mark.parametrize(("tolerance", "drift", "speed"), [(1e-4, 2e-2, 5e-2), (1e-7, 2e-4, 2e-4)])
def test_a_stack_of_ten_boxes_stands_for_five_seconds(tolerance, drift, speed):
    """In float32, each box a centimetre beside the one below; it sways by what the tolerance leaves unsolved."""
    builder = build()
    for k in range(10):
        builder.add_box(builder.add_body((0.01 * (k % 2), 0.5 + k)), 0.5, 0.5)
    sim = dc.Simulation(*builder.finalize("float32"), config=dc.SolverConfig(tolerance=tolerance))
    before = sim.state.numpy("position").copy()
    sim.run(500, DT)
    moved = np.abs(sim.state.numpy("position") - before)
    assert moved[:, 0].max() < drift
    assert moved[:, 1].max() < 10 * 1e-3  # ten overlaps of the slop, 0.05 % of a diameter
    assert np.abs(sim.state.numpy("angle")).max() < drift
    assert np.abs(sim.state.numpy("velocity")).max() < speed


# ---------------------------------------------------------------- order of the time step


def test_free_fall_is_first_order():
    """Semi-implicit Euler: y = y0 + v0 t - g t^2 / 2 - g t dt / 2, an error of g t dt / 2 exactly."""
    errors = []
    for steps in (50, 100, 200):
        builder = dc.ModelBuilder()
        builder.add_world()
        builder.add_discs([(0.0, 3.0)], 0.5, velocity=(1.0, 2.0))
        sim = finish(builder)
        sim.run(steps, 1.0 / steps)
        np.testing.assert_allclose(sim.state.numpy("position")[0, 0], 1.0, rtol=1e-12)
        errors.append(3.0 + 2.0 - G / 2 - sim.state.numpy("position")[0, 1])
    np.testing.assert_allclose(errors, G / 2 / np.array([50, 100, 200]), rtol=1e-9)


def test_sliding_into_rolling_is_first_order():
    """With v0 = 3 and mu g = a, the disc slides for t1 = v0 / (3 a), x = v0 t1 - a t1^2 / 2, then rolls at 2/3 v0."""
    mu, v0, end = 0.25, 3.0, 1.0
    a = mu * G
    t1 = v0 / (3 * a)
    exact = v0 * t1 - a * t1**2 / 2 + 2 / 3 * v0 * (end - t1)
    errors = []
    for steps in (40, 160, 640):
        builder = build(friction=mu)
        builder.add_discs([(0.0, 0.4)], 0.4, velocity=(v0, 0.0), friction=mu)
        sim = finish(builder)
        sim.run(steps, end / steps)
        errors.append(abs(sim.state.numpy("position")[1, 0] - exact))
    ratios = np.array(errors[:-1]) / errors[1:]
    assert ((ratios > 3.0) & (ratios < 5.5)).all(), ratios  # dt falls by 4


def test_restitution_of_a_bouncing_disc():
    """Bounces of height h0 e^(2k): the impact speed is kept times e, up to the O(dt) of fall and flight."""
    e, h = 0.8, 1.0
    heights = []
    for dt in (0.004, 0.001):
        builder = build(restitution=e)
        builder.add_discs([(0.0, 0.5 + h)], 0.5, restitution=e)
        sim = finish(builder)
        y = []
        sim.run(round(1.2 / dt), dt, callback=lambda s, y=y: y.append(s.state.numpy("position")[1, 1] - 0.5))
        y = np.array(y)
        low = int(np.argmin(y[: round(0.6 / dt)]))
        heights.append(y[low:].max())
    assert abs(heights[1] - e * e * h) < 0.01
    assert abs(heights[1] - e * e * h) < 0.5 * abs(heights[0] - e * e * h)
