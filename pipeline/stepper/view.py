"""What a stepper reads of a simulation between ``collide`` and ``solve``, as torch tensors.

Bodies and contacts of the worlds that are asked for lie one after the other. Lengths are measured in each world's own
unit, what gravity moves a body by in the step (g dt^2), and velocities by the way that they go in the step: contacts at
rest look alike whatever dt and g are, and one network serves several time steps.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import dc_kernels as dc
from dc_kernels.grid.area import wall_nodes
from dc_kernels.learn.step_channels import BINS, FLOATING
from dc_kernels.model.enums import BodyType
from dc_kernels.model.room import rows_of
from dc_kernels.runtime.imports import require
from dc_kernels.runtime.memory import check_memory
from dc_kernels.torch_ops.transfer import splat_torch
from pipeline.training.losses import direction_bins

torch = require("torch", "pipeline")

SPLAT = dc.Stencil("bspline")
"""Weights of the nodes that bodies and contacts reach."""


@dataclass(frozen=True, kw_only=True)
class StepView:
    """Holds N bodies and M contacts of B worlds before a step; a way is in units of the body's world."""

    way: Any
    """Predicted way of each body in the step, without contacts: x, y, turn times one metre, (N, 3) [unit]."""
    force: Any
    """Part of it that gravity and applied forces make, (N, 2) [unit]."""
    speed: Any
    """Velocity that a way of one unit in the step is, of each body, (N, 1) [m/s]."""
    position: Any
    """Centres of mass, (N, 2) [m]."""
    inv_mass: Any
    """0 where a body is not dynamic, (N,) [1/kg]."""
    inv_inertia: Any
    """0 where a body is not dynamic or cannot turn, (N,) [1/(kg m^2)]."""
    mass: Any
    """Over the mean of the world's dynamic bodies, 0 where a body is not dynamic, (N,) [1]."""
    body_start: Any
    """First body of each world, and their number, (B + 1,) int32."""
    body_a: Any
    """Row of body A of each contact, (M,) int64."""
    body_b: Any
    """Row of body B, (M,) int64."""
    normal: Any
    """Unit vector from A to B, (M, 2)."""
    arm_a: Any
    """From the centre of A to the contact, (M, 2) [m]."""
    arm_b: Any
    """From the centre of B to the contact, (M, 2) [m]."""
    gap: Any
    """Distance of the surfaces, 0 where they overlap: overlap does not push, (M,) [unit]."""
    friction: Any
    """Coulomb's coefficient, (M,) [1]."""
    contact_start: Any
    """First contact of each world, and their number, (B + 1,) int32."""
    walls: Any
    """1 at the nodes that static shapes cover, (B, 1, rows, columns)."""

    @property
    def dynamic(self) -> Any:
        """1 for each dynamic body, else 0, (N, 1)."""
        return (self.inv_mass > 0).to(self.way.dtype)[:, None]

    @property
    def world(self) -> Any:
        """World of each body, (N,) int64."""
        return torch.repeat_interleave(torch.arange(len(self.body_start) - 1), self.body_start.diff())

    @property
    def place(self) -> Any:
        """Contact points, (M, 2) [m]."""
        return self.position[self.body_a] + self.arm_a

    def of_contacts(self) -> ContactFrame:
        """Return normals and tangents, and what an impulse along them does."""
        return ContactFrame.of(self)

    def going(self, way: Any) -> StepView:
        """Return the view with other predicted ways, through which gradients may come."""
        return replace(self, way=way)

    def image(self, frame: ContactFrame, grid: dc.Grid) -> Any:
        """Return the image (``step_channels.CHANNELS``), (B, channels, rows, columns), differentiable by the ways."""
        moving = self.dynamic
        bodies = torch.cat([self.mass[:, None], self.way * moving, self.force * moving], dim=1).contiguous()
        closing, sliding = frame.relative(self.way)
        closing = (closing + self.gap).clamp(max=0.0)
        contacts = torch.stack([torch.ones_like(self.gap), self.gap, closing, sliding], dim=1)
        parts = [splat_torch(self.position, bodies, grid, SPLAT, start=self.body_start)]
        bins = direction_bins(self.normal, BINS)
        place = self.place.contiguous()
        parts.append(splat_torch(place, contacts, grid, SPLAT, start=self.contact_start, bins=BINS, point_bin=bins))
        return torch.cat([*parts, self.walls], dim=1)


