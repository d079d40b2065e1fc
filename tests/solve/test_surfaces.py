"""What few bodies and shapes have: damping, gravity scales, rotation locks; belts, and resistance to rolling."""

import io

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels.solve.rows import read_column

DT = 0.01
G = 9.8


def free(backend="numpy", **traits):
    """A disc that flies through empty space."""
    builder = dc.ModelBuilder()
    builder.add_world()
    builder.add_disc(builder.add_body(velocity=(3.0, 1.0), angular_velocity=2.0, **traits), 0.5)
    return dc.Simulation(*builder.finalize("float64", backend=backend))


def on_floor(add, angle=0.0, backend="warp", **floor):
    """What ``add`` adds, on a floor at y = 0 that is tilted down to the right."""
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(G * np.sin(angle), -G * np.cos(angle)))
    builder.add_box(builder.add_body(type=dc.BodyType.STATIC), 50.0, 0.5, center=(0.0, -0.5), **floor)
    add(builder)
    return dc.Simulation(*builder.finalize("float64", backend=backend))


def velocity_of(sim, body=1):
    return sim.state.numpy("velocity")[body]


@pytest.mark.parametrize("steps", [1, 50])
def test_damping_is_that_of_the_differential_equation(steps):
    sim = free(linear_damping=0.7, angular_damping=0.3)
    t = 2.0
    sim.run(steps, t / steps)
    kept = np.exp(-0.7 * t)
    np.testing.assert_allclose(velocity_of(sim, 0), [3 * kept, kept - G / 0.7 * (1 - kept)], rtol=1e-12)
    np.testing.assert_allclose(sim.state.numpy("angular_velocity"), 2 * np.exp(-0.3 * t), rtol=1e-12)


@pytest.mark.parametrize("rate", [0.0, 1e-3, 9.0, 11.0, 400.0])
def test_warp_damps_as_the_oracle_does(rate):
    """Rates on both sides of where the series ends, one of many times a step, and a body without."""
    one, two = (
        free(backend, linear_damping=rate, angular_damping=2 * rate, gravity_scale=0.5) for backend in ("warp", "numpy")
    )
    for sim in (one, two):
        sim.state.numpy("torque")[:] = 0.3
        sim.run(10, DT)
    for name in ("position", "velocity", "angular_velocity"):
        np.testing.assert_allclose(one.state.numpy(name), two.state.numpy(name), rtol=1e-11)


def test_gravity_scale():
    sim = free(gravity_scale=-0.5)
    sim.run(100, DT)
    np.testing.assert_allclose(velocity_of(sim, 0), [3.0, 1.0 + 0.5 * G], rtol=1e-12)


def test_a_body_of_fixed_rotation_does_not_turn():
    def add(builder):
        body = builder.add_body((0.0, 0.6), angle=0.3, fixed_rotation=True)
        builder.add_box(body, 0.5, 0.25)

    sim = on_floor(add, backend="numpy")
    sim.state.numpy("torque")[1] = 5.0
    sim.run(30, DT)
    assert sim.model.numpy("inv_inertia")[1] == 0
    assert sim.state.numpy("angle")[1] == 0.3
    assert sim.contacts.numpy("contact_count")[0] == 1


def test_traits_that_are_neutral_are_not_there():
    """The kernels, the arrays and the bits are those of a scene that says nothing of them."""

    def made(body, shape):
        builder = dc.ModelBuilder()
        builder.add_world()
        builder.add_box(builder.add_body(type=dc.BodyType.STATIC), 5.0, 0.5, **shape)
        builder.add_disc(builder.add_body((0.0, 1.2), **body), 0.5, **shape)
        return dc.Simulation(*builder.finalize(backend="numpy"))

    plain = made({}, {})
    body = {"linear_damping": 0.0, "angular_damping": 0.0, "gravity_scale": 1.0, "fixed_rotation": False}
    neutral = made(body, {"surface_speed": 0.0, "rolling_resistance": 0.0})
    assert neutral.kernels == plain.kernels
    assert neutral.variant == plain.variant == "discs"
    assert all(neutral.model.numpy(name).size == 0 for name in neutral.model.traits)
    for sim in (plain, neutral):
        sim.run(20, DT)
    assert neutral.state.numpy("position").tobytes() == plain.state.numpy("position").tobytes()


