"""Pictures of worlds: what is drawn is what is there."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.figure import Figure

import dc_kernels as dc
from pipeline.plots import style
from pipeline.plots import world as drawing
from pipeline.scenes import SCENES, Mixed, Settled, Stack, scene

PNG = b"\x89PNG"


@pytest.mark.parametrize("name", SCENES)
def test_every_scene_steps_and_is_drawn(name, tmp_path):
    sizes = {"rows": 3} if name == "pyramid" else {} if name in ("incline", "card-house") else {"bodies": 12}
    sim = dc.Simulation(*scene(name, **sizes).build(2).finalize())
    energy = dc.kinetic_energy(sim) + dc.potential_energy(sim)
    sim.run(30, 0.01)
    assert not sim.state.numpy("flags").any()
    if name in ("cars", "conveyor"):  # which motors and belts drive
        energy = np.full_like(energy, np.inf)
    assert (dc.kinetic_energy(sim) + dc.potential_energy(sim) <= energy + 1e-3 * np.abs(energy) + 1e-6).all()
    with style.figure(4.0, 4.0) as fig:
        axes = fig.add_subplot()
        drawing.draw_world(axes, sim, 1)
        style.save_figure(fig, tmp_path / "world.png", dpi=60)
    assert (tmp_path / "world.png").read_bytes()[:4] == PNG
    # what is drawn holds every body of the world
    left, right, (bottom, top) = *axes.get_xlim(), axes.get_ylim()
    bodies = slice(*sim.model.numpy("body_start")[1:3])
    moving = sim.state.numpy("position")[bodies][sim.model.numpy("body_type")[bodies] == dc.BodyType.DYNAMIC]
    assert ((moving > [left, bottom]) & (moving < [right, top])).all()


def test_settled_piles_are_near_rest():
    sim = dc.Simulation(*Settled(bodies=100).build(2).finalize())
    for _ in range(20):
        sim.step(0.01)
        assert np.abs(sim.state.numpy("velocity")).max() < 0.5
    assert (sim.contacts.numpy("contact_count") > 150).all()


def test_outlines_have_the_bodies_area():
    """Discs, capsules and rounded boxes are drawn as what they weigh (density 1)."""
    builder = Mixed(bodies=24).build(1, 2)
    builder.add_box(builder.add_body((20.0, 20.0), 0.3), 0.4, 0.2, radius=0.1)
    model, *rest = builder.finalize("float64")
    shapes = drawing.WorldShapes.of(drawing.arrays(dc.Simulation(model, *rest)), 0)
    area = np.zeros(model.body_count)
    for owner, points in shapes.outlines:
        x, y = points[..., 0], points[..., 1]
        area[owner] += 0.5 * (x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1)).sum(axis=1)
    np.testing.assert_allclose(area[1:], model.numpy("mass")[1:], rtol=0.02)
    assert shapes.segments[1].shape == (3, 2, 2)


def test_joints_are_lines_between_anchors_or_from_there_to_the_centres():
    builder = dc.ModelBuilder()
    builder.add_world()
    post = builder.add_body((3.0, 0.0), type=dc.BodyType.STATIC)
    left, right = (builder.add_body((x, 1.0), angle=np.pi / 2) for x in (0.0, 2.0))
    for body in (left, right):
        builder.add_disc(body, 0.5)
    builder.add_distance_joint(left, right)
    builder.add_revolute_joint(left, right, (0.0, -1.0))
    builder.add_weld_joint(post, right, (0.0, 0.5))
    builder.add_gear_joint(left, right, 1.0)
    sim = dc.Simulation(*builder.finalize("float64"))
    shapes = drawing.WorldShapes.of(drawing.arrays(sim), 0)
    panel = drawing.WorldDrawing(Figure().subplots(), shapes, sim.state.numpy("position"), sim.state.numpy("angle"))
    lines = {tuple(np.round(line, 6).ravel().tolist()) for line in panel.joints.get_segments()}
    assert lines == {
        (0.0, 1.0, 2.0, 1.0),  # the rod
        (1.0, 1.0, 0.0, 1.0), (1.0, 1.0, 2.0, 1.0),  # the hinge between both
        (3.0, 0.5, 2.0, 1.0),  # the weld to what is fixed
    }  # fmt: skip


def test_forces_are_impulses_over_dt():
    sim = dc.Simulation(*Stack(bodies=1, jitter=0.0).build(2).finalize("float64"))
    sim.run(3, 0.02)
    for world in range(2):
        forces = drawing.Forces.of(sim, world)
        assert forces.normal.sum() == pytest.approx(9.8, rel=1e-3)
        np.testing.assert_allclose(forces.lines[:, 0], sim.state.numpy("position")[[2 * world + 1] * 2])
        np.testing.assert_allclose(np.sort(forces.points[:, 0]), [-0.5, 0.5], atol=1e-6)