@dataclass(frozen=True, kw_only=True)
class ContactFrame:
    """The lines of M contacts, and what impulses along them do to N bodies."""

    body_a: Any
    """Row of body A, (M,)."""
    body_b: Any
    """Row of body B, (M,)."""
    lines: tuple[Any, Any]
    """For normal and tangent: x, y and arm about each body, (M, 4): direction, arm about A, arm about B."""
    push_a: tuple[Any, Any]
    """For normal and tangent: change of the velocities of A by an impulse of one, (M, 3)."""
    push_b: tuple[Any, Any]
    """For normal and tangent: change of the velocities of B by an impulse of one, (M, 3)."""
    give: tuple[Any, Any]
    """For normal and tangent: relative velocity that an impulse of one makes, (M,) [1/kg]."""

    @classmethod
    def of(cls, view: StepView) -> ContactFrame:
        """Work out the lines of a view's contacts."""
        a, b, n = view.body_a, view.body_b, view.normal
        mass_a, mass_b = view.inv_mass[a], view.inv_mass[b]
        spin_a, spin_b = view.inv_inertia[a], view.inv_inertia[b]
        lines, push_a, push_b, give = [], [], [], []
        for line in (n, torch.stack([n[:, 1], -n[:, 0]], dim=1)):
            arm_a, arm_b = (arm[:, 0] * line[:, 1] - arm[:, 1] * line[:, 0] for arm in (view.arm_a, view.arm_b))
            lines.append(torch.cat([line, arm_a[:, None], arm_b[:, None]], dim=1))
            push_a.append(-torch.cat([line * mass_a[:, None], (arm_a * spin_a)[:, None]], dim=1))
            push_b.append(torch.cat([line * mass_b[:, None], (arm_b * spin_b)[:, None]], dim=1))
            give.append(mass_a + mass_b + spin_a * arm_a**2 + spin_b * arm_b**2)
        return cls(
            body_a=a,
            body_b=b,
            lines=(lines[0], lines[1]),
            push_a=(push_a[0], push_a[1]),
            push_b=(push_b[0], push_b[1]),
            give=(give[0], give[1]),
        )

    def relative(self, way: Any) -> tuple[Any, Any]:
        """Return how B moves against A along normal and tangent, (M,) each, of ways or velocities (N, 3)."""
        of_a, of_b = way[self.body_a], way[self.body_b]
        difference = of_b[:, :2] - of_a[:, :2]
        found = [
            (difference * line[:, :2]).sum(dim=1) + of_b[:, 2] * line[:, 3] - of_a[:, 2] * line[:, 2]
            for line in self.lines
        ]
        return found[0], found[1]

    def pushed(self, way: Any, normal: Any, tangent: Any) -> Any:
        """Return ways or velocities (N, 3) after impulses along normal and tangent, (M,) each."""
        on_a = normal[:, None] * self.push_a[0] + tangent[:, None] * self.push_a[1]
        on_b = normal[:, None] * self.push_b[0] + tangent[:, None] * self.push_b[1]
        return way.index_add(0, self.body_a, on_a).index_add(0, self.body_b, on_b)

    def summed(self, values: Any, count: int) -> Any:
        """Sum values of the contacts (M, C) at each of ``count`` bodies, (N, C)."""
        total = values.new_zeros(count, values.shape[1])
        return total.index_add(0, self.body_a, values).index_add(0, self.body_b, values)


