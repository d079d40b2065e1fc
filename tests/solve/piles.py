"""Contacts of a simulation, lent to the solver as another engine would lend them."""

from __future__ import annotations

import numpy as np

import dc_kernels as dc

DT = 0.01


def pile(dtype="float32", worlds=2, joints=False, discs=False, **options):
    """A simulation between ``collide`` and ``solve``: shapes fallen on a ground, some of them joined."""
    builder = dc.ModelBuilder()
    for w in range(worlds):
        builder.add_world()
        ground = builder.add_body(type=dc.BodyType.STATIC)
        builder.add_box(ground, 6.0, 0.5, center=(0.0, -0.5), friction=0.6)
        rng = np.random.default_rng(w)
        before = None
        for i in range(12 + 5 * w):
            at = (-2.0 + 1.02 * (i % 4) + rng.uniform(-0.02, 0.02), 0.52 + 1.03 * (i // 4))
            body = builder.add_body(position=at, velocity=(rng.uniform(-1, 1), -1.0))
            if discs or i % 2:
                builder.add_disc(body, 0.5, friction=0.4, restitution=0.3 * (i % 3))
            else:
                builder.add_box(body, 0.45, 0.5, friction=0.7)
            if joints and before is not None and i % 3 == 0:
                builder.add_distance_joint(before, body, (0.1, 0.2), (-0.2, 0.1))
            before = body
    model, state, groups = builder.finalize(dtype=dtype)
    sim = dc.Simulation(model, state, groups, **options)
    sim.run(25, DT)
    sim.collide(DT)
    return sim


def arrays_of(sim, warm=True):
    """What a simulation's contacts, bodies and joints are for a ``ContactSolver``, all of it copied."""
    contacts, model, state = sim.contacts, sim.model, sim.state
    names = ("body_a", "body_b", "normal", "gap", "friction", "restitution", "arm_a", "arm_b", "impulse", "color")
    found = {name: contacts.numpy(name).copy() for name in names}
    if not warm:
        found["impulse"][...] = 0.0
    found |= {
        "point": None,
        "inv_mass": model.numpy("inv_mass").copy(),
        "inv_inertia": model.numpy("inv_inertia").copy(),
        "count": contacts.numpy("contact_count").copy(),
        "contact_start": contacts.numpy("contact_start").copy(),
        "body_start": model.numpy("body_start").copy(),
        "velocity": sim.motion.numpy("predicted")[: model.body_count, :2].copy(),
        "angular_velocity": sim.motion.numpy("predicted")[: model.body_count, 2].copy(),
        "velocity_before": state.numpy("velocity").copy(),
        "angular_velocity_before": state.numpy("angular_velocity").copy(),
        "length_scale": model.numpy("length_scale").copy(),
        "weight": sim.motion.numpy("weight").copy(),
        "gravity": np.hypot(*model.numpy("gravity").T),
        "discs": sim.variant == "discs",
    }
    if model.joint_count:
        found["position"], found["angle"] = state.numpy("position").copy(), state.numpy("angle").copy()
        lines = ("body_a", "body_b", "anchor_a", "anchor_b", "length", "impulse")
        found["joints"] = {f"joint_{name}": sim.joints.numpy(f"joint_{name}").copy() for name in lines}
        found["joint_start"] = model.numpy("joint_start").copy()
    return found


def used(sim):
    """Slots of the contacts."""
    return dc.contact_slots(sim.contacts)[0]


def drop(dtype="float64", **changes):
    """A point mass of 2 kg that falls on the ground, body 0, at (1.5, -2) m/s; arguments by name."""
    real = np.dtype(dtype)
    found = {
        "body_a": np.zeros(1, np.int32),
        "body_b": np.ones(1, np.int32),
        "point": np.zeros((1, 2), real),
        "normal": np.array([[0, 1]], real),
        "gap": np.zeros(1, real),
        "inv_mass": np.array([0, 0.5], real),
        "inv_inertia": np.zeros(2, real),
        "position": np.zeros((2, 2), real),
        "velocity": np.array([[0, 0], [1.5, -2]], real),
        "angular_velocity": np.zeros(2, real),
        "impulse": np.zeros((1, 2), real),
    }
    return found | changes


EXACT = dc.SolverConfig(tolerance=1e-13)
