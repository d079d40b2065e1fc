"""Small scenes for the tests of driving calls, and all their bits."""

import numpy as np

import dc_kernels as dc
from dc_kernels.model.fields import PER_CONTACT

DT = 0.01


def scene(dtype="float32", backend="warp", traits=False):
    """A pile of discs and polygons on a chain with a joint, and a world of discs only; maybe damped and on belts."""
    rolls = {"rolling_resistance": 0.1, "linear_damping": 0.2, "gravity_scale": 0.9} if traits else {}
    rng = np.random.default_rng(3)
    builder = dc.ModelBuilder()
    builder.add_world(origin=(100.0, 0.0))
    ground = builder.add_body((100, 0), type=dc.BodyType.STATIC)
    builder.add_chain(ground, ((-1, 3), (-1, 0), (1, 0), (1, 3)), restitution=0.5)
    discs = builder.add_discs(
        np.stack((100 + rng.uniform(-0.8, 0.8, 8), np.arange(8) * 0.25 + 0.2), axis=1), 0.12, **rolls
    )
    for i in range(3):
        builder.add_box(builder.add_body((99.5 + 0.4 * i, 2.4), angle=0.1 * i), 0.15, 0.1, radius=0.02)
    builder.add_distance_joint(discs[0], discs[1])
    builder.add_world(gravity=(0.0, -5.0))
    ground = builder.add_body(type=dc.BodyType.STATIC)
    builder.add_chain(ground, ((-1, 3), (-1, 0), (1, 0), (1, 3)))
    builder.add_discs(np.stack((rng.uniform(-0.8, 0.8, 9), np.arange(9) * 0.25 + 0.2), axis=1), 0.12, **rolls)
    return builder.finalize(dtype, backend=backend)


def simulation(dtype="float32", backend="warp", traits=False, **options):
    options.setdefault("config", dc.SolverConfig(tolerance=1e-5, max_sweeps=60))
    return dc.Simulation(*scene(dtype, backend, traits), **options)


def bits(sim):
    """Everything that the groups hold, by name."""
    groups = {"model": sim.model, "state": sim.state, "joints": sim.joints, **sim.storage.groups()}
    return {
        f"{name}.{field}": (group.numpy(field).dtype, group.numpy(field).tobytes())
        for name, group in groups.items()
        for field in group.table
    }


def worlds_of_one_size(worlds=3, aside=0.1):
    """Two discs on a floor in each world, each of its own height."""
    builder = dc.ModelBuilder()
    for w in range(worlds):
        builder.add_world()
        ground = builder.add_body(type=dc.BodyType.STATIC)
        builder.add_box(ground, 5.0, 0.5, center=(0.0, -0.5))
        builder.add_discs([(0.0, 0.5 + 0.01 * w), (aside, 1.6)], 0.5)
    return dc.Simulation(*builder.finalize())


def of_worlds(sim, worlds):
    """What the steps to come depend on, and what they give, in some worlds; contacts without their slots."""
    found = {}
    slots, world = dc.contact_slots(sim.contacts)
    for group in ("state", "joints", "contacts"):
        for name, field in getattr(sim, group).table.items():
            values = getattr(sim, group).numpy(name)
            if field.per in PER_CONTACT and len(values):
                values = values[slots[np.isin(world, worlds)]]
            elif field.per in ("body", "joint"):
                start = sim.model.numpy(f"{field.per}_start")
                values = np.concatenate([values[start[w] : start[w + 1]] for w in worlds])
            elif field.per == "world":
                values = values[worlds]
            else:
                continue
            found[f"{group}.{name}"] = values.tobytes()
    return found
