"""Compare one scene here and in pymunk with the closed form: a box that slides to rest over v^2 / (2 mu g)."""

import dc_kernels as dc
from pipeline import scenes

SPEED, FRICTION, GRAVITY = 3.0, 0.3, 9.81
WAY = SPEED**2 / (2.0 * FRICTION * GRAVITY)  # [m]


def scene() -> dc.ModelBuilder:
    """A box of 1 m x 0.4 m, thrown along a floor."""
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0.0, -GRAVITY))
    floor = builder.add_body(type=dc.BodyType.STATIC)
    builder.add_chain(floor, [(-10.0, 0.0), (10.0, 0.0)], friction=FRICTION)
    box = builder.add_body((0.0, 0.2), velocity=(SPEED, 0.0))
    builder.add_box(box, 0.5, 0.2, friction=FRICTION)
    return builder


def main(steps_per_second=(50, 100, 400)) -> dict[int, tuple[float, float]]:
    """Return the errors of the sliding distance here and in pymunk, by steps per second [m]."""
    found = {}
    for rate in steps_per_second:
        steps = int(1.5 * rate)  # it comes to rest after v / (mu g) = 1.02 s
        sim = dc.Simulation(*scene().finalize("float64"))
        sim.run(steps, 1.0 / rate)
        space, bodies = scenes.to_pymunk(scene())
        for _ in range(steps):
            space.step(1.0 / rate)
        ours, theirs = sim.state.numpy("position")[1, 0], bodies[1].position.x
        found[rate] = abs(ours - WAY), abs(theirs - WAY)
        # semi-implicit Euler is off by the distance of half a step
        assert found[rate][0] < 0.6 * SPEED / rate, found
        assert found[rate][1] < 2.0 * SPEED / rate, found
        assert abs(sim.state.numpy("velocity")[1, 0]) < 1e-6, "it rests"
    return found


if __name__ == "__main__":
    print(f"the way is {WAY:.4f} m; by how much it is wrong [mm]:")
    for rate, (ours, theirs) in main().items():
        print(f"  {rate:4d} steps a second: here {1e3 * ours:7.3f}, pymunk {1e3 * theirs:7.3f}")
