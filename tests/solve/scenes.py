"""Scenes that solvers are compared in."""

from dataclasses import replace

import numpy as np

import dc_kernels as dc
from dc_kernels import measure

DT = 0.01


def box(builder, side=1.6, height=4.0, **material):
    """A static box of chain segments, open at the top."""
    ground = builder.add_body(type=dc.BodyType.STATIC)
    builder.add_chain(ground, ((-side, height), (-side, 0), (side, 0), (side, height)), **material)
    return ground


def add_pile(builder, variant, seed, n=14):
    """A world of one variant of the solver rows: discs only, polygons among them, joints among them."""
    rng = np.random.default_rng(seed)
    builder.add_world()
    box(builder, friction=0.4)
    positions = np.stack((rng.uniform(-1.2, 1.2, n), 0.3 + 0.28 * np.arange(n)), axis=1)
    if variant == "discs":
        builder.add_discs(positions, rng.uniform(0.12, 0.24, n), density=rng.uniform(0.5, 4, n), friction=0.5)
        return
    last = None
    for i, position in enumerate(positions):
        body = builder.add_body(position, angle=rng.uniform(0, 6), angular_velocity=rng.normal())
        if i % 3 == 0:
            builder.add_disc(body, rng.uniform(0.12, 0.24), center=(0.03, 0.0))
        else:
            builder.add_box(body, rng.uniform(0.1, 0.25), rng.uniform(0.1, 0.2), density=rng.uniform(0.5, 4))
        if variant == "joints" and last is not None and i % 2:
            builder.add_distance_joint(last, body, (0.05, 0.0), (0.0, 0.05))
        last = body


def pile(variant, dtype="float32", seeds=(0, 1, 2), n=14, config=None, **options):
    """Worlds of one variant with n bodies, one for each seed."""
    builder = dc.ModelBuilder()
    for seed in seeds:
        add_pile(builder, variant, seed, n)
    return dc.Simulation(*builder.finalize(dtype), config=config or dc.SolverConfig(), **options)


def used(sim):
    """Contact slots in use and the world of each."""
    return measure.contact_slots(sim.contacts)


def solve_from(sim, start=0.0, **changes):
    """Solve the present contacts from given start impulses: impulses of contacts and joints, velocities (n, 3)."""
    slots, _ = used(sim)
    sim.contacts.numpy("impulse")[slots] = start
    sim.joints.numpy("joint_impulse")[:] = 0.0
    sim.config = replace(sim.config, **changes)
    sim.solve()
    return (
        sim.contacts.numpy("impulse")[slots].copy(),
        sim.joints.numpy("joint_impulse").copy(),
        sim.motion.numpy("solved")[: sim.model.body_count, :3].copy(),
    )


def as_bytes(values):
    """Bits of numbers; -0 counts as 0 (clamping to a limit of zero leaves either, and neither acts)."""
    return (values + np.zeros(1, values.dtype)).tobytes()


def bits(sim):
    """State, contacts in use and what the solves reported, as bytes."""
    slots, _ = used(sim)
    arrays = [sim.state.numpy(name) for name in sim.state.table]
    arrays += [sim.contacts.numpy(name)[slots] for name in ("key", "impulse", "color", "age", "gap")]
    arrays += [sim.stats.numpy(name) for name in ("sweeps", "change", "residual")]
    return [as_bytes(a) for a in [*arrays, sim.joints.numpy("joint_impulse")]]


def dense(sim):
    """Jacobian (2c, 3b), inverse masses (3b,), predicted velocities, bias and friction of world 0, from the arrays.

    Rows: normal, then tangent, of each contact: J = [-n, -r_A x n, n, r_B x n] (Wu 2018, equations 2.21 and
    2.22), written out here from contact geometry alone, without the solver's rows. The bias of a gap above the slop is
    gap / dt; there is no restitution.
    """
    slots, _ = used(sim)
    get = {n: sim.contacts.numpy(n)[slots].astype(float) for n in ("normal", "arm_a", "arm_b", "gap", "friction")}
    a, b = (sim.contacts.numpy(n)[slots] for n in ("body_a", "body_b"))
    bodies, c = sim.model.body_count, len(slots)
    j = np.zeros((2 * c, 3 * bodies))
    for k in range(c):
        nx, ny = get["normal"][k]
        for row, d in ((2 * k, (nx, ny)), (2 * k + 1, (ny, -nx))):
            for body, arm, sign in ((a[k], get["arm_a"][k], -1.0), (b[k], get["arm_b"][k], 1.0)):
                j[row, 3 * body : 3 * body + 3] += sign * np.array([*d, arm[0] * d[1] - arm[1] * d[0]])
    inverse = np.stack([sim.model.numpy(n).astype(float) for n in ("inv_mass", "inv_mass", "inv_inertia")], axis=1)
    moving = sim.model.numpy("body_type") == dc.BodyType.DYNAMIC
    velocity = np.column_stack((sim.state.numpy("velocity"), sim.state.numpy("angular_velocity"))).astype(float)
    velocity[:, :2] += moving[:, None] * sim.model.numpy("gravity")[0] * DT
    slop = sim.config.slop * sim.model.numpy("length_scale")[0]
    bias = np.where(get["gap"] > slop, get["gap"], 0.0) / DT
    return j, inverse.ravel(), velocity.ravel(), bias, get["friction"]


def check_laws(sim, impulse, solved, tolerance):
    """Signorini and Coulomb, with relative velocities from the dense Jacobian."""
    j, _, _, bias, friction = dense(sim)
    u = (j @ solved.ravel().astype(float)).reshape(-1, 2)
    un, ut = u[:, 0] + bias, u[:, 1]
    pn, pt = impulse.astype(float).T
    assert (pn >= 0).all()
    assert (np.abs(pt) <= friction * pn * (1 + 1e-6)).all()
    assert un.min() > -tolerance  # surfaces don't overlap more
    assert np.abs(pn * un).max() < tolerance * pn.max()  # an impulse only where they touch
    inside = np.abs(pt) < friction * pn - 1e-3 * pn.max()
    assert np.abs(ut[inside]).max(initial=0) < tolerance  # no sliding inside the cone
    sliding = np.abs(ut) > 100 * tolerance
    assert (pt[sliding] * ut[sliding] <= 0).all()  # friction against the sliding
    np.testing.assert_allclose(np.abs(pt[sliding]), friction[sliding] * pn[sliding], atol=1e-3 * pn.max())
    return inside


def settled(dtype="float64", **options):
    sim = pile("discs", dtype, seeds=(4, 5), **options)
    sim.run(150, DT)
    sim.collide(DT)
    return sim
