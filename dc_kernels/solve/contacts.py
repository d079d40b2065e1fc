"""The contact solver as a stage for anybody's bodies and contacts, on the arrays that they lie in."""

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
from dc_kernels.runtime.stepping import shards_of
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
    """Impulses and velocities of bodies in contact, of any engine: the solver of ``Simulation`` as a stage.

    The arrays of bodies and contacts are given once and read where they lie at each call: refill them in place. They
    have the length of what a world may have at most; ``count`` says how many contacts it has. Worlds are an axis: those
    of many lie flat, one world after the other.

    A contact's normal is a unit vector from body A to body B, its tangent the normal turned by -90 degrees, t = (n_y,
    -n_x); impulses act on B, the opposite ones on A. A body with inverse mass and inverse inertia 0 is moved by no
    contact, but may have a velocity. All is in SI units. The method is projected Gauss-Seidel in the order of a
    colouring (Wu 2018, section 2.2; ``SolverConfig``), in SIMD lanes on a CPU; the result has the same bits whatever
    ``threads`` and the other worlds are.

    Within ``wp.ScopedCapture`` a call becomes part of the graph; a replay reads and writes the arrays that it was
    recorded with, and a world whose arrays are out of range is left as it is, with a bit in ``state.flags``.

    Attributes:
        contacts, joints, motion, rows, stats, state, model: what kernels work on (``model.fields``); ``contacts.color``
            holds the colours, ``stats`` what the last solve did.
        calls: what each call holds while it works; a call during that of another thread raises RuntimeError.
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
        """Look at the arrays, which stay where they are, and allocate what a solve needs.

        The arrays are numpy arrays, torch tensors, ``wp.array`` or whatever has ``__dlpack__``, in the CPU's memory,
        contiguous, of int32 or of the scalar that ``normal`` has, float32 or float64. N is the number of bodies, C the
        contacts that there is room for, W the worlds.

        Args:
            body_a: body A of each contact, (C,) int32.
            body_b: body B, (C,) int32.
            point: contact points in the coordinates of ``position``, (C, 2) [m]; None: arms are given.
            normal: unit vectors from A to B, (C, 2).
            gap: distance of the surfaces, < 0 where they overlap, (C,) [m]; one above the slop may close in the step.
            friction: Coulomb coefficients, (C,), or one of all.
            restitution: coefficients in [0, 1], (C,), or one of all; bounces are those of ``SolverConfig``.
            inv_mass: inverse masses, (N,) [1/kg].
            inv_inertia: inverse moments of inertia about the centres of mass, (N,) [1/(kg m^2)].
            position: centres of mass, (N, 2) [m]; needed with ``point`` and with joints.
            angle: of the bodies, (N,) [rad]; needed with joints.
            arm_a: from the centre of mass of A to the contact point, world axes, (C, 2) [m]; None: made of ``point``.
            arm_b: from the centre of mass of B, (C, 2) [m].
            count: contacts of each world, (W,) int32, read at each call; None: all that there is room for.
            color: colours that contacts keep from call to call, -1 for a new one, (C,) int32, to be moved along with
                the contacts; it is then written to. One that another contact of a body has too is chosen anew. None:
                each call colours all contacts anew, in their order.
            velocity: of the centres of mass, with the forces of the step applied, (N, 2) [m/s]; then the solution.
                This and the next four may also be given with each call.
            angular_velocity: counter-clockwise, (N,) [rad/s]; then the solution.
            velocity_before: before the step's forces, (N, 2) [m/s], for bounces and joints; None: as ``velocity``.
            angular_velocity_before: before the torques of the step, (N,) [rad/s].
            impulse: normal and tangential: start, then solution, (C, 2) [N s]; None: ``exchange.impulse``, from zero.
            joints: distance joints: ``joint_body_a``, ``joint_body_b``, ``joint_anchor_a``, ``joint_anchor_b``,
                ``joint_length`` and perhaps ``joint_impulse`` (start, then solution) by name (``model.fields.JOINTS``).
            rows: any other constraints of two bodies, by their Jacobians: arrays (R, ...), read at each call, by name
                (``solve.exchange.OWN_ROWS``). ``row_body_a`` and ``row_body_b``, (R,) int32; ``row_jacobian_a`` and
                ``row_jacobian_b``, (R, 3), what (x, y, spin) of their velocities are multiplied by. The impulse makes
                J_A V_A + J_B V_B + bias + softness impulse = 0 unless it is at a bound, and changes V_A by M_A^-1
                J_A^T impulse. Arrays or numbers: ``row_bias`` (0) [m/s], ``row_lower`` (-inf) and ``row_upper`` (inf)
                [N s], ``row_softness`` (0) [1/kg]; ``row_impulse``: start, then solution [N s], None: own memory,
                ``rows.row_impulse``, zero at first.
            body_start: first body of each world and N, (W + 1,); None: one world.
            contact_start: first contact of each world and C, (W + 1,); None: one world.
            joint_start: first joint of each world and their number, (W + 1,); None: one world.
            row_start: first of each world's ``rows`` and their number, (W + 1,); None: one world.
            length_scale: typical diameter, unit of lengths in the settings, (W,) or one [m]; read now, as the next two.
            weight: of a typical body, (W,) or one [N], to which ``relative_tolerance`` is relative; 0: to nothing.
            gravity: (W,) or one [m/s^2], to which the threshold of bounces is relative (``SolverConfig``); needed
                unless ``restitution`` is the number 0 or 1.
            discs: all bodies that contacts turn are discs about their centres, whose normals have no arm: less work.
            config: settings of the solver; it has no position phase: only position_correction="baumgarte" acts.
            threads: at most so many threads share the worlds, and the loops within large ones.
            schedule: "world" (a thread runs a world's solve) or "color" (a launch a colour).
            backend: "warp", "taichi", or "numpy": the oracle, never fast.

        Raises:
            ValueError: naming argument, index and limit.
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
        """Whether a shard of the host solves world after world; threads of the backend's own share one shard."""
        return self.schedule == "world" and self._shards.parts == len(self._shards.ranges)

    def _bind_all(self) -> None:
        """Take arrays and settings anew; launches are bound when they are first wanted."""
        self._shared |= share_all(self.exchange, self._given, writes=WRITTEN)
        groups: dict[str, ArrayGroup] = {name: getattr(self, name) for name in GROUPS_TAKEN}
        self._binding.renew(self._config, groups, self._storage.past_width, self._in_turn)
        self._rounds: dict[tuple[Call, SolverConfig | None], list[Rounds]] = {}
        self._brief: dict[Call, Rounds] = {}  # of calls that need no look while nothing else is given
        self._exchanges: list[Launch] = []  # launches that take the arrays of a call
        self._moved = False  # whether a call was given others than those that are shared

    @property
    def lengths(self) -> Mapping[str, int]:
        """How many it works on, by noun."""
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
        """Allocate what settings need and have not got yet; whether there was any."""
        return any([self._integrator.provide(config.method), self._storage.provide(config)])

    def bind(self, name: str, first: int, count: int, changed: Mapping[str, Any] | None = None) -> Launch:
        """A launch of a kernel over the worlds first .. first + count, one thread each; with ``changed`` arguments."""
        return bind(self.kernels[name], count, self.launch_values(first, changed or {}), self.device)

    def launch_values(self, first: int, changed: Mapping[str, Any]) -> dict[str, Any]:
        """Arguments of the kernels for worlds from ``first`` on, with ``changed`` settings or numbers."""
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
        """Take the contacts as they now stand, colour them and make their rows; ``solve(kept=True)`` goes on from them.

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
        """Solve from the start impulses and the velocities, which the solution is written over.

        Arrays that were given to the constructor or to an earlier call need not be given again; others may be, of the
        same sizes, and cost some microseconds. Giving an array is free where it is the one of the call before.

        Args:
            dt: time step, of all worlds or of each, (W,), > 0 [s]; None with ``kept``.
            velocity: see the constructor, as the others.
            angular_velocity: see there.
            impulse: see there.
            velocity_before: see there.
            angular_velocity_before: see there.
            config: settings of this one solve, which may differ from the solver's in those of the iteration
                (``solve.schedules.ITERATION``).
            kept: contacts, joints, masses, time step and colours are those of the call before, whatever their arrays
                now hold: only velocities and impulses are taken anew. A bounce and the norm that the residual is
                relative to are then those of that call's velocities.

        Returns:
            ``stats``: sweeps, largest change of the last [N s], and relative residual of each world.

        Raises:
            ValueError: naming array, index and limit, for what is out of range, with nothing of its world written;
                of several worlds others may have been solved. Or for a solve that ran off to infinity.
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
        """Take the arrays of a call, run its kernels, and say what they found out of range."""
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
        """Take the arrays of a call; its launches."""
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
        """Let bound launches work on another array, which errors name."""
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
        """Bind the launches of a kind of call with settings of its own."""
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
