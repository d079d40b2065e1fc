"""Numbers that are not finite, written in place: each stops its world, has no effect, or cannot be written."""

import numpy as np
import pytest

import dc_kernels as dc

DT = 0.01
METHODS = {
    "pgs": dc.SolverConfig(),
    "jacobi": dc.SolverConfig(method="jacobi"),
    "tgs_soft": dc.SolverConfig(method="tgs_soft", substeps=2),
}
GROUPS = ("model", "state", "joints", "contacts", "cache")
SEEN = ("position", "angle", "velocity", "angular_velocity")
BODIES = 3  # one of each type, of a world, that are written to


def add_world(builder: dc.ModelBuilder, kinds: bool) -> None:
    """A ground, a kinematic and a dynamic body first; then joints of all kinds, or one rod."""
    builder.add_world()
    builder.add_box(builder.add_body(type=dc.BodyType.STATIC), 20.0, 0.5, center=(0.0, -0.5))
    lift = builder.add_body((0.0, 8.0), type=dc.BodyType.KINEMATIC, velocity=(0.1, 0.0))
    builder.add_box(lift, 0.2, 0.2)
    builder.add_disc(builder.add_body((11.0, 0.49)), 0.5, restitution=0.3)

    def two(x: float) -> list[int]:
        pair = [builder.add_body((x, 0.3 + i)) for i in range(2)]
        for body in pair:
            builder.add_disc(body, 0.3)
        return pair

    ends = (0.0, 0.5), (0.0, -0.5)
    builder.add_distance_joint(*two(-15.0), *ends, 0.3)
    if not kinds:
        return
    spring, limits = {"frequency": 4.0, "damping_ratio": 0.5}, {"lower": -0.2, "upper": 0.2}
    builder.add_distance_joint(*two(-13.0), length=1.0, lower=0.5, upper=1.5, **spring)
    builder.add_rope_joint(*two(-11.0), max_length=1.1)
    builder.add_revolute_joint(*two(-9.0), *ends, **limits, motor_speed=1.0, max_motor_torque=3.0)
    builder.add_prismatic_joint(*two(-7.0), (0.0, 1.0), *ends, **limits, motor_speed=1.0, max_motor_force=3.0)
    builder.add_weld_joint(*two(-5.0), *ends, **spring)
    builder.add_wheel_joint(*two(-1.0), (0.0, 1.0), *ends, **spring, **limits, motor_speed=1.0, max_motor_torque=3.0)
    builder.add_target_joint(*two(1.0), max_force=100.0)
    builder.add_gear_joint(*two(3.0), 2.0)
    builder.add_general_joint(*two(5.0), (0.0, 1.0, 0.0), (0.0, -1.0, 0.0), lower=-10.0, upper=10.0)


def places(sim: dc.Simulation) -> list[tuple[str, str, int]]:
    """Numbers of the first world that may be written in place: group, field, and which one of those of the world."""
    found = []
    for group in GROUPS:
        held = getattr(sim, group)
        for name, field in held.table.items():
            array = held.numpy(name)
            if array.dtype.kind != "f" or not array.flags.writeable or not field.axes:
                continue
            if field.per in ("contact", "rolling contact"):
                count = min(int(sim.contacts.numpy("contact_count")[0]), BODIES)
            else:
                count = len(held.worlds(name)[0]) if field.per != "world" else 1
                count = min(count, BODIES) if field.per == "body" else count
            found += [(group, name, i) for i in range(count * array[0].size if len(array) else 0)]
    return found


def world_part(sim: dc.Simulation, group: str, name: str, w: int) -> np.ndarray:
    """The numbers of a field that are of a world, to be written to, whatever their shape."""
    held = getattr(sim, group)
    array = held.numpy(name)
    per = held.table[name].per
    if per == "world":
        return array[w].reshape(-1)[:] if array.ndim > 1 else array[w : w + 1]
    starts = {
        "body": sim.model.numpy("body_start"),
        "joint": sim.model.numpy("joint_start"),
        "joint row": sim.joints.numpy("joint_row_start")[sim.model.numpy("joint_start")],
        "contact": sim.contacts.numpy("contact_start"),
    }
    return array[starts[per][w] : starts[per][w + 1]].reshape(-1)


@pytest.mark.parametrize("kinds", [True, False], ids=["joints", "rods"])
def test_every_number_that_may_be_written_in_place_is_met_or_means_nothing(kinds):
    """A world each for the numbers of a world, one of which is not finite there, and one more in which all are."""
    builder = dc.ModelBuilder()
    add_world(builder, kinds)
    one = dc.Simulation(*builder.finalize("float64"))
    one.run(5, DT)
    found = places(one)
    assert {"joint_length", "joint_impulse", "velocity", "time", "gravity", "origin"} <= {name for _, name, _ in found}
    assert "contact_dt" not in {name for _, name, _ in found}
    for _ in found:
        add_world(builder, kinds)
    sim = dc.Simulation(*builder.finalize("float64"))
    for method, config in METHODS.items():
        sim.reset()
        sim.config = config
        sim.run(5, DT)
        for bad in (np.nan, np.inf, -np.inf) if method == "pgs" else (np.nan,):
            tried = sim.clone()
            for w, (group, name, i) in enumerate(found):
                world_part(tried, group, name, w)[i] = bad
            tried.run(2, DT)
            flags = tried.state.numpy("flags")
            assert flags[-1] == 0
            for w, (group, name, i) in enumerate(found):
                if flags[w] == dc.Flag.NONFINITE:
                    continue
                assert flags[w] == 0
                for seen in SEEN:  # what has met nothing has the bits of the world where nothing was written
                    alike = [np.asarray(tried.state.worlds(seen)[k]).tobytes() for k in (w, -1)]
                    assert alike[0] == alike[1], (method, bad, group, name, i)


def test_the_oracle_stops_where_warp_does():
    builder = dc.ModelBuilder()
    for w in range(7):
        add_world(builder, False)
        builder.add_revolute_joint(5 * w + 1, 5 * w + 2, lower=-3.0, upper=3.0, motor_speed=1.0, max_motor_torque=1.0)
    for backend in ("numpy", "warp"):
        sim = dc.Simulation(*builder.finalize("float64", backend=backend))
        sim.run(2, DT)
        for w, name in enumerate(("reference", "speed", "strength", "lower", "impulse")):
            group = "cache" if name == "impulse" else "joints"
            world_part(sim, group, f"joint_{name}", w)[-1] = -np.inf
        sim.state.worlds("velocity")[5][0] = np.nan  # of the ground
        sim.run(2, DT)
        assert sim.state.numpy("flags").tolist() == [dc.Flag.NONFINITE] * 6 + [0], backend
        np.testing.assert_allclose(sim.state.numpy("time"), [2 * DT] * 6 + [4 * DT])
