"""A simulation: the order of the stages, what a scene skips, threads over worlds, growth of capacity."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Literal

import numpy as np

from dc_kernels.binding import Binding
from dc_kernels.choice import choose_kernels
from dc_kernels.collide.broadphase import Pairs
from dc_kernels.collide.contacts import Cache
from dc_kernels.collide.switches import Switches
from dc_kernels.driving.between import Stepper, check_between, run_between
from dc_kernels.driving.driven import Driven, options_of_model
from dc_kernels.events.lists import Overlaps, Touches
from dc_kernels.explain import describe, explain
from dc_kernels.model.arrays import Contacts, Model, State
from dc_kernels.model.config import DEFAULT, SimulationOptions, SolverConfig, check_config
from dc_kernels.model.enums import CAPACITY_FLAGS
from dc_kernels.model.groups import GROUPS
from dc_kernels.model.joints.groups import Joints
from dc_kernels.model.validate.known import Facts
from dc_kernels.model.validate.scene import check_scene
from dc_kernels.model.worlds import WorldSegments
from dc_kernels.reports import capacity, memory
from dc_kernels.runtime.backends import Launch
from dc_kernels.runtime.capture import refuse_hosted, refuse_recording
from dc_kernels.runtime.inputs import check_whole
from dc_kernels.runtime.sequences import Needing, Rounds, Watch
from dc_kernels.runtime.threads import GPU_CALLS, OneCaller, uninterrupted
from dc_kernels.sleep.sleepers import Sleepers
from dc_kernels.solve import schedules
from dc_kernels.solve.integrate import Motion
from dc_kernels.solve.joints import are_rods
from dc_kernels.solve.storage import Rows, SolveStats
from dc_kernels.stages import PHASES, Phase, Turn, needs_of, of_phase
from dc_kernels.storage import Storage

Start = Callable[["Simulation"], None]


class Simulation(Driven):
    """Rigid bodies with contacts in any number of worlds, stepped together.

    A step is three phases that can be called one by one: ``collide`` (predict velocities, find contacts, match them
    with those of the previous step), ``solve`` (from ``contacts.impulse`` to the solution), ``advance`` (commit).
    Only ``advance`` changes ``state``, so the first two may be repeated.

    Worlds are independent: the result of each has the same bits whatever the others, ``threads`` and the schedule.

    Several Python threads may call different simulations at once, and take turns with one simulation; a call during
    that of another thread raises RuntimeError and has no effect. An interrupt (Ctrl-C) leaves all worlds at the same
    time; solves that take longer than half a second from then on are cut short (``running``).

    A call on the CPU within ``wp.ScopedCapture`` becomes part of that graph, or raises RuntimeError before anything is
    recorded; ``phase`` stays that of the calls that ran. Arrays cannot grow while a graph is replayed: a world that
    runs out of room stops with its flag set, until the next call outside the graph allocates more. Then
    ``layout_version`` has changed, and the graph, which refers to the old arrays, must be recorded again. On a GPU the
    calls of all simulations wait for each other, and none becomes part of a graph.

    A world whose numbers become NaN or inf stops without an error and keeps its state: check ``state.flags``, bits of
    ``Flag``. It continues once finite values and flags of 0 are written (``state.assign``).

    Attributes:
        overlaps: pairs of a sensor and another shape, of the last step (docs/events.md).
        touches: pairs of shapes whose contacts touch, with ``SolverConfig.contact_events``.
        built: the state that the simulation was made with, to which ``reset`` returns.
        calls: the lock that each call holds; ``with sim.calls:`` keeps other threads out for several calls.
    """

    built: State
    motion: Motion
    pairs: Pairs
    contacts: Contacts
    cache: Cache
    rows: Rows
    stats: SolveStats
    sleepers: Sleepers
    overlaps: Overlaps
    touches: Touches
    switches: Switches
    calls: OneCaller

    @options_of_model
    def __init__(
        self,
        model: Model,
        state: State | None = None,
        joints: Joints | None = None,
        *,
        config: SolverConfig | None = None,
        threads: int = 1,
        schedule: Literal["world", "color"] = "world",
        on_overflow: Literal["grow", "raise"] = "grow",
        specialize: bool = True,
        pairs_per_shape: float = 4.0,
        contacts_per_body: float = 2.5,
    ) -> None:
        """Allocate everything a step needs.

        Args:
            model: model from ``ModelBuilder.finalize``; it determines backend, device and dtype.
            state: state from ``ModelBuilder.finalize``; the simulation changes it in place.
            joints: joints from ``ModelBuilder.finalize``, or None.
            config: settings of the solver; the attribute ``config`` may be replaced between steps and solves.
            threads: largest number of threads that share the worlds (launches release the GIL) and the loops within
                large worlds; fewer are used where sharing would cost more; on a GPU one.
            schedule: "world" (one thread solves a world) or "color" (one launch per colour, for large worlds on a GPU).
            on_overflow: whether a step that needs more pairs or contacts than reserved reallocates ("grow"), or
                raises OverflowError with the state of the last step intact ("raise").
            specialize: use special kernels if a scene has only discs; results differ by rounding.
            pairs_per_shape: candidate pairs reserved at first, per shape.
            contacts_per_body: contacts reserved at first, per body.

        Raises:
            ValueError: a setting is out of range; arrays do not belong together, or violate a rule of their field.
        """
        options = SimulationOptions(
            config, threads, schedule, on_overflow, specialize, pairs_per_shape, contacts_per_body
        )
        state, joints, facts = check_scene(model, state, joints)
        self.model, self.state, self.joints, self.built = model, state, joints, state.copy()
        self._segments = WorldSegments(model.memory, joints.memory("joint_row_start"))
        self.dtype, self.device, self.backend = model.dtype, model.device, model.backend
        self.schedule, self.on_overflow = options.schedule, options.on_overflow
        threads = options.threads if self.device == "cpu" else 1
        at_once = self._divide(threads)
        self.specialize = options.specialize
        self._config = options.config or DEFAULT
        schedules.check_schedule(self._config, self.schedule)
        self._choose_kernels(self._config, facts)
        self.storage = Storage(
            model,
            joints,
            self._config,
            variant=self.variant,
            pairs=options.pairs_per_shape,
            contacts=options.contacts_per_body,
            shards=self._shards.parts,
            at_once=at_once,
            facts=facts,
        )
        self._binding = Binding(self.kernels, model, self._shards)
        self._turn = Turn()
        self.calls = OneCaller(
            f"the simulation of {model.world_count} worlds and {model.body_count} bodies",
            None if self.device == "cpu" else GPU_CALLS,
        )
        self._rounds: dict[str, list[Rounds]] = {}
        self._solves: dict[tuple[SolverConfig | None, int | None, bool], list[Rounds]] = {}
        self._bind_all()
        for group in (model, joints):
            group.fixed = True
            group.users.add(self)

    def __repr__(self) -> str:
        """Return the numbers of worlds and bodies, and of worlds that do not advance."""
        return describe(self)

    def _choose_kernels(self, config: SolverConfig, facts: Facts | None = None) -> None:
        """Choose the kernels that the model and the settings need; ``facts`` of the model may be known already."""
        chosen = choose_kernels(self.model, self.joints, config, self.specialize, facts)
        self.only_discs, self.variant, self.added_kernels, self.kernels = chosen

    def adapt_to_model(self, stale: bool) -> None:
        """Adopt the kernels and coefficients of a changed model; with ``stale`` recorded graphs become invalid."""
        variant, kernels = self.variant, self.kernels
        self._choose_kernels(self._config)
        if variant != self.variant or self.storage.general == are_rods(self.joints):
            self.storage.use(self.variant, self._config)
        stale |= self.storage.roll() | self.storage.equip(self._config)
        stale |= kernels != self.kernels or self._binding.stale
        if stale:
            self._binding.kernels = self.kernels
            self.storage.changes += 1
            self._bind_all()

    def _bind_all(self) -> None:
        """Fetch all arrays and settings again; launches are bound when they are first needed."""
        config = self._config
        self.storage.share_joints()
        self._parts = config.whole_substeps
        for name, group in self.storage.groups().items():
            self.__dict__[name] = group
        groups = {name: getattr(self, name) for name in GROUPS}
        for group in groups.values():
            group.segments = self._segments
        self._binding.renew(config, groups, self.storage.solver.past_width, self._in_turn)
        self._rounds.clear()
        self._solves.clear()
        self._reset = None
        self._shards.idle = None
        if config.sleep and self.device == "cpu":
            dormant = self.sleepers.numpy("dormant")
            self._shards.idle = lambda: bool(dormant.all())
        # a view is kept: making one takes longer than a small world's kernels
        self._flags = self.state.numpy("flags")
        used = (self.pairs.near_count, self.contacts.contact_count, self.rows.block_needed)
        sleep = [self.sleepers.array(name) for name in ("sleeping", "dormant", "waited")] if config.sleep else []
        noting = self.overlaps.sizes["world"] or self.touches.sizes["world"]
        clock = (self.state.time, self.motion.step_dt) if config.sleep and not noting else ()
        self._watch = Watch(self.state.flags, int(CAPACITY_FLAGS), used, tuple(sleep), clock)

    @property
    def values(self) -> Mapping[str, Any]:
        """Groups and settings as kernel arguments, by name."""
        return self._binding.values

    def _phase_launches(
        self, phase: Phase, first: int, count: int, changed: Mapping[str, Any] | None = None
    ) -> list[Launch]:
        config = self._config
        names = of_phase(phase, config.corrects_positions, config.sleep, self.added_kernels, config.soft)
        if phase != "solve":
            launches = [self._binding.bind(name, first, count, {}) for name in names]
        else:
            launches = schedules.SCHEDULES[self.schedule](self, first, count, changed or {})
            if config.sleep:
                launches = [self.bind(names[0], first, count), *launches, self.bind(names[-1], first, count)]
                names = [names[0], *["solve_world"] * (len(launches) - 2), names[-1]]
        return [Needing(launch, need) for launch, need in zip(launches, needs_of(names))] if config.sleep else launches

    def bind(self, name: str, first: int, count: int, changed: Mapping[str, Any] | None = None) -> Launch:
        """Return a launch of a kernel (``stages.STEP``) over the worlds first .. first + count, one thread each.

        ``changed`` are settings of ``config``, or numbers of the launch (``model.fields.LAUNCH``), that it has instead.

        Raises:
            TypeError, ValueError: naming what is not there.
        """
        return self._binding.bind_checked(name, first, count, {} if changed is None else changed)

    def launch_values(self, first: int, changed: Mapping[str, Any]) -> dict[str, Any]:
        """Return the kernel arguments for worlds from ``first`` on, with ``changed`` settings or launch numbers."""
        return self._binding.launch_values(first, changed)

    @property
    def config(self) -> SolverConfig:
        """Settings of the solver; replace it with ``dataclasses.replace``."""
        return self._config

    @config.setter
    def config(self, config: SolverConfig) -> None:
        config = check_config("config", config)
        if config == self._config:
            return
        refuse_recording("a change of config", "make it before")
        with self.calls:
            with uninterrupted():
                if config.choosing != self._config.choosing:
                    schedules.check_change(config, self._config, self._turn.ran, self.schedule)
                    self._choose_kernels(config)
                    self._binding.kernels = self.kernels
                self.storage.adapt(config)
                self._config = config
                self._bind_all()
            if self._turn.ran != "advance":
                # rows depend on the settings too: those of the step in flight are made anew
                for shard in self._shards.ranges:
                    self.bind("pack_rows", *shard)()

    @property
    def phase(self) -> Phase:
        """Phase of a step that was called last: "advance" between two steps, "collide" or "solve" within one."""
        return self._turn.ran

    @property
    def layout_version(self) -> int:
        """Number that changes whenever arrays are reallocated; views of the old arrays are then no longer updated.

        Arrays are reallocated when a step, a new configuration or the contacts of an earlier run need more room. A
        view is an array, NumPy array or tensor taken from a field such as ``contacts.impulse``; if the number has
        changed, fetch it again. ``change_model`` changes it too, where a recorded graph would use the old model.
        """
        return self.storage.version

    def warmup(self) -> None:
        """Compile and bind everything now instead of in the first step (seconds, if kernels are not in the cache)."""
        with self.calls:
            for phase in (*PHASES, "step"):
                self._phase_rounds(phase)

    def step(self, dt: float, start: Start | None = None, *, stepper: Stepper | None = None) -> None:
        """Make one time step of dt [s] in every world.

        Args:
            dt: time step, > 0 [s].
            start: function called between ``collide`` and ``solve``; writes start impulses to ``contacts.impulse``.
            stepper: object whose ``solve`` is called between ``collide`` and ``advance`` instead of the solver.

        Raises:
            ValueError: dt is not finite and positive, or a start impulse is not finite.
            OverflowError: capacity is exceeded with on_overflow="raise"; the state is that of the previous step.
        """
        self.run(1, dt, start, stepper=stepper)

    def run(
        self,
        steps: int,
        dt: float,
        start: Start | None = None,
        callback: Callable[[Simulation], None] | None = None,
        *,
        stepper: Stepper | None = None,
    ) -> None:
        """Make many time steps; without start, callback and stepper each thread runs its worlds through all at once.

        Args:
            steps: number of steps.
            dt: time step, > 0 [s].
            start: see ``step``; it is called in each of the ``whole_substeps`` of a step.
            callback: function called after each step.
            stepper: see ``step``.

        Raises:
            ValueError, OverflowError: see ``step``.
        """
        steps = check_whole("steps", steps)
        plain = start is None and callback is None and stepper is None
        if not plain:
            check_between(self, start, callback, stepper)
        self.calls.begin()
        try:
            refuse_hosted(self.backend, self.schedule, self.device)
            parts = self._parts
            self.storage.integrator.set_time_step(dt, parts)
            if plain:
                self._run_steps(steps * parts)
            else:
                run_between(self, steps, dt, start, callback, stepper)
        finally:
            self.calls.end()

    def collide(self, dt: float | np.ndarray) -> None:
        """Predict velocities and find the contacts of the step; their impulses are the start of the solve.

        Args:
            dt: time step, > 0 [s], of all worlds, or of each, (W,); only "tgs_soft" divides it into substeps.

        Raises:
            ValueError, OverflowError: see ``step``.
        """
        with self.calls:
            refuse_hosted(self.backend, self.schedule, self.device)
            self.storage.integrator.set_time_step(dt)
            self._collide()

    def solve(self, config: SolverConfig | None = None, *, pause: int | None = None) -> None:
        """Solve from ``contacts.impulse`` and the predicted velocities; the impulses then hold the solution.

        A start impulse that is NaN or inf stops its world; ``check_start`` tells of which contact it is.

        Args:
            config: settings of this solve, which may differ from the simulation's in those of the iteration
                (``solve.schedules.ITERATION``); None: the simulation's.
            pause: number of sweeps in each world after which the solve pauses, 0 before the first; ``resume``
                continues it. With acceleration "aitken", which replaces "adaptive" in a solve that pauses, it pauses
                at the end of a period. Impulses, ``motion.solved`` and ``stats`` are then intermediate values;
                ``running`` tells which worlds have not finished.

        Raises:
            ValueError: the call is out of turn; another setting differs, or the pause is out of range.
        """
        with self.calls:
            self._turn.check("solve")
            self._solve(config, pause, resume=False)

    def resume(self, config: SolverConfig | None = None, *, pause: int | None = None) -> None:
        """Continue a paused solve in the worlds that have not finished.

        A world whose ``stats.replaced`` is 1 continues from ``contacts.impulse``, which may have been changed; the
        others end with the bits of a solve without a pause, except at ``max_sweeps`` where that returns to better ones.

        Args:
            config: as in ``solve``; it must be that of the paused solve.
            pause: sweeps until the next pause; None: solve to the end.

        Raises:
            ValueError: see ``solve``.
        """
        with self.calls:
            self._turn.check("resume")
            self._solve(config, pause, resume=True)

    @property
    def running(self) -> np.ndarray:
        """Mask of the worlds whose solve is paused, or was cut short by an interrupt, bool (W,)."""
        done = self.stats.numpy("iteration")["finished"] != 0
        return ~done & (self.state.numpy("flags") == 0)

    def _solve(self, config: SolverConfig | None, pause: int | None, resume: bool) -> None:
        config, pause = schedules.check_solve(config, pause, resume, self.schedule, self._config.soft)
        refuse_hosted(self.backend, self.schedule, self.device)
        if config is None and pause is None and not resume:
            self._take("solve")
        else:
            key = (config, pause, resume)
            if key not in self._solves:
                if len(self._solves) >= schedules.SOLVES:
                    self._solves.clear()
                if config is not None:
                    schedules.check_iteration(config, self._config)
                    if self.storage.provide(config):
                        self._bind_all()
                changed = schedules.settings_of_solve(config or self._config, pause, resume)
                self._solves[key] = self._bind_rounds(("solve",), changed)
            self._take("solve", self._solves[key])

    def advance(self) -> None:
        """Commit the step: update velocities, positions with their correction, time, and the contact cache."""
        with self.calls:
            self._turn.check("advance")
            refuse_hosted(self.backend, self.schedule, self.device)
            self._take("advance")

    def check_start(self) -> None:
        """Raise ValueError, naming the contact, if a start impulse is NaN or inf."""
        self.storage.narrowphase.check_start()

    def restore_contacts(self, count: np.ndarray, arrays: Mapping[str, np.ndarray], contact_dt: np.ndarray) -> None:
        """Put contacts of an earlier run into the cache from which the next step starts.

        Args:
            count: number of contacts of each world, (W,).
            arrays: fields of ``model.fields.CONTACTS`` by name, the worlds' contacts one after the other, sorted by
                key; key, impulse, color and age are needed.
            contact_dt: time step of the impulses, (W,) [s].

        Raises:
            ValueError: an array is missing, has a wrong shape or a value out of range (with index and limit).
        """
        refuse_recording("restore_contacts", "it writes at once")
        with self.calls, uninterrupted():
            self.storage.restore(count, arrays, contact_dt, self._flags, self._config)
            self._turn.ran = "advance"
            self._bind_all()

    def capacity(self) -> dict[str, dict[str, int]]:
        """Return numbers of pairs, contacts and row blocks: reserved, used now, and the largest of one world."""
        return capacity(self.storage, self._shards.peak.max(axis=0))

    def memory(self) -> dict[str, int]:
        """Return the bytes allocated for bodies (with their shapes and pairs) and for contacts (with their rows)."""
        return memory((self.model, self.state, self.built, self.joints, *self.storage.groups().values()))

    def explain(self) -> str:
        """Return a text that tells what runs for this scene, what is skipped, and why."""
        return explain(self)
