"""The contacts of another engine solved by ours: a pile in pybox2d, read by its Python interface and written back.

What stands between the caller's arrays and the caller's arrays is timed beside a simulation that holds the contacts of
this pile itself, at as many sweeps.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable
from typing import Any

import numpy as np

from bench import timing

SUMMARY = "contacts of a pile in pybox2d: ContactSolver beside Simulation.solve, W beside SciPy, impulses written back"
KEYS = (
    "call_over_sim_solve",
    "whole_call_over_sim_solve",
    "first_call_ms",
    "first_call_over_pack",
    "box2d_velocity_difference",
    "assemble_ns_per_contact",
    "scipy_assemble_ns_per_contact",
)
THREADS = 1

SIZES = (100, 1_000)  # discs
ROUNDS, ROUNDS_QUICK = 101, 31
REPEATS = 20  # calls timed together
REAL = np.float32


def measure(quick: bool) -> dict[str, Any]:
    """The worst of all sizes, and each size by itself."""
    rounds = ROUNDS_QUICK if quick else ROUNDS
    found = {size: measure_pile(size, rounds) for size in SIZES}
    values = {key: max(pile[key] for pile in found.values()) for key in KEYS}
    return {**values, **{f"{key}_{size}": value for size, pile in found.items() for key, value in pile.items()}}


def settled(discs: int) -> tuple[Any, list[Any], Any]:
    """A pile in pybox2d that has come to rest, its discs, and the world as peers have it; contacts are up to date."""
    from bench import cases
    from bench.peers import peers
    from pipeline import scenes

    world = cases.disc_worlds(scenes.Thesis(bodies=discs), 1)[0]
    space, bodies = peers.build_pybox2d(world)
    for _ in range(cases.SETTLING[discs]):
        space.Step(cases.DT, 20, 10)
    space.Step(0.0, 0, 0)  # finds the contacts of these positions, and moves nothing
    return space, bodies, world


def touching(space: Any) -> list[Any]:
    """The contacts of a pybox2d world that touch; each has one point, as discs have."""
    return [contact for contact in space.contacts if contact.touching]


def read(space: Any, bodies: list[Any], world: Any, dtype: Any = REAL) -> dict[str, Any]:
    """Contacts and bodies as ``ContactSolver`` takes them; body 0 is the ground, velocities have gravity applied."""
    from bench import cases

    contacts = touching(space)
    points = [contact.worldManifold for contact in contacts]
    manifolds = [contact.manifold.points[0] for contact in contacts]
    mass = [0.0, *(1.0 / body.mass for body in bodies)]
    velocity = np.array([(0.0, 0.0), *(tuple(body.linearVelocity) for body in bodies)])
    velocity[1:] += cases.DT * np.array(world.gravity)
    place = np.array([(0.0, 0.0), *(tuple(body.position) for body in bodies)])
    overlap = np.array([point.points[0] for point in points]).reshape(-1, 2)
    found = {
        "body_a": np.array([contact.fixtureA.body.userData for contact in contacts], np.int32),
        "body_b": np.array([contact.fixtureB.body.userData for contact in contacts], np.int32),
        "point": overlap.astype(dtype),
        "normal": np.array([tuple(point.normal) for point in points], dtype),
        "gap": np.zeros(len(contacts), dtype),  # what touches may not approach
        "friction": np.full(len(contacts), world.friction, dtype),
        "inv_mass": np.array(mass, dtype),
        "inv_inertia": np.array([0.0, *(1.0 / body.inertia for body in bodies)], dtype),
        "position": place.astype(dtype),
        "velocity": velocity.astype(dtype),
        "angular_velocity": np.array([0.0, *(body.angularVelocity for body in bodies)], dtype),
        "impulse": np.array([(point.normalImpulse, point.tangentImpulse) for point in manifolds], dtype),
    }
    return found


def write_back(space: Any, bodies: list[Any], impulse: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Give pybox2d our impulses and let it apply them by its warm start, without an iteration; its velocities then."""
    from bench import cases

    for contact, (normal, tangential) in zip(touching(space), impulse.tolist(), strict=True):
        point = contact.manifold.points[0]
        point.normalImpulse, point.tangentImpulse = normal, tangential
    space.Step(cases.DT, 0, 0)
    velocity = np.array([tuple(body.linearVelocity) for body in bodies])
    return velocity, np.array([body.angularVelocity for body in bodies])


