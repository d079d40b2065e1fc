"""A world's contacts and joints as a Delassus problem, and solves of a simulation taken further in that form."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from dc_kernels.delassus.assemble import assemble_rows
from dc_kernels.delassus.kept import KeptSolvers
from dc_kernels.delassus.problem import DelassusProblem
from dc_kernels.delassus.search import DelassusSolution
from dc_kernels.delassus.solver import solve
from dc_kernels.model.arrays import to_numpy
from dc_kernels.model.enums import flag_names
from dc_kernels.model.settings import WrongType, checker, shown
from dc_kernels.runtime.capture import refuse_recording
from dc_kernels.runtime.inputs import check_positive, check_simulation, check_whole
from dc_kernels.solve.contacts import ContactSolver
from dc_kernels.solve.rows import OWN, SURFACED, read_column

if TYPE_CHECKING:
    from dc_kernels.simulation import Simulation

_problem, _solution = checker(DelassusProblem), checker(DelassusSolution)
_kept = KeptSolvers()
OPEN = 1e5  # times its gap over dt: a bias above that is a row that never acts (see _warp/rows.py)


def from_world(sim: Simulation, world: int = 0) -> DelassusProblem:
    """Make the problem of a world's contacts and joints, between ``collide`` and ``advance``, as the solver has it.

    W = J M^-1 J^T, and q = J v + b of the predicted velocities and the bias b of gaps, restitution and position
    correction. Joints follow the contacts as bilateral rows. Open gaps of bouncing pairs, which the solver's rows
    leave alone in this step, are left out; ``slot`` says where the impulses of the others lie.

    Raises:
        ValueError: after ``advance``, for a world that is not there or does not advance, or a contact or joint
            between bodies that nothing moves.
    """
    check_simulation("sim", sim)
    refuse_recording("from_world", "the host reads what the kernels leave")
    with sim.calls:
        return _from_world(sim, world)


def _from_world(sim: Simulation, world: int) -> DelassusProblem:
    if sim.phase == "advance":
        raise ValueError("the contacts are those of a finished step: call collide(dt) first")
    world = check_world(sim, world)
    if flags := sim.state.numpy("flags")[world]:
        raise ValueError(f"world {world} does not advance ({flag_names(flags)}): it has no problem")
    return _from_rows(sim, world)


def from_contacts(
    body_a: Any, body_b: Any, point: Any, normal: Any, gap: Any, *, dt: float, world: int = 0, **options: Any
) -> DelassusProblem:
    """Make the problem of contacts and joints of any engine, as a ``ContactSolver`` has it.

    W = J M^-1 J^T, and q = J v + b of the velocities and the bias b of gaps, restitution and position correction.
    Joints follow the contacts as bilateral rows. Open gaps of bouncing pairs, which the solver's rows leave alone in
    this step, are left out; ``slot`` says which contacts and joints the others are. Arrays of float64 give
    W and q their digits. The solver that this takes is kept for the next call with as many bodies, as many contacts to
    the next power of two, and equal settings.

    Args:
        body_a: see ``ContactSolver``, as the next four.
        body_b: see there.
        point: see there.
        normal: see there.
        gap: see there.
        dt: time step, > 0 [s].
        world: whose problem it is.
        options: the other arguments of ``ContactSolver``, ``velocity`` and ``angular_velocity`` among them.

    Raises:
        ValueError: naming argument, index and limit, or a contact or joint between bodies that nothing moves.
    """
    refuse_recording("from_contacts", "the host reads what the kernels leave")
    given = {"body_a": body_a, "body_b": body_b, "point": point, "normal": normal, "gap": gap}
    with _kept.solver({**given, **options}) as solver:
        return from_solver(solver, dt, world)


def from_solver(solver: ContactSolver, dt: float, world: int = 0) -> DelassusProblem:
    """Make the problem of the contacts and joints that the arrays of a solver now hold (see ``from_contacts``).

    With a solver that is there the matrix of 100 contacts takes half a millisecond.

    Args:
        solver: whose rows are made anew, as ``solver.pack(dt)`` does.
        dt: time step, > 0 [s].
        world: whose problem it is.

    Raises:
        TypeError: for another solver.
        ValueError: naming argument, index and limit, or a contact or joint between bodies that nothing moves.
    """
    if not isinstance(solver, ContactSolver):
        raise WrongType(f"solver is {shown(solver)}; it must be a ContactSolver")
    refuse_recording("from_solver", "the host reads what the kernels leave")
    world = check_world(solver, world)
    with solver.calls:
        solver.pack(dt)
        return _from_rows(solver, world)


def _from_rows(solver: Simulation | ContactSolver, world: int) -> DelassusProblem:
    """Make the problem of a world's packed rows."""
    if solver.variant in SURFACED:
        raise ValueError("surfaces move or resist rolling, which a Delassus problem knows nothing of")
    if solver.variant in OWN:
        raise ValueError(
            "rows of own Jacobians have bounds, as joints but rods do, which a Delassus problem has not: leave them out"
        )
    contacts, joints = solver.contacts, solver.joints

    def row_values(name: str, slot: np.ndarray) -> np.ndarray:
        return read_column(solver.rows.numpy("column"), solver.variant, name, slot).astype(np.float64)

    first = int(contacts.numpy("contact_start")[world])
    slots = np.arange(first, first + int(contacts.numpy("contact_count")[world]))
    bias = row_values("bias", solver.rows.numpy("slot")[slots])
    gap = contacts.numpy("gap")[slots].astype(np.float64)
    with np.errstate(divide="ignore"):
        acts = (gap <= 0.0) | (bias * float(solver.motion.numpy("step_dt")[world]) < OPEN * gap)
    slots, bias = slots[acts], bias[acts]
    normal = contacts.numpy("normal")[slots].astype(np.float64)
    directions = normal, np.stack([normal[:, 1], -normal[:, 0]], axis=1)
    body = np.stack([contacts.numpy("body_a")[slots], contacts.numpy("body_b")[slots]], axis=1)
    jacobian = np.zeros((len(slots), 2, 2, 3))  # contact, body A or B, direction, velocity
    for side, arm in ((0, "arm_a"), (1, "arm_b")):
        lever = contacts.numpy(arm)[slots].astype(np.float64)
        for k, direction in enumerate(directions):
            jacobian[:, side, k, :2] = direction
            jacobian[:, side, k, 2] = lever[:, 0] * direction[:, 1] - lever[:, 1] * direction[:, 0]
    jacobian[:, 0] *= -1.0
    mu = contacts.numpy("friction")[slots].astype(np.float64)
    lines = np.arange(*solver.model.numpy("joint_start")[world : world + 2])
    if len(lines):
        at = solver.rows.numpy("joint_slot")[lines]
        more = np.zeros((len(lines), 2, 2, 3))
        more[:, :, 0, :2] = np.stack([row_values("nx", at), row_values("ny", at)], axis=1)[:, None]
        more[:, 0, 0, 2], more[:, 1, 0, 2] = row_values("rAn", at), row_values("rBn", at)
        more[:, 0] *= -1.0
        jacobian = np.concatenate([jacobian, more])
        ends = np.stack([joints.numpy("joint_body_a")[lines], joints.numpy("joint_body_b")[lines]], axis=1)
        body = np.concatenate([body, ends])
        bias = np.concatenate([bias, row_values("bias", at)])
        mu = np.concatenate([mu, np.zeros(len(lines))])
    predicted = solver.motion.numpy("predicted").astype(np.float64)[body]  # (n, 2, 4)
    both = jacobian.transpose(0, 2, 1, 3).reshape(-1, 2, 6)  # bodies A and B beside each other
    q = (both @ predicted[..., :3].reshape(-1, 6, 1))[..., 0]
    q[:, 0] += bias
    inertia = solver.model.numpy("inv_inertia").astype(np.float64)[body]
    inverse = np.stack([predicted[..., 3], predicted[..., 3], inertia], axis=-1)  # (n, 2, 3)
    start, column, block = assemble_rows(jacobian, body, inverse, solver.backend)
    bilateral = np.arange(len(mu)) >= len(slots)
    dead = np.flatnonzero(start[1:] == start[:-1])
    if len(dead):
        raise ValueError(f"contact {dead[0]} of world {world} is between bodies that nothing moves: it has no row of W")
    return DelassusProblem(
        row_start=start,
        column=column,
        block=block,
        q=q,
        mu=mu,
        bilateral=bilateral,
        slot=np.concatenate([slots, lines]),
    )


