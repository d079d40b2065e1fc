"""Solve the contacts of pybox2d by ``dc.ContactSolver``, and compare with 10 and 300 iterations of Box2D.

Box2D finds contacts in ``Step(0, 0, 0)``, which moves nothing. In ``Step(dt, 0, 0)`` its warm start applies the
impulses in its manifolds, without an iteration. Between these calls the solver writes the impulses.
"""

import numpy as np

import dc_kernels as dc
from pipeline import scenes

DT, FRICTION = 0.01, 0.5


def settled(scene, steps):
    """Return a settled pile in Box2D, equal at each call."""
    space, bodies = scenes.to_box2d(scene)
    for _ in range(steps):
        space.Step(DT, 10, 10)
    space.Step(0.0, 0, 0)
    return space, bodies


def velocities(bodies):
    """Return velocities of the centres of mass and spins, (n, 3)."""
    return np.array([(*body.linearVelocity, body.angularVelocity) for body in bodies])


def manifold_points(space):
    """Return contact, index in its manifold and world point of all touching points."""
    for contact in space.contacts:
        if contact.touching:
            world = contact.worldManifold  # keep a reference: its points lie in its memory
            for k in range(contact.manifold.pointCount):
                yield contact, k, tuple(world.points[k]), tuple(world.normal)


def solve_by_ours(space, bodies, config):
    """Solve the contacts of a Box2D world, write their impulses back, and let Box2D move by them."""
    rows = list(manifold_points(space))
    real = np.float64
    velocity = velocities(bodies)
    moving = np.array([body.mass > 0 for body in bodies])
    velocity[moving, :2] += DT * np.array(tuple(space.gravity))
    impulse = np.array([(p.normalImpulse, p.tangentImpulse) for p in (c.manifold.points[k] for c, k, *_ in rows)], real)
    v, spin = np.ascontiguousarray(velocity[:, :2]), np.ascontiguousarray(velocity[:, 2])
    solver = dc.ContactSolver(
        np.array([c.fixtureA.body.userData for c, *_ in rows], np.int32),
        np.array([c.fixtureB.body.userData for c, *_ in rows], np.int32),
        np.array([point for *_, point, _ in rows], real),
        np.array([normal for *_, normal in rows], real) / np.linalg.norm([n for *_, n in rows], axis=1)[:, None],
        np.zeros(len(rows), real),  # gaps of 0: touching surfaces may not approach
        np.array([c.friction for c, *_ in rows], real),
        inv_mass=np.array([1.0 / body.mass if body.mass else 0.0 for body in bodies], real),
        inv_inertia=np.array([1.0 / body.inertia if body.inertia else 0.0 for body in bodies], real),
        position=np.array([tuple(body.worldCenter) for body in bodies], real),
        config=config,
    )
    stats = solver.solve(DT, v, spin, impulse)
    for (contact, k, *_), (normal, tangent) in zip(rows, impulse.tolist()):
        point = contact.manifold.points[k]
        point.normalImpulse, point.tangentImpulse = normal, tangent
    space.Step(DT, 0, 0)
    return np.column_stack([v, spin]), int(stats.numpy("sweeps")[0])


def main(bodies: int = 100, steps: int = 300) -> dict[str, float]:
    """Compare one step of a pile; return the largest differences of velocities and of spins times the radius [m/s]."""
    scene = scenes.Thesis(bodies=bodies, friction=FRICTION)
    unit = np.array([1.0, 1.0, scene.radius])
    config = dc.SolverConfig(tolerance=1e-10, max_sweeps=20_000)
    space, ours = settled(scene, steps)
    solved, sweeps = solve_by_ours(space, ours, config)
    found = {"sweeps": sweeps, "written back": float(np.abs((velocities(ours) - solved) * unit).max())}
    for iterations in (10, 300):
        space, theirs = settled(scene, steps)
        space.Step(DT, iterations, 0)
        found[f"{iterations} iterations"] = float(np.abs((velocities(theirs) - solved) * unit).max())
    assert found["written back"] < 1e-4, found  # Box2D computes in float32
    assert found["300 iterations"] < 0.3 * found["10 iterations"], found  # Box2D converges to our result
    return found


if __name__ == "__main__":
    for name, value in main().items():
        print(f"{name:>16}: {value:.3g}")