def same_in_simulation(given: dict[str, Any], world: Any, config: Any) -> Any:
    """A simulation of these discs, in the middle of a step, whose contacts are those given."""
    import dc_kernels as dc
    from bench import cases

    builder = dc.ModelBuilder()
    builder.add_world(gravity=world.gravity)
    builder.add_chain(builder.add_body(type=dc.BodyType.STATIC), [tuple(wall[0]) for wall in world.walls])
    place = given["position"][1:]
    builder.add_discs(place.tolist(), world.radii[0], density=world.density, friction=world.friction)
    model, state, joints = builder.finalize()
    state.assign("velocity", given["velocity"] - cases.DT * np.array([(0.0, 0.0), *[world.gravity] * len(place)], REAL))
    state.assign("angular_velocity", given["angular_velocity"])
    room = len(given["body_a"]) / model.body_count + 1.0
    sim = dc.Simulation(model, state, joints, config=config, contacts_per_body=max(room, 4.0))
    sim.collide(cases.DT)
    names = ("body_a", "body_b", "normal", "gap", "friction", "impulse")
    arrays = {name: given[name] for name in names}
    for side in "ab":
        arrays[f"arm_{side}"] = given["point"] - given["position"][given[f"body_{side}"]]
    arrays["color"] = np.full(len(given["body_a"]), -1, np.int32)
    for name, values in arrays.items():
        whole = sim.contacts.numpy(name).copy()
        whole[: len(values)] = values
        sim.contacts.assign(name, whole)
    sim.contacts.assign("contact_count", [len(given["body_a"])])
    for name in ("color_constraints", "pack_rows"):
        sim.bind(name, 0, 1)()
    return sim


