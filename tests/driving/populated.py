"""Worlds that bodies are added to and removed from."""

import dc_kernels as dc
from dc_kernels.model.validate.scene import check_joints, check_model, check_state

DT = 0.01
CONFIG = dc.SolverConfig(tolerance=1e-6, max_sweeps=80)
FIELDS = ("position", "angle", "velocity", "angular_velocity")


def ground(builder):
    floor = builder.add_body(type=dc.BodyType.STATIC)
    builder.add_chain(floor, ((-3, 3), (-3, 0), (3, 0), (3, 3)))
    return floor


def first(builder):
    """What a world begins with."""
    discs = builder.add_discs([(-2.0 + 0.5 * i, 0.24) for i in range(4)], 0.25, angular_velocity=0.5)
    box = builder.add_body((0.5, 0.3), angle=0.1)
    builder.add_box(box, 0.4, 0.25, radius=0.01)
    return [*discs, box]


def second(builder):
    """What comes: a dumbbell of two shapes, a capsule, a disc that is pushed."""
    dumbbell = builder.add_body((-1.5, 0.9), angle=0.3)
    builder.add_disc(dumbbell, 0.2, center=(-0.3, 0.0))
    builder.add_box(dumbbell, 0.15, 0.15, center=(0.3, 0.0))
    capsule = builder.add_body((0.6, 1.1))
    builder.add_capsule(capsule, (-0.3, 0.0), (0.3, 0.1), 0.15)
    disc = builder.add_body((1.5, 0.4), velocity=(-1.0, 0.0))
    builder.add_disc(disc, 0.25)
    return [dumbbell, capsule, disc]


def build(*parts, worlds=1, dtype="float32", backend="warp", **options):
    """A simulation of worlds that each have some parts from the beginning."""
    builder = dc.ModelBuilder()
    for _ in range(worlds):
        builder.add_world(length_scale=0.5)
        ground(builder)
        for part in parts:
            part(builder)
    options.setdefault("config", CONFIG)
    return dc.Simulation(*builder.finalize(dtype, backend=backend), **options)


def add(sim, part, world=None):
    more = sim.additions(world)
    part(more)
    return sim.add(more)


def bits(sim, bodies):
    return {name: sim.state.numpy(name)[bodies].tobytes() for name in FIELDS}


def check(sim):
    """The arrays are those of a scene."""
    model = sim.model.views()
    check_model(model)
    check_state(sim.state.views(), model)
    check_joints(sim.joints.views(), model)