class StepReader:
    """Reads worlds of a simulation as they stand after ``collide``.

    Attributes:
        sim: the simulation.
        grid: where the nodes of the image lie.
        walls: 1 at the nodes that static shapes cover, (W, 1, rows, columns).
    """

    def __init__(self, sim: dc.Simulation, grid: dc.Grid) -> None:
        """Find the walls.

        Raises:
            ValueError: for a simulation that a network cannot step: of another dtype, on a GPU, with joints or sleep.
            MemoryError: naming the images of the worlds, which would not fit.
        """
        if sim.dtype != np.float32:
            raise ValueError(f"sim.dtype is {sim.dtype.name}; networks answer in float32")
        if sim.device != "cpu":
            raise ValueError(f"sim.device is {sim.device!r}; a network steps simulations on the CPU")
        if sim.model.joint_count:
            raise ValueError(
                f"the scene has {sim.model.joint_count} joints; a network steps bodies with contacts alone"
            )
        if sim.config.sleep:
            raise ValueError("config.sleep is True; a network steps worlds whose bodies do not sleep")
        self.sim, self.grid = sim, grid
        worlds, nodes = sim.model.world_count, grid.rows * grid.columns
        check_memory(f"the images of {worlds} worlds on a grid of {grid.rows} x {grid.columns}", 4.0 * worlds * nodes)
        self.walls = np.zeros((worlds, 1, *grid.shape), np.float32)
        self._seen: tuple[np.ndarray, ...] = ()
        self.refresh()

    def refresh(self) -> bool:
        """Take in bodies that were added or removed, and static ones that were moved; tell whether there were any."""
        model, state = self.sim.model, self.sim.state
        static = model.numpy("body_type") == BodyType.STATIC
        places = state.numpy("position")[static], state.numpy("angle")[static]
        seen = np.array(self.sim.layout_version), model.numpy("body_start"), static, *places
        if self._seen and all(map(np.array_equal, seen, self._seen)):
            return False
        self._seen = tuple(values.copy() for values in seen)
        self._start = model.numpy("body_start").astype(np.int64)
        of_world, row, column = wall_nodes(model, state, self.grid)
        self.walls.fill(0.0)
        self.walls[of_world, 0, row, column] = 1.0
        return True

    @property
    def world(self) -> np.ndarray:
        """World of each body, (N,)."""
        return np.repeat(np.arange(len(self._start) - 1), np.diff(self._start))

    def _masses(self, rows: Any, body_start: np.ndarray) -> dict[str, np.ndarray]:
        """Return what the model says of the masses of bodies now, by name of a view's field."""
        model = self.sim.model
        dynamic = model.numpy("body_type")[rows] == BodyType.DYNAMIC
        mass = np.where(dynamic, model.numpy("mass")[rows], 0.0)
        world = np.repeat(np.arange(len(body_start) - 1), np.diff(body_start))
        count = np.bincount(world[dynamic], minlength=len(body_start) - 1)
        mean = np.bincount(world, mass, len(count)) / np.maximum(count, 1)
        inverse = {name: np.where(dynamic, model.numpy(name)[rows], 0.0) for name in ("inv_mass", "inv_inertia")}
        found = {**inverse, "mass": mass / np.where(mean > 0, mean, 1.0)[world]}
        return {name: values.astype(np.float32) for name, values in found.items()}

    def rows(self, worlds: np.ndarray | None) -> Any:
        """Return the rows of the bodies of some worlds in the arrays of the simulation; None: those of all."""
        if worlds is None:
            return slice(0, int(self._start[-1]))
        return rows_of(self._start, worlds)

    def write_impulses(self, worlds: np.ndarray | None, impulse: np.ndarray) -> None:
        """Write impulses of the contacts of some worlds, in the order in which ``read`` gives them, (M, 2) [N s]."""
        contacts = self.sim.contacts
        chosen = np.arange(len(self._start) - 1) if worlds is None else worlds
        slots = rows_of(contacts.numpy("contact_start"), chosen, contacts.numpy("contact_count"))
        contacts.numpy("impulse")[slots] = impulse

    def read(self, worlds: np.ndarray | None = None) -> StepView:
        """Read some worlds, in the order given, each of them once; None: all.

        What stands in the simulation's own memory in this order is not copied.
        """
        sim, rows = self.sim, self.rows(worlds)
        chosen = np.arange(len(self._start) - 1) if worlds is None else worlds
        sizes = np.diff(self._start)[chosen]
        body_start = np.concatenate([[0], np.cumsum(sizes)])
        contacts = sim.contacts
        count = contacts.numpy("contact_count")
        counts = count[chosen]
        slots = rows_of(contacts.numpy("contact_start"), chosen, count)
        shift = np.repeat(body_start[:-1] - self._start[chosen], counts)
        dt = sim.motion.numpy("step_dt")[chosen].astype(np.float64)
        gravity = np.linalg.norm(sim.model.numpy("gravity")[chosen].astype(np.float64), axis=1)
        unit = np.where(gravity > 0, gravity * dt**2, FLOATING * sim.model.numpy("length_scale")[chosen])
        speed = np.repeat(unit / dt, sizes)[:, None].astype(np.float32)
        predicted = sim.motion.numpy("predicted")[rows, :3]
        force = (predicted[:, :2] - sim.state.numpy("velocity")[rows]) / speed
        taken = {name: contacts.numpy(name).take(slots, 0) for name in ("normal", "arm_a", "arm_b", "friction")}
        gap = np.maximum(contacts.numpy("gap").take(slots), 0.0) / np.repeat(unit, counts)
        a, b = (contacts.numpy(name).take(slots) + shift for name in ("body_a", "body_b"))
        arrays: dict[str, np.ndarray] = {
            "way": predicted / speed,
            "force": force,
            "speed": speed,
            "position": sim.state.numpy("position")[rows],
            **self._masses(rows, body_start),
            "body_start": body_start.astype(np.int32),
            "body_a": a.astype(np.int64),
            "body_b": b.astype(np.int64),
            **taken,
            "gap": gap.astype(np.float32),
            "contact_start": np.concatenate([[0], np.cumsum(counts)]).astype(np.int32),
            "walls": self.walls if worlds is None else self.walls[worlds],
        }
        return StepView(**{name: torch.from_numpy(values) for name, values in arrays.items()})
