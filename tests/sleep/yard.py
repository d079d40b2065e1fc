"""A scene whose towers, stack and link fall asleep and wake apart, and what tests look at in it."""

import dataclasses
import io

import numpy as np

import dc_kernels as dc

DT = 0.01
SLEEP_CONFIG = dc.SolverConfig(sleep=True, sleep_time=0.3)
SOFT = dataclasses.replace(SLEEP_CONFIG, method="tgs_soft", substeps=3)  # a third of an impulse is rounded
FLOOR, SHELF, PLATFORM, ON_SHELF, ON_PLATFORM, LINKED, STACK = 0, 1, 2, (3, 4), (5, 6), (7, 8), (9, 10, 11)
ALL = (*ON_SHELF, *ON_PLATFORM, *LINKED, *STACK)
EVERY, LINK = set(ALL), set(LINKED)


def yard(builder, shift=0.0):
    """A floor with two linked discs and three boxes, and towers of two on a static shelf and a kinematic platform."""
    builder.add_world()
    builder.add_box(builder.add_body(type=dc.BodyType.STATIC), 20.0, 0.5, center=(0.0, -0.5))
    builder.add_box(builder.add_body((-6.0, 2.0), type=dc.BodyType.STATIC), 1.0, 0.25)
    builder.add_box(builder.add_body((6.0, 2.0), type=dc.BodyType.KINEMATIC), 1.0, 0.25)
    for x in (-6.0, 6.0):
        for k in range(2):
            builder.add_box(builder.add_body((x + 0.1 * k, 2.75 + k)), 0.5, 0.5)
    discs = builder.add_discs([(-2.0, 0.5), (-0.7, 0.5)], 0.5)
    builder.add_distance_joint(discs[0], discs[1])
    for x, y in ((2.0, 0.5), (3.1, 0.5), (2.5 + shift, 1.5)):
        builder.add_box(builder.add_body((x, y)), 0.5, 0.5)


def simulation(worlds=1, config=SLEEP_CONFIG, backend="warp", dtype="float32", **options):
    builder = dc.ModelBuilder()
    for w in range(worlds):
        yard(builder, 0.1 * w)
    return dc.Simulation(*builder.finalize(dtype, backend=backend), config=config, **options)


def asleep_in(sim):
    """The bodies that sleep."""
    return set(np.flatnonzero(sim.asleep).tolist())


def state_bits(sim, bodies=slice(None)):
    names = ("position", "angle", "velocity", "angular_velocity")
    return {name: sim.state.numpy(name)[bodies].tobytes() for name in names}


def contacts_of(sim, bodies=None):
    """Contacts of some bodies by key: impulse, colour, age and place."""
    slots, _ = dc.contact_slots(sim.contacts)
    table = {name: sim.contacts.numpy(name)[slots] for name in ("key", "body_a", "body_b", "impulse", "color", "gap")}
    return {
        int(key): (impulse.tobytes(), int(color), float(gap))
        for key, a, b, impulse, color, gap in zip(*table.values())
        if bodies is None or a in bodies or b in bodies
    }


def shot(sim, steps):
    """The linked discs slide fast into the stack."""
    sim.state.numpy("velocity")[list(LINKED)] = (8.0, 0.0)
    sim.run(steps, DT)
    return sim


def through_file(sim):
    file = io.BytesIO()
    sim.save(file)
    file.seek(0)
    return dc.Simulation.load(file)
