"""The contact solver as a stage for the bodies and contacts of any engine, on the engine's own arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np

from dc_kernels.binding import Binding
from dc_kernels.model.arrays import ArrayGroup, Contacts, Model, State
from dc_kernels.model.config import SimulationOptions, SolverConfig, check_awake, check_config
from dc_kernels.model.joints.groups import Joints
from dc_kernels.runtime.backends import Launch, bind, check_backend, make_kernels
from dc_kernels.runtime.capture import recording, refuse_hosted, refuse_recording
from dc_kernels.runtime.inputs import check_layout, check_truth
from dc_kernels.runtime.interop import InPlace
from dc_kernels.runtime.sequences import Rounds, Watch
from dc_kernels.runtime.shards import shards_of
from dc_kernels.runtime.threads import OneCaller
from dc_kernels.solve.exchange import (
    BEFORE,
    LINES,
    NEEDED,
    VELOCITIES,
    WRITTEN,
    for_each,
    gravity_of,
    length_of,
    make_exchange,
    offsets,
    own_lines,
    own_rows,
    refuse_incomplete,
    refuse_lacking,
    share_all,
    stays,
    view_of,
)
from dc_kernels.solve.faults import STOPS, raise_fault
from dc_kernels.solve.integrate import Integrator
from dc_kernels.solve.schedules import SCHEDULES, SOLVES, check_iteration, check_solve
from dc_kernels.solve.storage import SolverStorage, SolveStats

PER_CALL = (*VELOCITIES, "impulse", *BEFORE)
GROUPS_TAKEN = ("model", "state", "joints", "contacts", "rows", "motion", "stats", "exchange")
FILES = (("solve.exchange",), ("collide.color",), ("solve.pack", "variant"), ("solve.schedules", "variant"))
Call = Literal["pack", "solve", "solve kept"]


class ContactSolver(InPlace):
    """Computes impulses and velocities of bodies in contact, for any engine: the solver of ``Simulation`` as a stage.

    The arrays of bodies and contacts are given once and read in place at each call: refill them in place. They
    have room for the largest number of contacts; ``count`` is the number in use. The arrays of many worlds are
    stored one after the other.

    A contact's normal is a unit vector from body A to body B, its tangent the normal rotated by -90 degrees, t = (n_y,
    -n_x); impulses act on B, the opposite ones on A. Contacts do not move a body with inverse mass and inverse inertia
    0, which may have a velocity. All quantities are in SI units. The method is projected Gauss-Seidel in the order of
    a colouring (Wu 2018, section 2.2; ``SolverConfig``), in SIMD lanes on a CPU; the result has the same bits whatever
    ``threads`` and the other worlds are.

    Within ``wp.ScopedCapture`` a call becomes part of the graph; a replay reads and writes the arrays that it was
    recorded with, and does not change a world whose arrays are out of range but sets a bit of its ``state.flags``.

    Attributes:
        contacts, joints, motion, rows, stats, state, model: groups of arrays of the kernels (``model.fields``);
            ``contacts.color`` has the colours, ``stats`` the statistics of the last solve.
        calls: the lock that each call holds; a call during that of another thread raises RuntimeError.
    """

    def __init__(
        self,
        body_a: Any,
        body_b: Any,
        point: Any,
        normal: Any,
        gap: Any,
        friction: Any = 0.0,
        restitution: Any = 0.0,
        *,
        inv_mass: Any,
        inv_inertia: Any,
        position: Any = None,
        angle: Any = None,
        arm_a: Any = None,
        arm_b: Any = None,
        count: Any = None,
        color: Any = None,
        velocity: Any = None,
        angular_velocity: Any = None,
        velocity_before: Any = None,
        angular_velocity_before: Any = None,
        impulse: Any = None,
        joints: Mapping[str, Any] | None = None,
        rows: Mapping[str, Any] | None = None,
        body_start: Any = None,
        contact_start: Any = None,
        joint_start: Any = None,
        row_start: Any = None,
        length_scale: Any = 1.0,
        weight: Any = 0.0,
        gravity: Any = None,
        discs: bool = False,
        config: SolverConfig | None = None,
        threads: int = 1,
        schedule: Literal["world", "color"] = "world",
        backend: str = "warp",
    ) -> None:
        """Check the arrays, which are used in place, and allocate the memory of a solve.

        The arrays are numpy arrays, torch tensors, ``wp.array`` or any object with ``__dlpack__``, in the CPU's
        memory, contiguous, of int32 or of the scalar type of ``normal``, float32 or float64. N is the number of
        bodies, C the capacity for contacts, W the number of worlds.

        Args:
            body_a: body A of each contact, (C,) int32.
            body_b: body B, (C,) int32.
            point: contact points in the coordinates of ``position``, (C, 2) [m]; None: give ``arm_a`` and ``arm_b``.
            normal: unit vectors from A to B, (C, 2).
            gap: distances of the surfaces, < 0 for an overlap, (C,) [m]; a gap above the slop may close in the step.
            friction: Coulomb coefficients, (C,), or one for all.
            restitution: coefficients in [0, 1], (C,), or one for all; ``SolverConfig`` defines the bounces.
            inv_mass: inverse masses, (N,) [1/kg].
            inv_inertia: inverse moments of inertia about the centres of mass, (N,) [1/(kg m^2)].
            position: centres of mass, (N, 2) [m]; needed with ``point`` and with joints.
            angle: orientations of the bodies, (N,) [rad]; needed with joints.
            arm_a: vectors from the centre of mass of A to the contact point, world axes, (C, 2) [m]; None: ``point``.
            arm_b: vectors from the centre of mass of B, (C, 2) [m].
            count: number of contacts of each world, (W,) int32, read at each call; None: C.
            color: colours that contacts keep from call to call, -1 for a new contact, (C,) int32; move them along with
                the contacts. The solver writes to it, and replaces a colour that two contacts of a body share. None:
                each call colours all contacts, in their order.
            velocity: velocities of the centres of mass, with the forces of the step applied, (N, 2) [m/s]; replaced by
                the solution. This and the next four may also be given with each call.
            angular_velocity: counter-clockwise, (N,) [rad/s]; replaced by the solution.
            velocity_before: before the step's forces, (N, 2) [m/s], for bounces and joints; None: as ``velocity``.
            angular_velocity_before: before the torques of the step, (N,) [rad/s].
            impulse: normal and tangential, start, then solution, (C, 2) [N s]; None: ``exchange.impulse``, from 0.
            joints: distance joints: ``joint_body_a``, ``joint_body_b``, ``joint_anchor_a``, ``joint_anchor_b``,
                ``joint_length`` and optionally ``joint_impulse`` (start, then solution) (``model.fields.JOINTS``).
            rows: other constraints between two bodies, by their Jacobians: arrays (R, ...), read at each call, by name
                (``solve.exchange.OWN_ROWS``). ``row_body_a`` and ``row_body_b``, (R,) int32; ``row_jacobian_a`` and
                ``row_jacobian_b``, (R, 3), the factors of their velocities (x, y, spin). The impulse makes
                J_A V_A + J_B V_B + bias + softness impulse = 0 unless it is at a bound, and changes V_A by M_A^-1
                J_A^T impulse. Arrays or numbers: ``row_bias`` (0) [m/s], ``row_lower`` (-inf) and ``row_upper`` (inf)
                [N s], ``row_softness`` (0) [1/kg]; ``row_impulse``: start, then solution [N s], None:
                ``rows.row_impulse``, initially zero.
            body_start: first body of each world and N, (W + 1,); None: one world.
            contact_start: first contact of each world and C, (W + 1,); None: one world.
            joint_start: first joint of each world and their number, (W + 1,); None: one world.
            row_start: first of each world's ``rows`` and their number, (W + 1,); None: one world.
            length_scale: typical diameter, unit of lengths in the settings, (W,) or one [m]; fixed, as the next two.
            weight: weight of a typical body, (W,) or one [N], the unit of ``relative_tolerance``; 0: not used.
            gravity: (W,) or one [m/s^2], which with ``length_scale`` defines the threshold of bounces
                (``SolverConfig``); needed unless ``restitution`` is the number 0 or 1.
            discs: whether all bodies that contacts rotate are centred discs, whose normals have no arm (faster).
            config: settings of the solver; it has no position phase: only position_correction="baumgarte" acts.
            threads: largest number of threads that share the worlds, and the loops within large ones.
            schedule: "world" (one thread solves a world) or "color" (one launch per colour).
            backend: "warp", "taichi", or "numpy", the slow oracle.

        Raises:
            ValueError: an argument is invalid; the error names argument, index and limit.
        """
        options = SimulationOptions(config, threads, schedule)
        discs, config = check_truth("discs", discs), check_awake(options.config or SolverConfig())
        refuse_lacking(point, arm_a, arm_b, position, angle, joints)
        contacts = len(check_layout("body_a", body_a, (None,), np.dtype(np.int32)))
        self.dtype, self.device = check_layout("normal", normal, (contacts, 2)).dtype, "cpu"
        self.backend, self.schedule, self._config, self.discs = check_backend(backend), schedule, config, int(discs)
        lines = own_lines(joints)
        lengths = {
            "body": length_of("inv_mass", inv_mass),
            "contact": contacts,
            "joint": length_of("joint_body_a", lines.get("joint_body_a", ())),
            "row": length_of("row_body_a", (own := own_rows(rows)).get("row_body_a", ())),
        }
        given_starts = {"body": body_start, "contact": contact_start, "joint": joint_start, "row": row_start}
        starts = offsets(lengths, given_starts)
        worlds = len(starts["body"]) - 1
        self._hosted = backend != "warp" or schedule != "world"
        self._shards = shards_of(self.backend, worlds, lengths["body"], options.threads, teams=schedule == "world")
        self.threads = self._shards.over_worlds + self._shards.helpers
        fewest = "joints" if lengths["joint"] else "discs" if discs else "general"
        self.variant = "rows" if lengths["row"] else fewest
        pull = gravity_of(gravity, restitution)
        self._make_groups({**lengths, "world": worlds, "world+1": worlds + 1}, starts, length_scale, weight, pull)
        touch = {"body_a": body_a, "body_b": body_b, "normal": normal, "gap": gap, "arm_a": arm_a, "arm_b": arm_b}
        self._shared = share_all(
            self.model, masses := {"inv_mass": inv_mass, "inv_inertia": inv_inertia}, needed=masses
        )
        self._shared |= share_all(self.state, {"position": position, "angle": angle})
        surface = {"friction": friction, "restitution": restitution}
        self._shared |= share_all(self.contacts, {**touch, **surface}, numbers=surface, needed=NEEDED)
        self._shared |= share_all(self.joints, lines, writes=WRITTEN, needed=LINES if lines else ())
        self._shared |= share_all(self.rows, own, writes=WRITTEN, numbers=own)
        given = dict(zip(PER_CALL, (velocity, angular_velocity, impulse, velocity_before, angular_velocity_before)))
        given |= {"count": count, "point": point, "color": color}
        self._given, self._at = {name: array for name, array in given.items() if array is not None}, dict[str, int]()
        self.exchange = make_exchange(self.contacts, lengths["body"], self._given)
        self.calls = OneCaller(f"the solver of {lengths['contact']} contacts and {lengths['body']} bodies")
        self._packed = self._complete = False
        self._bind_all()

    def _make_groups(
        self, sizes: dict[str, int], starts: Mapping[str, np.ndarray], length_scale: Any, weight: Any, gravity: Any
    ) -> None:
        """Allocate the groups that kernels work on; some of their fields are then shared."""
        memory = (self.dtype, self.device, self.backend)
        scene = {**sizes, "body+1": sizes["body"] + 1, "shape": 0, "shape+1": 1, "vertex": 0}
        self.model, self.state = Model(scene, *memory), State(scene, *memory)
        self.contacts, self.joints = Contacts(sizes, *memory), Joints(sizes, *memory)
        self.model.assign("body_start", starts["body"])
        self.model.assign("joint_start", starts["joint"])
        self.contacts.assign("contact_start", starts["contact"])
        self.model.assign("length_scale", for_each("length_scale", length_scale, sizes["world"], positive=True))
        self.model.numpy("gravity")[:, 1] = for_each("gravity", gravity, sizes["world"])
        weights, shards = for_each("weight", weight, sizes["world"]).astype(self.dtype), self._shards.parts
        self._integrator = Integrator(self.model, shards, self._config.method, weights)
        self.motion = self._integrator.motion
        self._storage = SolverStorage(
            self.model,
            self._config,
            self.variant,
            contacts=np.diff(starts["contact"]),
            bodies=self.motion.sizes["body+1"],
            at_once=shards if self._in_turn else sizes["world"],
            any_colors=True,
            own_rows=np.diff(starts["row"]),
        )
        self.rows, self.stats = self._storage.rows, self._storage.stats
        self.kernels: dict[str, Any] = {}
        for file, *options in FILES:
            chosen = (getattr(self, option) for option in options)
            self.kernels |= make_kernels(self.backend, file, self.dtype.name, *chosen)
        self._binding = Binding(self.kernels, self.model, self._shards)

    @property
    def _in_turn(self) -> bool:
        """Whether a shard on the host solves world after world; the backend's own threads share one shard."""
        return self.schedule == "world" and self._shards.parts == len(self._shards.ranges)

    def _bind_all(self) -> None:
        """Fetch all arrays and settings again; launches are bound when they are first needed."""
        self._shared |= share_all(self.exchange, self._given, writes=WRITTEN)
        groups: dict[str, ArrayGroup] = {name: getattr(self, name) for name in GROUPS_TAKEN}
        self._binding.renew(self._config, groups, self._storage.past_width, self._in_turn)
        self._rounds: dict[tuple[Call, SolverConfig | None], list[Rounds]] = {}
        self._brief: dict[Call, Rounds] = {}  # of calls that need no look while nothing else is given
        self._exchanges: list[Launch] = []  # launches that take the arrays of a call
        self._moved = False  # whether a call was given others than those that are shared

    @property
    def lengths(self) -> Mapping[str, int]:
        """Return the numbers of its elements, by noun."""
        return {name: self.contacts.sizes[name] for name in ("contact", "body", "joint", "world")}

    @property
    def config(self) -> SolverConfig:
        """Settings of the solver; replace it with ``dataclasses.replace``."""
        return self._config

    @config.setter
    def config(self, config: SolverConfig) -> None:
        config = check_awake(check_config("config", config))
        refuse_recording("a change of config", "make it before")
        with self.calls:
            self._storage.keep_history(config)
            self._config = config
            self._provide(config)
            self._packed = False
            self._bind_all()

    def _provide(self, config: SolverConfig) -> bool:
        """Allocate the memory that settings additionally need; return whether there was any."""
        return any([self._integrator.provide(config.method), self._storage.provide(config)])

    def bind(self, name: str, first: int, count: int, changed: Mapping[str, Any] | None = None) -> Launch:
        """Return a launch of a kernel over the worlds first .. first + count, one thread each."""
        return bind(self.kernels[name], count, self.launch_values(first, changed or {}), self.device)

    def launch_values(self, first: int, changed: Mapping[str, Any]) -> dict[str, Any]:
        """Return the kernel arguments for worlds from ``first`` on, with ``changed`` settings or numbers."""
        rest = {name: value for name, value in changed.items() if name != "kept"}
        return {**self._binding.launch_values(first, rest), "discs": self.discs, "kept": changed.get("kept", 0)}

    def pack(
        self,
        dt: float | np.ndarray,
        velocity: Any = None,
        angular_velocity: Any = None,
        *,
        velocity_before: Any = None,
        angular_velocity_before: Any = None,
        impulse: Any = None,
    ) -> None:
        """Read the present contacts, colour them and make their rows, from which ``solve(kept=True)`` continues.

        Arguments and errors are those of ``solve``.
        """
        given = None
        if not velocity is angular_velocity is impulse is velocity_before is angular_velocity_before is None:
            given = (velocity, angular_velocity, impulse, velocity_before, angular_velocity_before)
        self.calls.begin()  # as ``with`` does, in half the time
        try:
            if self._hosted:
                refuse_hosted(self.backend, self.schedule, self.device)
            self._integrator.set_time_step(dt)
            self._run("pack", None, given)
        finally:
            self.calls.end()

    def solve(
        self,
        dt: float | np.ndarray | None = None,
        velocity: Any = None,
        angular_velocity: Any = None,
        impulse: Any = None,
        *,
        velocity_before: Any = None,
        angular_velocity_before: Any = None,
        config: SolverConfig | None = None,
        kept: bool = False,
    ) -> SolveStats:
        """Solve from the start impulses and velocities, and write the solution to the same arrays.

        Arrays that were given to the constructor or to an earlier call need not be given again; other arrays of the
        same sizes may be given, which takes some microseconds. Giving the array of the previous call costs nothing.

        Args:
            dt: time step of all worlds, or of each (W,), > 0 [s]; None with ``kept``.
            velocity: see the constructor.
            angular_velocity: see the constructor.
            impulse: see the constructor.
            velocity_before: see the constructor.
            angular_velocity_before: see the constructor.
            config: settings of this solve, which may differ from the solver's in those of the iteration
                (``solve.schedules.ITERATION``).
            kept: whether contacts, joints, masses, time step and colours are those of the previous call, whatever their
                arrays now hold: only velocities and impulses are read. Bounces, and the norm to which the residual is
                relative, are then those of that call's velocities.

        Returns:
            ``stats``: sweeps, largest change of the last sweep [N s], and relative residual of each world.

        Raises:
            ValueError: a value is out of range, and nothing of its world was written (other worlds may have been
                solved); the error names array, index and limit. Or the solve diverged to infinity.
        """
        given = None
        if not velocity is angular_velocity is impulse is velocity_before is angular_velocity_before is None:
            given = (velocity, angular_velocity, impulse, velocity_before, angular_velocity_before)
        if config is not None:
            config, _ = check_solve(config, None, False, self.schedule)
        self.calls.begin()
        try:
            if self._hosted:
                refuse_hosted(self.backend, self.schedule, self.device)
            if check_truth("kept", kept):
                if dt is not None:
                    raise ValueError(f"dt is {dt!r}; with kept rows it is that of the call before, and None here")
                if not self._packed:
                    raise ValueError("kept needs the rows of a call before: give dt, and no kept")
            elif dt is None:
                raise ValueError("dt is None; it must be finite and > 0 [s]")
            else:
                self._integrator.set_time_step(dt)
            self._run("solve kept" if kept else "solve", config, given)
        finally:
            self.calls.end()
        return self.stats

    def _run(self, call: Call, config: SolverConfig | None, given: Sequence[Any] | None) -> None:
        """Adopt the arrays of a call, run its kernels, and raise an error for values out of range."""
        only = self._brief.get(call) if given is None and config is None else None
        if self._shards.disturbed or recording():
            only = None
        rounds = self._rounds_of(call, config, given) if only is None else []
        self._packed = False
        if self._shards.run(rounds, 1) if only is None else self._shards.run_once(only):
            groups = {name: getattr(self, name) for name in GROUPS_TAKEN}
            kept, positions = call == "solve kept", "position" in self._shared
            raise_fault(groups, self._given, kept=kept, positions=positions, discs=self.discs > 0)
        self._packed = True

    def _rounds_of(self, call: Call, config: SolverConfig | None, given: Sequence[Any] | None) -> list[Rounds]:
        """Adopt the arrays of a call and return its launches."""
        for name, array in zip(PER_CALL, given or ()):
            if array is not None and not stays(array, self._given.get(name), self._at.get(name)):
                self._take(name, array)
        if not self._complete:
            refuse_incomplete(self._given, self._shared)
            self._complete = True
        if self._moved and recording():
            self._bind_all()
        return self._rounds.get((call, config)) or self._bind(call, config)

    def _take(self, name: str, array: Any) -> None:
        """Let bound launches use another array; ``name`` is its name in errors."""
        self._complete = False
        self._brief.clear()
        if name in BEFORE:
            self.exchange.sizes["body before"] = self.exchange.sizes["body"]
        view = view_of(self.exchange, name, array, writes=name in WRITTEN)
        for launch in self._exchanges if view.size else ():
            if hasattr(launch, "give"):
                launch.give(f"exchange.{name}", view)
        self._given[name], self._at[name], self._shared[name] = array, view.ctypes.data, view
        if self.backend == "warp":
            self._moved = True
        else:
            share_all(self.exchange, {name: array}, writes=WRITTEN)

    def _bind(self, call: Call, config: SolverConfig | None) -> list[Rounds]:
        """Bind the launches of a kind of call with its own settings."""
        if len(self._rounds) >= SOLVES:
            self._rounds.clear()
            self._brief.clear()
            self._exchanges.clear()
        if config is not None:
            check_iteration(config, self._config)
        if self._provide(config or self._config) or self._moved:
            self._bind_all()
        changed = {} if config is None else config.kernel_values()
        changed["kept"] = int(call == "solve kept")

        def launches(first: int, count: int) -> list[Launch]:
            receive = self.bind("receive_velocities", first, count, changed)
            found = [receive]
            if call != "solve kept":
                names = ("keep_colors",) if "color" in self._given else ()
                names = ("receive_contacts", *names, "color_constraints", "pack_rows")
                one, *others = (self.bind(name, first, count, changed) for name in names)
                found = [one, receive, *others]
            if call != "pack":
                send = self.bind("send", first, count, changed)
                found += [*SCHEDULES[self.schedule](self, first, count, changed), send]
                self._exchanges.append(send)
            self._exchanges.append(receive)
            return found

        watch, sweeps = Watch(self.state.flags, STOPS, ()), (config or self._config).max_sweeps
        bound = self._shards.rounds(launches, watch, together=False, sweeps=sweeps)
        self._rounds[call, config] = bound
        if config is None and (only := self._shards.brief(bound)) is not None:
            self._brief[call] = only
        return bound
