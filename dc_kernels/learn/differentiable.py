"""Contact problems as torch tensors: projected Gauss-Seidel sweeps, differentiable by the impulses they begin with.

A sweep is the solver's own with omega = 1. Its derivative is that on the active sets it met, which is one side's where
a row just stops; they are kept in a tape of one byte a row and sweep, and the adjoint runs the rows backwards. With the
active sets fixed a sweep is linear, so a first derivative is all there is: a second one raises.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from dc_kernels.learn.packed import Column
from dc_kernels.measure import contact_slots
from dc_kernels.model.room import world_of
from dc_kernels.model.settings import Limits, checker
from dc_kernels.runtime.capture import refuse_recording
from dc_kernels.runtime.imports import require
from dc_kernels.runtime.inputs import check_array, check_count, check_simulation, check_start, check_whole, check_worlds
from dc_kernels.runtime.interop import tensor_array, tensor_integers
from dc_kernels.runtime.memory import check_memory
from dc_kernels.solve.rows import read_column
from dc_kernels.torch_ops.sweeps import launch
from dc_kernels.torch_ops.tensors import check_tensors

if TYPE_CHECKING:
    from dc_kernels.simulation import Simulation

torch = require("torch", "pipeline")

UNIT = 1e-3  # by which the length of a normal may differ from 1


@dataclass(frozen=True, kw_only=True, eq=False)
class ContactProblem:
    """The contacts of W worlds as a solver sees them: tensors on the CPU, contiguous, of one float type.

    Worlds lie one after the other, as do their bodies; contacts are swept in index order. Tensors are read where they
    lie, but what a sweep reads of a contact is packed once, when the problem is made: later changes are not seen.
    A normal points from A to B, and impulses act on B (``model.fields``).
    """

    contact_start: Any
    """First contact of each world and the number of contacts, (W + 1,) integers."""
    body_start: Any
    """First body of each world and the number of bodies, (W + 1,) integers."""
    body_a: Any
    """Body A, counted over all worlds, (M,) integers."""
    body_b: Any
    """Body B, (M,) integers."""
    normal: Any
    """Unit vector from A to B, (M, 2)."""
    arm_a: Any
    """From the centre of mass of A to the contact point [m], (M, 2)."""
    arm_b: Any
    """From the centre of mass of B to the contact point [m], (M, 2)."""
    friction: Any
    """Coulomb coefficient, (M,)."""
    bias: Any
    """Added to the normal speed [m/s], (M,): gap / dt where a gap may close, minus what a bounce is to keep."""
    inv_mass: Any
    """0 where infinite [1/kg], (N,)."""
    inv_inertia: Any
    """0 where infinite [1/(kg m^2)], (N,)."""
    velocity: Any
    """Predicted: vx, vy [m/s] and spin [rad/s], with forces and without impulses, (N, 3)."""
    effective_mass: Any = None
    """Of the normal and the tangent [kg], (M, 2); None: 1 / (J M^-1 J^T)."""
    slot: Any = None
    """The contacts' slots in the arrays of the simulation they are from, (M,) int64."""

    def __post_init__(self) -> None:
        """Check all tensors and pack the rows.

        Raises:
            ValueError: naming tensor and index: another dtype, shape, device or memory layout, NaN or inf, a normal
                that is no unit vector, something negative, a body of another world.
        """
        dtype = tensor_array("velocity", self.velocity).dtype
        bodies, contacts = len(self.velocity), len(self.body_a)
        body_start = check_start("body_start", tensor_integers("body_start", self.body_start), bodies, "bodies")
        starts = tensor_integers("contact_start", self.contact_start)
        contact_start = check_start("contact_start", starts, contacts, "contacts")
        worlds = len(body_start) - 1
        if len(contact_start) != worlds + 1:
            raise ValueError(f"contact_start has {len(contact_start)} entries; body_start has {worlds + 1}")
        for name, shape, low in (
            ("velocity", (bodies, 3), None),
            ("inv_mass", (bodies,), 0.0),
            ("inv_inertia", (bodies,), 0.0),
            ("normal", (contacts, 2), None),
            ("arm_a", (contacts, 2), None),
            ("arm_b", (contacts, 2), None),
            ("friction", (contacts,), 0.0),
            ("bias", (contacts,), None),
            ("effective_mass", (contacts, 2), 0.0),
        ):
            tensor = getattr(self, name)
            if tensor is not None or name != "effective_mass":
                check_array(name, tensor, shape, dtype, low=low)
        normal = self.normal.numpy()
        off = np.flatnonzero(np.abs(np.square(normal).sum(axis=1) - 1.0) > 2.0 * UNIT)
        if len(off):
            raise ValueError(f"normal[{off[0]}] is {normal[off[0]]}; it must be a unit vector")
        first, end = (np.repeat(edge, np.diff(contact_start)) for edge in (body_start[:-1], body_start[1:]))
        pair = np.empty((contacts, 2), np.int32)
        for side, name in enumerate(("body_a", "body_b")):
            body = tensor_integers(name, getattr(self, name))
            if body is None or body.shape != (contacts,) or body.dtype.kind not in "iu":
                found = "None" if body is None else f"shape {body.shape}, dtype {body.dtype}"
                raise ValueError(f"{name} has {found}; it must be ({contacts},) integers")
            bad = np.flatnonzero((body < first) | (body >= end))
            if len(bad):
                c = bad[0]
                raise ValueError(f"{name}[{c}] is {body[c]}; it must lie in [{first[c]}, {end[c] - 1}], its world")
            pair[:, side] = body
        keep = object.__setattr__
        keep(self, "_row_body", torch.from_numpy(pair))
        keep(self, "_contact_start", torch.from_numpy(contact_start.astype(np.int32)))
        keep(self, "_world_of", torch.from_numpy(world_of(body_start)))
        inverse = torch.stack([self.inv_mass, self.inv_mass, self.inv_inertia], dim=1)
        keep(self, "_inverse", inverse)
        keep(self, "_mass", torch.where(inverse > 0, inverse.reciprocal(), 0.0))
        keep(self, "_row", self._pack_rows())

    def _pack_rows(self) -> Any:
        """Put all that a sweep reads of a contact side by side, (M, len(Column))."""
        row = self.normal.new_empty((len(self.normal), len(Column)))
        row[:, Column.NX : Column.NY + 1] = self.normal
        row[:, Column.BIAS], row[:, Column.MU] = self.bias, self.friction
        if self.effective_mass is not None:
            row[:, Column.EN : Column.ET + 1] = self.effective_mass
        values = {
            "given_mass": int(self.effective_mass is not None),
            "contact_start": self._contact_start,
            "row_body": self._row_body,
            "inverse": self._inverse,
            "arm_a": self.arm_a,
            "arm_b": self.arm_b,
            "row": row,
        }
        launch("complete_rows", 1, values)
        return row

    if TYPE_CHECKING:
        _row_body: Any
        _contact_start: Any
        _world_of: Any
        _inverse: Any
        _mass: Any
        _row: Any

    @classmethod
    def from_simulation(cls, sim: Simulation, worlds: Sequence[int] | None = None) -> ContactProblem:
        """Copy the problem that ``sim.solve()`` solves, between ``collide`` and ``advance``.

        Contacts come in the order in which the solver sweeps them: ``sim.contacts.numpy("impulse")[problem.slot]``
        are their impulses. The solver begins with these clamped to the friction cone. A flagged world has no contacts,
        and its velocities count as 0.

        Args:
            sim: on the CPU, without joints.
            worlds: which; None for all.

        Raises:
            ValueError: after ``advance``, on a GPU, with joints, or for a world that is not there or twice.
        """
        check_simulation("sim", sim)
        refuse_recording("from_simulation", "the host reads what the kernels leave")
        if sim.device != "cpu":
            raise ValueError(f"sim.device is {sim.device!r}; contact problems are solved on the CPU")
        if sim.model.joint_count:
            raise ValueError(f"sim has {sim.model.joint_count} joints; a contact problem holds contacts only")
        if sim.phase == "advance":
            raise ValueError("from_simulation needs collide(dt) first: the contacts are those of a finished step")
        first, live = sim.model.numpy("body_start").astype(np.int64), sim.state.numpy("flags") == 0
        given = check_worlds("worlds", worlds, len(live))
        chosen = np.arange(len(live)) if given is None else given
        place = np.full(len(live), -1)
        place[chosen] = np.arange(len(chosen))
        count = np.diff(first)[chosen]
        body_start = np.concatenate(([0], np.cumsum(count)))
        shift = body_start[:-1] - first[chosen]  # from a body of the simulation to one of the problem
        body = np.arange(body_start[-1]) - np.repeat(shift, count)

        slots, world = contact_slots(sim.contacts)
        row_slot = sim.rows.numpy("slot").astype(np.int64)
        shown = live[world] & (place[world] >= 0)
        slots, world = slots[shown], place[world[shown]]
        order = np.lexsort((row_slot[slots], world))
        slots, world = slots[order], world[order]

        def column(name: str) -> np.ndarray:
            return read_column(sim.rows.numpy("column"), sim.variant, name, row_slot[slots])

        velocity = sim.motion.numpy("predicted")[body, :3].copy()
        velocity[~np.repeat(live[chosen], count)] = 0
        contacts, model = sim.contacts, sim.model
        arrays = {
            "contact_start": np.searchsorted(world, np.arange(len(chosen) + 1)),
            "body_start": body_start,
            **{name: contacts.numpy(name)[slots] + shift[world] for name in ("body_a", "body_b")},
            **{name: contacts.numpy(name)[slots] for name in ("normal", "arm_a", "arm_b")},
            "friction": column("mu"),
            "bias": column("bias"),
            "effective_mass": np.stack([column("en"), column("et")], axis=1),
            **{name: model.numpy(name)[body] for name in ("inv_mass", "inv_inertia")},
            "velocity": velocity,
            "slot": slots,
        }
        return cls(**{name: torch.from_numpy(np.ascontiguousarray(array)) for name, array in arrays.items()})

    def velocities(self, impulse: Any, *, threads: int = 1) -> Any:
        """Add M^-1 J^T impulse to the predicted velocities, differentiable by the impulse.

        Args:
            impulse: normal and tangential of each contact, (M, 2), contiguous, of the problem's dtype, finite [N s].
            threads: worlds are shared by so many threads.

        Returns:
            vx, vy [m/s] and spin [rad/s], (N, 3).

        Raises:
            ValueError: naming the argument.
        """
        return torch.ops.deep_contact.push_impulses(impulse, self.velocity, *self._packed(impulse, threads))

    def energy(self, impulse_error: Any, *, threads: int = 1) -> Any:
        """Compute the kinetic energy of the velocities that an error of the impulses makes, 1/2 e^T J M^-1 J^T e.

        Args:
            impulse_error: (M, 2) [N s]; see ``velocities``.
            threads: worlds are shared by so many threads.

        Returns:
            Of each world, (W,) [J]; differentiable.

        Raises:
            ValueError: naming the argument.
        """
        check_tensors(impulse_error=impulse_error)
        still = torch.zeros_like(self.velocity)
        error = torch.ops.deep_contact.push_impulses(impulse_error, still, *self._packed(impulse_error, threads))
        energy = 0.5 * (self._mass * error.square()).sum(dim=1)
        return energy.new_zeros(len(self._contact_start) - 1).index_add(0, self._world_of, energy)

    def natural_map(self, impulse: Any, *, threads: int = 1) -> Any:
        """Compute what each row alone would change its impulses by: the projected step at the given impulses.

        The normal steps and stops at 0; the tangent steps and stops at +-mu times the new normal impulse. Zero at a
        solution, and only there.

        Args:
            impulse: normal and tangential of each contact, (M, 2), contiguous, of the problem's dtype [N s].
            threads: worlds are shared by so many threads.

        Returns:
            (M, 2) [N s], without a gradient.

        Raises:
            ValueError: naming the argument.
        """
        check_tensors(impulse=impulse)
        impulse = impulse.detach()
        step = torch.empty_like(impulse)
        velocity = self.velocities(impulse, threads=threads)
        launch("step_problem", threads, {**self._rows(), "impulse": impulse, "velocity": velocity, "step": step})
        return step

    def _rows(self) -> dict[str, Any]:
        return {"contact_start": self._contact_start, "row": self._row, "row_body": self._row_body}

    def _packed(self, impulse: Any, threads: int) -> tuple[Any, ...]:
        """Check the impulses and return the trailing arguments of the operators."""
        check_tensors(impulse=impulse)
        array = tensor_array("impulse", impulse)
        check_array("impulse", array, (len(self._row), 2), tensor_array("velocity", self.velocity).dtype)
        return self._inverse, self._row, self._row_body, self._contact_start, check_count("threads", threads)


