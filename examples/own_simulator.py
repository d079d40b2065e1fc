"""A simulator made only of stages, without ``dc.Simulation``: a tower of boxes, whose state is in our numpy arrays."""

import numpy as np

import dc_kernels as dc

DT, GRAVITY, FASTEST = 0.01, 9.81, 5.0  # [s], [m/s^2]; no two bodies approach each other faster [m/s]


def main(boxes: int = 8, steps: int = 150) -> float:
    """Let the tower stand; return the largest displacement of a box [m]."""
    builder = dc.ModelBuilder()  # shapes and masses; our own arrays would do as well
    builder.add_world()
    builder.add_box(builder.add_body(type=dc.BodyType.STATIC), 5.0, 0.5)
    for _ in range(boxes):
        builder.add_box(builder.add_body(), 0.5, 0.25)
    model, *_ = builder.finalize()
    position = np.zeros((boxes + 1, 2), np.float32)
    position[0, 1] = -0.5  # the ground, whose top is at 0
    position[1:, 1] = 0.25 + 0.5 * np.arange(boxes)
    angle, spin = np.zeros((2, boxes + 1), np.float32)
    velocity = np.zeros_like(position)

    # make each stage once, on these arrays, and call it in each step
    reach = FASTEST * DT
    bounds = dc.ShapeBoxes(model, position, angle, margin=reach / 2)
    filters = {"shape_body": model.shape_body, "body_type": model.body_type}
    pairs = dc.Broadphase(bounds.lower, bounds.upper, margin=0.05, **filters)
    contacts = dc.Narrowphase(model, position, angle, pairs, reach=reach, max_contacts=4 * boxes)
    solver = dc.ContactSolver(
        contacts.body_a, contacts.body_b, None, contacts.normal, contacts.gap, contacts.friction,
        arm_a=contacts.arm_a, arm_b=contacts.arm_b, count=contacts.count,
        inv_mass=model.inv_mass, inv_inertia=model.inv_inertia, velocity=velocity, angular_velocity=spin,
        config=dc.SolverConfig(position_correction="baumgarte"),
    )  # fmt: skip
    impulse, keys = solver.exchange.numpy("impulse"), np.zeros(0, np.int64)
    start = position.copy()
    for _ in range(steps):
        for stage in (bounds, pairs, contacts):
            stage()
        # start each contact from its previous impulse: keys are sorted, and a contact keeps its key
        now = contacts.numpy("key").copy()
        at = np.searchsorted(keys, now)
        known = at < len(keys)
        known[known] = keys[at[known]] == now[known]
        carried = np.zeros((len(now), 2), np.float32)
        carried[known] = impulse[at[known]]
        impulse[: len(now)], keys = carried, now
        velocity[1:, 1] -= GRAVITY * DT
        solver.solve(DT)
        position += DT * velocity
        angle += DT * spin
    moved = float(np.abs(position - start).max())
    assert len(now) == 2 * boxes, "each box stands on two points"
    assert moved < 0.01, f"the tower moved by {moved} m"
    return moved


if __name__ == "__main__":
    print(f"the tower stands; no box moved by more than {1e3 * main():.2f} mm")
