"""A scene with added and removed bodies: a cannon fires discs at a tower, old discs are removed, a rope lifts a crate.

Slots are reserved once, so that no array is allocated while it runs, and new discs reuse the slots of removed ones.
"""

import numpy as np

import dc_kernels as dc

DT, LIVES, EVERY = 0.01, 6, 10  # steps between two shots; so many shots are in the air at once


def make() -> tuple[dc.Simulation, np.ndarray]:
    """Return a floor with a tower of crates, and the ids of the crates."""
    builder = dc.ModelBuilder()
    builder.add_world()
    floor = builder.add_body(type=dc.BodyType.STATIC)
    builder.add_box(floor, 20.0, 0.5, center=(0.0, -0.5))
    crates = []
    for level in range(5):
        crates.append(builder.add_body((4.0, 0.4 + 0.8 * level)))
        builder.add_box(crates[-1], 0.4, 0.4)
    return dc.Simulation(*builder.finalize()), np.array(crates)


def main(shots: int = 40) -> tuple[int, float]:
    """Fire; return how many crates are still in place, and how high a rope has lifted the lowest [m]."""
    sim, crates = make()
    sim.reserve(bodies=LIVES, shapes=LIVES)
    places = sim.state.numpy("position")  # a view
    before = places[sim.index(bodies=crates)].copy()
    flying: list[int] = []
    for _ in range(shots):
        if len(flying) == LIVES:
            sim.remove(bodies=flying.pop(0))
        shot = sim.additions()
        ball = shot.add_body((-4.0, 1.0), velocity=(14.0, 3.0))
        shot.add_disc(ball, 0.2, density=4.0)
        flying.append(int(sim.add(shot).bodies[ball]))
        sim.run(EVERY, DT)
    assert np.shares_memory(places, sim.state.numpy("position"))  # the slots were enough
    left = int((np.hypot(*(places[sim.index(bodies=crates)] - before).T) < 0.1).sum())

    sim.remove(bodies=flying)
    lift = sim.additions()
    hook = lift.add_body((4.0, 6.0), type=dc.BodyType.KINEMATIC, velocity=(0.0, 1.0))
    lift.add_rope_joint(hook, lift.existing(crates[0]))
    rope = sim.add(lift)
    sim.run(300, DT)
    raised = float(sim.state.numpy("position")[sim.index(bodies=crates[0])][0, 1])
    sim.remove(joints=rope.joints)
    sim.run(200, DT)
    dropped = float(sim.state.numpy("position")[sim.index(bodies=crates[0])][0, 1])
    assert left < len(crates), "no shot has hit the tower"
    assert raised > 1.5 > dropped, (raised, dropped)
    return left, raised


if __name__ == "__main__":
    standing, height = main()
    print(f"{standing} of 5 crates stand where they stood; the rope lifted one to {height:.2f} m, and let it go")
