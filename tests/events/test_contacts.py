"""Contact events: what begins to touch, ceases to, and hits."""

import dataclasses
import math

import numpy as np
import pytest

import dc_kernels as dc
from tests.driving.scenes import simulation
from tests.events.test_sensors import pairs_of

DT = 0.01
EVENTS = dc.SolverConfig(contact_events=True)


def test_a_ball_hits_with_the_speed_that_it_has_fallen_with():
    """From a height h it hits at sqrt(2 g h), then at e times that, to what a step adds to it; below 1 m/s no more."""
    g, height, e = 9.8, 2.0, 0.6
    builder = dc.ModelBuilder()
    for _ in range(2):
        builder.add_world(gravity=(0.0, -g), origin=(30.0, 0.0))
        floor = builder.add_body((30.0, 0.0), type=dc.BodyType.STATIC)
        builder.add_box(floor, 5.0, 0.5, center=(0.0, -0.5))
        builder.add_discs([(31.0, 0.5 + height)], 0.5, restitution=e)
    sim = dc.Simulation(*builder.finalize("float64"), config=EVENTS)
    hits, begun, ended = [], 0, 0
    for _ in range(700):
        sim.step(DT / 4)
        found = dc.contact_events(sim, "hit")
        assert found.shape_a.tolist() in ([], [0, 2]) and found.shape_b.tolist() in ([], [1, 3])
        if len(found.slot):
            assert found.world.tolist() == [0, 1]
            hits.append(sim.touches.numpy("hit_speed")[found.slot])
            np.testing.assert_allclose(sim.touches.numpy("hit_point")[found.slot], [(1.0, 0.0)] * 2, atol=0.02)
            np.testing.assert_allclose(sim.touches.numpy("hit_normal")[found.slot], [(0.0, 1.0)] * 2, atol=1e-9)
        begun += len(dc.contact_events(sim, "begun").slot) // 2
        ended += len(dc.contact_events(sim, "ended").slot) // 2
    speed = math.sqrt(2 * g * height)
    want = [speed, e * speed]
    assert np.array(hits)[:2] == pytest.approx(np.stack([want, want], axis=1), rel=0.02)
    assert begun == len(hits) and 0 <= begun - ended <= 1


@pytest.mark.parametrize("threads", [1, 2])
def test_events_are_those_of_a_look_after_each_step(threads):
    """Against the bookkeeping of dc.ContactEvents, in piles of all kinds of shapes."""
    config = dc.SolverConfig(tolerance=1e-5, max_sweeps=60, contact_events=True)
    sim, plain = simulation("float64", config=config, threads=threads), simulation("float64")
    look = dc.ContactEvents(sim)
    begun = ended = 0
    for _ in range(80):
        sim.step(DT)
        plain.step(DT)
        look.update()
        for which, seen in (("begun", look.begun), ("ended", look.ended), ("all", look.touching)):
            found = dc.contact_events(sim, which)
            assert pairs_of(found) == pairs_of(seen)
            order = np.lexsort((seen.shape_b, seen.shape_a))
            if which == "all":
                mine = np.lexsort((np.maximum(found.shape_a, found.shape_b), np.minimum(found.shape_a, found.shape_b)))
                np.testing.assert_allclose(sim.touches.numpy("impulse")[found.slot][mine], seen.impulse[order])
        begun += len(look.begun.impulse)
        ended += len(look.ended.impulse)
    assert min(begun, ended) > 5
    for name in ("position", "velocity"):
        assert sim.state.numpy(name).tobytes() == plain.state.numpy(name).tobytes()
    assert not plain.touches.nbytes()


def test_events_are_switched_on_and_off_between_steps():
    sim = simulation("float64")
    sim.run(80, DT)
    sim.config = dataclasses.replace(sim.config, contact_events=True)
    sim.step(DT)
    assert len(dc.contact_events(sim, "begun").slot) == len(dc.contact_events(sim).slot) > 3
    assert "contact events:" in sim.explain() and "note_touches" in sim.explain()
    sim.config = dataclasses.replace(sim.config, contact_events=False)
    assert not sim.touches.nbytes()
    sim.step(DT)


def test_soft_contacts_have_events():
    config = dc.SolverConfig(method="tgs_soft", substeps=4, contact_events=True)
    builder = dc.ModelBuilder()
    builder.add_world()
    builder.add_box(builder.add_body(type=dc.BodyType.STATIC), 5.0, 0.5, center=(0.0, -0.5))
    builder.add_box(builder.add_body((0.0, 1.0)), 0.5, 0.5)
    sim = dc.Simulation(*builder.finalize("float64"), config=config)
    found = []
    sim.run(
        60, DT, callback=lambda sim: found.extend(sim.touches.numpy("hit_speed")[dc.contact_events(sim, "hit").slot])
    )
    assert found == pytest.approx([math.sqrt(2 * 9.8 * 0.5)], rel=0.05)
    assert len(dc.contact_events(sim).slot) == 1