def refine(sim: Simulation, tolerance: float, *, max_sweeps: int = 100_000) -> dict[int, DelassusSolution]:
    """Solve worlds that are not yet within a tolerance further, in Delassus form, between ``solve`` and ``advance``.

    Impulses are written back to ``contacts``, ``joints``, velocities and ``stats`` where the simulation's own residual
    falls by them, and left as they were elsewhere. ``stats.sweeps`` counts on.

    Args:
        sim: after ``solve()``.
        tolerance: relative natural map that a world is to reach [1]; those that have it are left alone.
        max_sweeps: of each world.

    Returns:
        The solutions by world, of the worlds that were not solved.

    Raises:
        ValueError: out of turn, on a GPU, or for a tolerance that is not > 0.
    """
    check_simulation("sim", sim)
    tolerance, max_sweeps = check_positive("tolerance", tolerance), check_whole("max_sweeps", max_sweeps)
    refuse_recording("refine", "the host reads what the kernels leave")
    with sim.calls:
        return _refine(sim, tolerance, max_sweeps)


def _refine(sim: Simulation, tolerance: float, max_sweeps: int) -> dict[int, DelassusSolution]:
    if sim.phase != "solve" or sim.running.any():
        raise ValueError("refine() stands between a solve() that has ended and advance()")
    _check_device("refine()", sim)
    found: dict[int, DelassusSolution] = {}
    residual = sim.stats.numpy("residual")
    flags = sim.state.numpy("flags")
    for world in np.flatnonzero((residual > tolerance) & (flags == 0)):
        w = int(world)
        given = from_world(sim, w)
        start = read_impulses(sim, given)
        solution = solve(given, tolerance=tolerance, max_sweeps=max_sweeps, start=start)
        write_impulses(sim, w, given, solution)
        found[w] = solution
    return found