_problem = checker(ContactProblem)
_leak = checker(Annotated[float, Limits(least=0.0, most=1.0)])


def sweeps_torch(
    impulse: Any, problem: ContactProblem, sweeps: int, *, leak: float = 0.0, threads: int = 1
) -> tuple[Any, Any, Any]:
    """Sweep by plain projected Gauss-Seidel, normal before tangent, contacts in index order.

    Args:
        impulse: to begin with, (M, 2), contiguous, of the problem's dtype, finite [N s]; unlike the solver's it is
            taken as it is, inside the friction cone or not.
        problem: whose contacts are swept.
        sweeps: how many, >= 0.
        leak: a row that is stopped passes this share of the gradient that it would pass if it were not, in [0, 1]:
            with 0 nothing is learned of what the cone cuts off. What is computed does not depend on it.
        threads: worlds are shared by so many threads; the bits do not depend on it.

    Returns:
        Impulses (M, 2) [N s], velocities (N, 3) [m/s, rad/s], and what the last sweep changed the impulses by (M, 2)
        [N s], 0 without a sweep. All are differentiable by ``impulse``, once.

    Raises:
        ValueError: naming the argument.
    """
    _problem("problem", problem)
    sweeps, leak = check_whole("sweeps", sweeps), _leak("leak", leak)
    packed = problem._packed(impulse, threads)
    check_memory("the tape of sweeps", float(sweeps) * len(impulse))
    found = torch.ops.deep_contact.sweep_problem(impulse, problem.velocity, *packed, sweeps, leak)
    return tuple(found[:3])