def measure_pile(discs: int, rounds: int) -> dict[str, Any]:
    """All figures of a pile; ratios are medians of those of each round."""
    import dc_kernels as dc
    from bench import cases

    space, bodies, world = settled(discs)
    given = read(space, bodies, world)
    start = {name: array.copy() for name, array in given.items()}
    radius = float(world.radii[0])
    options: dict[str, Any] = {"length_scale": 2.0 * radius}
    # any shapes, for Box2D counts what rounding puts beside the normal of a disc
    dc.ContactSolver(**given, **options).solve(cases.DT)
    moved, turned = write_back(space, bodies, given["impulse"])
    apart = np.abs(moved - given["velocity"][1:]).max(), radius * np.abs(turned - given["angular_velocity"][1:]).max()

    def reset() -> None:
        for name in ("velocity", "angular_velocity", "impulse"):
            given[name][...] = start[name]

    options["discs"] = True
    reset()
    sweeps = int(dc.ContactSolver(**given, **options).solve(cases.DT).numpy("sweeps")[0])
    config = dc.SolverConfig(tolerance=0.0, max_sweeps=sweeps)
    sim, timed = same_in_simulation(start, world, config), dc.ContactSolver(**given, **options, config=config)
    reset()
    timed.solve(cases.DT)
    sim.solve()
    count = len(given["body_a"])
    to_simulation = np.abs(sim.contacts.numpy("impulse")[:count] - given["impulse"]).max()
    color, pack = (sim.bind(name, 0, 1) for name in ("color_constraints", "pack_rows"))
    colors, impulses = sim.contacts.color, sim.contacts.numpy("impulse")

    def prepare() -> None:
        reset()
        impulses[:count] = start["impulse"]
        colors.fill_(-1)

    def step_packs() -> None:
        color()
        pack()

    calls = {
        "sim": sim.solve,
        "kept": lambda: timed.solve(kept=True),
        "whole": lambda: timed.solve(cases.DT),
        "pack": lambda: timed.pack(cases.DT),
        "step": step_packs,
    }

    def clock(call: Callable[[], Any]) -> float:
        """Seconds of ``REPEATS`` calls, each from the state of the pile."""
        total = 0.0
        for _ in range(REPEATS):
            prepare()
            total += timing.seconds(call)
        return total

    spent = timing.interleave(calls, rounds, warmup=2, clock=clock)

    def ratio(a: str, b: str) -> float:
        return statistics.median(x / y for x, y in zip(spent[a], spent[b], strict=True))

    return {
        "call_over_sim_solve": ratio("kept", "sim"),
        "whole_call_over_sim_solve": ratio("whole", "sim"),
        "first_call_ms": 1e3 * statistics.median(spent["pack"]) / REPEATS,
        "first_call_over_pack": ratio("pack", "step"),
        "box2d_velocity_difference": float(max(apart)),
        "contacts": count,
        "sweeps": sweeps,
        "sim_solve_us": 1e6 * statistics.median(spent["sim"]) / REPEATS,
        "impulse_difference_to_simulation": float(to_simulation),
        **measure_assembly(start, options, max(rounds // 10, 3)),
    }


def measure_assembly(given: dict[str, Any], options: dict[str, Any], rounds: int) -> dict[str, float]:
    """W with q and checks from a solver that is there, and from nothing, beside a product of SciPy's matrices."""
    import dc_kernels as dc
    from bench import cases
    from dc_kernels import delassus

    wide = {name: a.astype(np.float64) if a.dtype == REAL else a for name, a in given.items()}
    solver = dc.ContactSolver(**wide, **options)
    ours = delassus.from_solver(solver, cases.DT)
    calls = {
        "ours": lambda: delassus.from_solver(solver, cases.DT),
        "once": lambda: delassus.from_contacts(**wide, **options, dt=cases.DT),
        "scipy": lambda: assemble_by_scipy(wide),
    }
    theirs = assemble_by_scipy(wide)
    dense = np.zeros((2 * ours.count, 2 * ours.count))
    for i in range(ours.count):
        for k in range(ours.row_start[i], ours.row_start[i + 1]):
            j = ours.column[k]
            dense[2 * i : 2 * i + 2, 2 * j : 2 * j + 2] = ours.block[k].reshape(2, 2)
    apart = float(np.abs(dense - theirs.toarray()).max())
    spent = timing.medians(timing.interleave(calls, rounds))
    count = len(given["body_a"])
    return {
        "assemble_ns_per_contact": 1e9 * spent["ours"] / count,
        "assemble_once_ms": 1e3 * spent["once"],
        "scipy_assemble_ns_per_contact": 1e9 * spent["scipy"] / count,
        "assemble_difference": apart,
    }


def assemble_by_scipy(given: dict[str, Any]) -> Any:
    """W = J M^-1 J^T as SciPy's compressed rows, from J made of triplets."""
    import scipy.sparse as sparse

    count, bodies = len(given["body_a"]), len(given["inv_mass"])
    normal = given["normal"]
    tangent = np.stack([normal[:, 1], -normal[:, 0]], axis=1)
    rows, columns, values = [], [], []
    for sign, body in ((-1.0, given["body_a"]), (1.0, given["body_b"])):
        arm = given["point"] - given["position"][body]
        for k, along in enumerate((normal, tangent)):
            lever = arm[:, 0] * along[:, 1] - arm[:, 1] * along[:, 0]
            for axis, part in enumerate((along[:, 0], along[:, 1], lever)):
                rows.append(2 * np.arange(count) + k)
                columns.append(3 * body + axis)
                values.append(sign * part)
    shape = (2 * count, 3 * bodies)
    jacobian = sparse.csr_matrix((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape)
    inverse = np.stack([given["inv_mass"], given["inv_mass"], given["inv_inertia"]], axis=1).ravel()
    return (jacobian @ sparse.diags(inverse) @ jacobian.T).tocsr()


def report(values: dict[str, Any]) -> str:
    """A table for people."""
    names = (
        *KEYS,
        "assemble_once_ms",
        "contacts",
        "sweeps",
        "sim_solve_us",
        "impulse_difference_to_simulation",
        "assemble_difference",
    )
    rows = [(name, *(values[f"{name}_{size}"] for size in SIZES)) for name in names]
    return timing.table(("settled pile in pybox2d", *(f"{size} discs" for size in SIZES)), rows)