def read_impulses(sim: Simulation, given: DelassusProblem) -> np.ndarray:
    """Read the present impulses of a problem's contacts and joints, (n, 2) [N s]."""
    check_simulation("sim", sim)
    _problem("given", given)
    assert given.slot is not None
    x = np.zeros((given.count, 2))
    x[~given.bilateral] = sim.contacts.numpy("impulse")[given.slot[~given.bilateral]]
    x[given.bilateral, 0] = sim.joints.numpy("joint_impulse")[given.slot[given.bilateral]]
    return x


def write_impulses(sim: Simulation, world: int, given: DelassusProblem, solution: DelassusSolution) -> None:
    """Write impulses to the simulation with all that follows from them; undo it where its residual does not fall.

    Raises:
        ValueError: on a GPU.
    """
    check_simulation("sim", sim)
    world = check_world(sim, world)
    _problem("given", given)
    _solution("solution", solution)
    _check_device("write_impulses()", sim)
    assert given.slot is not None
    first = int(sim.contacts.numpy("contact_start")[world])
    slots = slice(first, first + int(sim.contacts.numpy("contact_count")[world]))
    joints = slice(*sim.model.numpy("joint_start")[world : world + 2])
    bodies = slice(*sim.model.numpy("body_start")[world : world + 2])
    stats = sim.stats
    arrays = [
        sim.contacts.numpy("impulse")[slots],
        sim.joints.numpy("joint_impulse")[joints],
        sim.motion.numpy("solved")[bodies],
        *(stats.numpy(name)[world : world + 1] for name in ("iteration", "sweeps", "change", "residual")),
    ]
    before = [array.copy() for array in arrays]
    impulse, _, _, _, sweeps, change, residual = arrays
    impulse[...] = 0.0
    sim.contacts.numpy("impulse")[given.slot[~given.bilateral]] = solution.impulses[~given.bilateral]
    sim.joints.numpy("joint_impulse")[given.slot[given.bilateral]] = solution.impulses[given.bilateral, 0]
    history = to_numpy(stats.history)[world].copy()
    sim.bind("solve_world", world, 1, {"max_sweeps": 0})()  # velocities and residual of these impulses
    to_numpy(stats.history)[world] = history
    if residual[0] < before[-1][0]:
        sweeps[0] = before[-3][0] + solution.sweeps
        change[0] = before[-2][0]
    else:
        for array, value in zip(arrays, before, strict=True):
            array[...] = value


def check_world(sim: Simulation | ContactSolver, world: int) -> int:
    """Return the index of a world of a simulation or solver.

    Raises:
        TypeError, ValueError: for another one.
    """
    world = check_whole("world", world)
    if world >= sim.model.world_count:
        raise ValueError(f"world is {world}; it must lie in [0, {sim.model.world_count})")
    return world


def _check_device(what: str, sim: Simulation) -> None:
    """Raise ValueError, naming the call, on a GPU, where the arrays that the host sees are copies."""
    if sim.device != "cpu":
        raise ValueError(f"{what} runs on the CPU; the simulation is on {sim.device!r}")