@pytest.mark.parametrize("schedule", ["world", "color"])
def test_a_belt_brings_a_box_to_its_speed(schedule):
    """Friction accelerates it by mu g until it has the belt's speed, which it keeps."""
    builder = dc.ModelBuilder()
    builder.add_world()
    belt = builder.add_body(type=dc.BodyType.STATIC)
    builder.add_box(belt, 50.0, 0.5, center=(0.0, -0.5), friction=0.5, surface_speed=2.0)
    builder.add_box(builder.add_body((0.0, 0.25)), 0.25, 0.25, friction=0.5)
    sim = dc.Simulation(*builder.finalize("float64"), schedule=schedule)
    sim.run(30, DT)
    np.testing.assert_allclose(velocity_of(sim), [0.5 * G * 0.3, 0.0], atol=2e-3)
    sim.run(50, DT)
    np.testing.assert_allclose(velocity_of(sim), [2.0, 0.0], atol=1e-3)
    sim.change_model(shape_surface_speed=[-1.0, 0.0])
    sim.run(150, DT)
    np.testing.assert_allclose(velocity_of(sim), [-1.0, 0.0], atol=1e-3)


def test_surface_speeds_of_both_shapes_add_up():
    """A box whose own surface goes round clockwise drives along a floor at rest, to the left."""
    sim = on_floor(lambda b: b.add_box(b.add_body((0.0, 0.25)), 0.25, 0.25, surface_speed=1.5), friction=0.5)
    sim.run(60, DT)
    np.testing.assert_allclose(velocity_of(sim), [1.5, 0.0], atol=1e-3)


ROLL = 0.1


def rollers(builder):
    for i, roll in enumerate((0.2, ROLL, 0.0)):
        builder.add_disc(builder.add_body((3.0 * i, 0.5)), 0.5, friction=1.0, rolling_resistance=roll)


@pytest.mark.parametrize("method", ["pgs", "jacobi"])
def test_a_disc_stays_on_a_slope_below_its_rolling_resistance(method):
    """Above it the disc rolls with 2/3 g (sin - resistance cos); without resistance with 2/3 g sin."""
    slope = np.arctan(0.15)
    sim = on_floor(rollers, slope, friction=1.0)
    sim.config = dc.SolverConfig(method=method, tolerance=1e-9)
    sim.run(100, DT)
    along = [0.0, 2 / 3 * G * (np.sin(slope) - ROLL * np.cos(slope)), 2 / 3 * G * np.sin(slope)]
    np.testing.assert_allclose(sim.state.numpy("velocity")[1:, 0], along, atol=2e-3)
    np.testing.assert_allclose(sim.state.numpy("angular_velocity")[1:], -2 * np.array(along), atol=4e-3)


def test_a_rolling_disc_comes_to_rest():
    """It loses 2/3 of the resistance times g, and stays."""

    def add(builder):
        disc = builder.add_body((0.0, 0.5), velocity=(1.0, 0.0), angular_velocity=-2.0)
        builder.add_disc(disc, 0.5, rolling_resistance=ROLL)

    sim = on_floor(add)
    sim.run(100, DT)
    np.testing.assert_allclose(velocity_of(sim), [1.0 - 2 / 3 * ROLL * G, 0.0], atol=2e-3)
    sim.run(100, DT)
    at = sim.state.numpy("position")[1].copy()
    np.testing.assert_allclose(at[0], 1.0 / (4 / 3 * ROLL * G), rtol=0.02)
    sim.run(100, DT)
    np.testing.assert_allclose(sim.state.numpy("position")[1], at, atol=1e-6)


def test_rolling_impulses_keep_to_their_bound():
    sim = on_floor(rollers, 0.15, friction=1.0)
    sim.run(20, DT)
    normal = sim.contacts.numpy("impulse")[:3, 0]
    used = sim.rows.numpy("color_block")[-1] * 8
    lanes = np.flatnonzero(sim.rows.numpy("limit_slot")[:used] >= 0)
    assert len(lanes) == 2  # that of the disc without resistance has no such row
    slot = lanes // 8 * 16 + lanes % 8
    for name, sign in (("lo", -1.0), ("hi", 1.0)):
        bound = read_column(sim.rows.numpy("column"), sim.variant, name, slot)
        np.testing.assert_allclose(bound, sign * np.array([0.2, ROLL]) * normal[:2], rtol=1e-3)
    assert (np.abs(sim.rows.numpy("impulse")[slot]) <= bound * (1 + 1e-12)).all()


