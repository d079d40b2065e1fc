"""Arrays world by world, and what objects say about themselves."""

import copy
import pickle
import re

import numpy as np
import pytest

import dc_kernels as dc
from tests.driving.scenes import DT, scene, simulation, worlds_of_one_size


def test_worlds_of_one_size_are_an_axis_in_the_same_memory():
    sim = worlds_of_one_size()
    for group, name, shape in (
        (sim.state, "position", (3, 3, 2)),
        (sim.state, "angle", (3, 3)),
        (sim.state, "time", (3,)),
        (sim.model, "shape_radius", (3, 3)),
        (sim.model, "vertices", (3, 6, 2)),
        (sim.joints, "joint_length", (3, 0)),
        (sim.motion, "predicted", (3, 3, 4)),
        (sim.stats, "sweeps", (3,)),
    ):
        view = group.worlds(name)
        assert view.shape == shape, name
        assert not view.size or np.shares_memory(view, group.numpy(name))
    sim.state.worlds("velocity")[1, 2] = (3.0, 4.0)
    assert sim.state.numpy("velocity")[5].tolist() == [3, 4]
    with pytest.raises(ValueError, match="read-only"):
        sim.model.worlds("mass")[0] = 1.0


def test_worlds_of_several_sizes_are_views_of_each():
    sim = simulation()
    sim.run(30, DT)
    start = sim.model.numpy("body_start")
    for name in ("position", "angle"):
        views = sim.state.worlds(name)
        assert [len(view) for view in views] == np.diff(start).tolist()
        assert all(np.shares_memory(view, sim.state.numpy(name)) for view in views)
    assert [len(view) for view in sim.joints.worlds("joint_length")] == [1, 0]
    assert sum(len(v) for v in sim.model.worlds("vertices")) == len(sim.model.numpy("vertices"))
    slots, world = dc.contact_slots(sim.contacts)
    views = sim.contacts.worlds("impulse")
    assert [len(view) for view in views] == np.bincount(world, minlength=2).tolist()
    assert np.array_equal(np.concatenate(views), sim.contacts.numpy("impulse")[slots])
    views[0][0] = 7.0
    assert sim.contacts.numpy("impulse")[0].tolist() == [7, 7]


def test_views_stay_those_of_the_arrays_that_there_are():
    sim = simulation(contacts_per_body=0.1)
    sim.run(40, DT)
    assert np.shares_memory(sim.contacts.worlds("gap")[0], sim.contacts.numpy("gap"))
    assert np.shares_memory(sim.clone().state.worlds("position")[0], sim.state.numpy("position")) is False


def test_what_has_no_worlds_says_so():
    sim = simulation()
    with pytest.raises(ValueError, match=r"model\.vertex_start is not divided among worlds"):
        sim.model.worlds("vertex_start")
    with pytest.raises(ValueError, match=r"rows\.column is not divided among worlds"):
        sim.rows.worlds("column")
    with pytest.raises(KeyError):
        sim.state.worlds("speed")
    with pytest.raises(ValueError, match=r"state.position is of no simulation yet"):
        scene()[1].worlds("position")


def test_objects_say_what_they_are():
    sim = simulation("float64", "numpy")
    assert repr(sim) == "<Simulation of 2 worlds and 22 bodies, float64, numpy on cpu>"
    assert repr(sim.state) == "<State: 22 bodies, 2 worlds; float64, numpy on cpu>"
    assert repr(sim.joints) == "<Joints: 1 joint, 1 joint row; float64, numpy on cpu>"
    assert repr(sim.model).startswith("<Model: 2 worlds, 22 bodies, 26 shapes, ")
    assert "contacts" in repr(sim.contacts)
    sim.stats.assign("sweeps", [3, 7])
    sim.stats.assign("residual", [0.5, 1e-7])
    assert repr(sim.stats) == "<SolveStats: 2 worlds; 3 to 7 sweeps, residual up to 0.5; float64, numpy on cpu>"


def stages():
    """One stage of each kind on the arrays of a small scene."""
    model = scene("float64")[0]
    bodies = model.body_count
    position, angle = np.zeros((bodies, 2)), np.zeros(bodies)
    boxes = dc.ShapeBoxes(model, position, angle)
    boxes()
    broadphase = dc.Broadphase(dc.to_numpy(boxes.lower), dc.to_numpy(boxes.upper), model.numpy("shape_start").copy())
    pair = np.zeros((3, 2))
    solver = dc.ContactSolver(
        np.zeros(3, np.int32),
        np.ones(3, np.int32),
        None,
        pair + np.array([0.0, 1.0]),
        np.zeros(3),
        arm_a=pair,
        arm_b=pair,
        inv_mass=np.ones(2),
        inv_inertia=np.ones(2),
    )
    return {
        "ShapeBoxes: 26 shapes, 2 worlds": boxes,
        "Broadphase: 26 boxes, 2 worlds": broadphase,
        "Narrowphase: 26 shapes, 2 worlds": dc.Narrowphase(model, position, angle, broadphase),
        "NeighborSearch: 22 points, 1 world": dc.NeighborSearch(position, 0.1),
        "ContactSolver: 3 contacts, 2 bodies, 0 joints, 1 world": solver,
    }


def test_images_say_what_they_are_and_are_not_copied():
    images = dc.Images(worlds_of_one_size(2), dc.ImageSpec(grid=dc.Grid.thesis()))
    assert re.fullmatch(r"<Images: 2 worlds, \d+ channels of 61 x 61 nodes; float32, warp on cpu>", repr(images))
    for make in (copy.deepcopy, pickle.dumps):
        with pytest.raises(TypeError, match="this Images works on arrays where their owner has them"):
            make(images)


def test_stages_say_what_they_are_and_are_not_copied():
    for text, stage in stages().items():
        assert repr(stage) == f"<{text}; float64, warp on cpu>"
        name = type(stage).__name__
        for make in (copy.copy, copy.deepcopy, pickle.dumps):
            with pytest.raises(
                TypeError, match=f"this {name} works on arrays .* make another {name} on copies of them"
            ):
                make(stage)