def test_runs_go_on_from_snapshots_and_copies():
    sim = on_floor(rollers, 0.15, friction=1.0, surface_speed=0.3)
    sim.run(20, DT)
    file = io.BytesIO()
    sim.save(file)
    file.seek(0)
    others = [dc.Simulation.load(file), sim.clone()]
    for one in (sim, *others):
        one.run(20, DT)
    for other in others:
        assert other.model.views().keys() == sim.model.views().keys()
        for name in sim.state.table:
            assert other.state.numpy(name).tobytes() == sim.state.numpy(name).tobytes(), name


def test_what_cannot_be_is_refused():
    builder = dc.ModelBuilder()
    builder.add_world()
    with pytest.raises(ValueError, match=r"angular_velocity of body 0 is 2, inertia None; a body of fixed_rotation"):
        builder.add_body(angular_velocity=2.0, fixed_rotation=True)
    with pytest.raises(ValueError, match=r"linear_damping of body 0 is -1"):
        builder.add_body(linear_damping=-1.0)
    with pytest.raises(TypeError, match=r"add_body\(\) has no argument 'gravity'"):
        builder.add_body(gravity=1.0)
    with pytest.raises(ValueError, match=r"rolling_resistance\[1\] is -0.1"):
        builder.add_discs(np.zeros((2, 2)), 0.5, rolling_resistance=[0.0, -0.1])
    with pytest.raises(TypeError, match=r"add_discs\(\) has no argument 'fixed'"):
        builder.add_discs(np.zeros((2, 2)), 0.5, fixed=True)
    with pytest.raises(ValueError, match=r"surface_speed of shape 0 is nan"):
        builder.add_disc(builder.add_body(mass=1.0), 0.5, surface_speed=np.nan)
    model, *_ = builder.finalize(backend="numpy")
    assert model.numpy("linear_damping").size == 0  # nothing of what was refused is left
    sim = free()
    with pytest.raises(
        ValueError, match=r"gravity_scale is not there, as no body was built with any of linear_damping"
    ):
        sim.change_model(gravity_scale=0.0)


def test_what_is_given_goes_to_its_body_and_shape():
    builder = dc.ModelBuilder()
    builder.add_world()
    ground = builder.add_body(type=dc.BodyType.STATIC)
    builder.add_discs([(0.0, 3.0), (2.0, 3.0)], 0.5, angular_damping=[0.1, 0.2], rolling_resistance=0.3)
    builder.add_chain(ground, [(0, 0), (1, 0), (2, 0)], surface_speed=1.0)  # its shapes come first in the model
    model, *_ = builder.finalize("float64", backend="numpy")
    assert model.numpy("angular_damping").tolist() == [0.0, 0.1, 0.2]
    assert model.numpy("gravity_scale").tolist() == [1.0, 1.0, 1.0]
    assert model.numpy("shape_surface_speed").tolist() == [1.0, 1.0, 0.0, 0.0]
    assert model.numpy("shape_rolling_resistance").tolist() == [0.0, 0.0, 0.3, 0.3]


def test_taichi_damps_as_warp_does():
    pytest.importorskip("taichi")
    traits = {"linear_damping": 5.0, "angular_damping": 20.0, "gravity_scale": 0.5}
    one, two = (free(backend, **traits) for backend in ("warp", "taichi"))
    one.run(10, DT)
    for _ in range(10):  # stage by stage: parity/test_taichi.py compiles the same kernels, all but one
        two.collide(DT)
        two.solve()
        two.advance()
    for name in ("position", "velocity", "angular_velocity"):
        np.testing.assert_allclose(two.state.numpy(name), one.state.numpy(name), rtol=1e-14)


def test_taichi_says_what_it_has_not_got():
    pytest.importorskip("taichi")
    with pytest.raises(
        ValueError, match=r"backend is 'taichi', which has no rows of surfaces that move or resist rolling"
    ):
        on_floor(rollers, backend="taichi")
