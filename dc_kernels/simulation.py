"""A simulation: the order of the stages, what a scene skips, threads over worlds, growth of capacity."""

from __future__ import annotations

import itertools
import os
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any, Literal

import numpy as np

from dc_kernels.model.arrays import Contacts, Joints, Model, State, uniform
from dc_kernels.model.config import ACCELERATIONS, SolverConfig
from dc_kernels.model.enums import CAPACITY_FLAGS, BodyType, ShapeType
from dc_kernels.runtime.backends import Launch, bind, in_turn, kernel_table, recorded
from dc_kernels.runtime.inputs import check_count
from dc_kernels.solve.iteration import COUNTERS, NEVER
from dc_kernels.solve.schedules import SCHEDULES, SolveStats, check_iteration, solver_scalars
from dc_kernels.storage import PADDING, Cache, Motion, Pairs, Rows, Storage

Start = Callable[["Simulation"], None]
_COLLIDE = ("predict", "update_pairs", "narrowphase", "match_contacts", "color_constraints", "pack_rows")
SHARDS_PER_THREAD = 2
CHUNK = 10  # steps that a thread takes of a shard at a time: 250 at once leaves one idle at the end for 3 %
_SLACK = 0.05  # of the slop: within it two separating axes count as equal and the first body's is taken


class Simulation:
    """Rigid bodies with contacts in any number of worlds, stepped together.

    A step is three phases that can be called one by one: ``collide`` (predict velocities, find contacts, match them
    with those of the step before), ``solve`` (from ``contacts.impulse`` to the solution), ``advance`` (commit).
    Before ``advance`` nothing of ``state`` changes, so the first two may be repeated.

    Worlds are independent: the result of each has the same bits whatever the others, ``threads`` and the schedule.
    """

    motion: Motion
    pairs: Pairs
    contacts: Contacts
    cache: Cache
    rows: Rows
    stats: SolveStats

    def __init__(
        self,
        model: Model,
        state: State,
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
            model: from ``ModelBuilder.finalize``; its backend, device and dtype are the simulation's.
            state: evolves in place.
            joints: None for none.
            config: settings of the solver; the attribute ``config`` may be replaced between steps and solves.
            threads: Python threads that worlds are sharded over (launches release the GIL); at most one a world.
            schedule: "world" (a thread runs a world's solve) or "color" (a launch a colour, for large worlds on a GPU).
            on_overflow: what happens when a step needs more pairs or contacts than reserved: reallocate and go on, or
                raise OverflowError with the state of the last step intact.
            specialize: use kernels for discs only where a scene has only discs.
            pairs_per_shape: candidate pairs reserved at first.
            contacts_per_body: contacts reserved at first.

        Raises:
            ValueError: for settings out of range, or arrays of another model, dtype, device or backend.
        """
        threads = check_count("threads", threads)
        if schedule not in SCHEDULES:
            raise ValueError(f"schedule is {schedule!r}; it must be one of {tuple(SCHEDULES)}")
        if on_overflow not in ("grow", "raise"):
            raise ValueError(f"on_overflow is {on_overflow!r}; it must be 'grow' or 'raise'")
        for name, value in (("pairs_per_shape", pairs_per_shape), ("contacts_per_body", contacts_per_body)):
            if not 0.0 <= value < float("inf"):
                raise ValueError(f"{name} is {value!r}; it must be finite and not negative")
        self.model = model
        self.state = state
        self.dtype = model.dtype
        self.device = model.device
        self.backend = model.backend
        if joints is None:
            joints = Joints({"joint": 0}, self.dtype, self.device, self.backend)
        self.joints = joints
        self._check_groups()
        self.schedule = schedule
        self.on_overflow = on_overflow
        self.threads = max(1, min(threads, model.world_count))
        # more shards than threads: who is done first takes on what is left
        shards = 1 if self.threads == 1 else min(SHARDS_PER_THREAD * self.threads, model.world_count)
        edges = np.linspace(0, model.world_count, shards + 1).astype(int)
        self._shards = [(int(a), int(b - a)) for a, b in itertools.pairwise(edges)]
        self.specialize = specialize
        self.variant = self._row_variant()
        self.kernels = kernel_table(self.backend, self.dtype.name, self.variant, self.only_discs and specialize)
        self._config = config or SolverConfig()
        # on a CPU a shard solves world after world
        self._one_by_one = schedule == "world" and self.device == "cpu"
        at_once = len(self._shards) if self._one_by_one else model.world_count
        self.storage = Storage(
            model, joints, self._config, self.variant, pairs_per_shape, contacts_per_body, len(self._shards), at_once
        )
        self._rename_groups()
        self._peak = {"pairs": 0, "contacts": 0, "blocks": 0}
        self._phase = "advance"
        self._halt = False
        self._lock = threading.Lock()
        self._left: list[int] = []
        self._busy: set[int] = set()
        self._commands: dict[str, list[Launch]] = {}
        self._solves: dict[tuple[SolverConfig | None, int | None, bool], list[Launch]] = {}
        self._pool = ThreadPoolExecutor(self.threads) if self.threads > 1 else None
        self._bind_all()

    # ------------------------------------------------------------------ set-up

    def _check_groups(self) -> None:
        model = self.model
        for name, group in (("state", self.state), ("joints", self.joints)):
            for what in ("dtype", "device", "backend"):
                if getattr(group, what) != getattr(model, what):
                    raise ValueError(
                        f"{name}.{what} is {getattr(group, what)}; it must be the model's, {getattr(model, what)}"
                    )
        for axis in ("body", "world"):
            if self.state.sizes[axis] != model.sizes[axis]:
                raise ValueError(
                    f"state has {self.state.sizes[axis]} on axis {axis!r}; it must be the model's {model.sizes[axis]}"
                )
        if self.joints.sizes["joint"] != model.joint_count:
            raise ValueError(f"joints has {self.joints.sizes['joint']}; it must be the model's {model.joint_count}")
        model.check("model")
        self.state.check("state")
        self.joints.check("joints")

    def _row_variant(self) -> str:
        """Row variant: what the scene needs and no more."""
        model = self.model
        moving = (model.numpy("body_type") != BodyType.STATIC)[model.numpy("shape_body")]
        centred_disc = (model.numpy("shape_type") == ShapeType.DISC) & ~model.numpy("shape_center").any(axis=1)
        self.only_discs = bool((~moving | centred_disc).all())
        if model.joint_count:
            return "joints"
        return "discs" if self.only_discs and self.specialize else "general"

    def _rename_groups(self) -> None:
        """The groups of the storage under the names users know."""
        for name in ("motion", "pairs", "contacts", "cache", "rows", "stats"):
            setattr(self, name, getattr(self.storage, name))

    def _bind_all(self) -> None:
        """Pack every launch's arguments, for each shard of worlds."""
        config = self._config
        baumgarte = config.position_factor if config.position_correction == "baumgarte" else 0.0
        self.values: dict[str, Any] = {
            "margin_factor": config.margin,
            "speculative_factor": config.speculative,
            "speculative_limit": config.speculative_max,
            "slack_factor": _SLACK * config.slop,
            "uniform_friction": uniform(self.model.numpy("shape_friction")),
            "uniform_restitution": uniform(self.model.numpy("shape_restitution")),
            "slop_factor": config.slop,
            "baumgarte": baumgarte,
            "max_correction": config.max_correction,
            "restitution_threshold": config.restitution_threshold,
            "use_cache": int(config.start == "cache"),
            "iterations": config.position_iterations,
            "factor": config.position_factor,
            "history": self.stats.history,
            **solver_scalars(config),
        }
        for group in (self.model, self.state, self.joints, *self.storage.groups()):
            self.values.update({name: group.array(name) for name in group.table})
        self._advance = ["displace", "commit"]
        if config.position_correction == "ngs" and config.position_iterations:
            self._advance.insert(1, "correct_positions")
        self._commands.clear()
        self._solves.clear()

    def _launches(self, phase: str) -> list[Launch]:
        """A phase, or the whole "step", as one call for each shard; recorded when first wanted."""
        if phase not in self._commands:
            self._commands[phase] = [self._record(phase, *shard) for shard in self._shards]
        return self._commands[phase]

    def _phase_launches(
        self, phase: str, first: int, count: int, changed: Mapping[str, Any] | None = None
    ) -> list[Launch]:
        if phase == "solve":
            return SCHEDULES[self.schedule](self, first, count, changed or {})
        names = _COLLIDE if phase == "collide" else self._advance
        return [self.bind(name, first, count) for name in names]

    def _record(self, phase: str, first: int, count: int, changed: Mapping[str, Any] | None = None) -> Launch:
        """One call for several launches: on a CPU a graph, with which a world's step takes 61 us instead of 142."""
        phases = ("collide", "solve", "advance") if phase == "step" else (phase,)
        launches = [launch for name in phases for launch in self._phase_launches(name, first, count, changed)]
        driven = self.schedule != "world" and "solve" in phases  # by the host, from values
        return in_turn(launches) if driven else recorded(launches, self.backend, self.device)

    def bind(self, name: str, first: int, count: int, changed: Mapping[str, Any] | None = None) -> Launch:
        """A launch of a kernel over the worlds first .. first + count, one thread each; with ``changed`` arguments."""
        # empty lanes write zeros to a padding body: one for each shard, or threads would share its cache line
        shard = next((i for i, (a, n) in enumerate(self._shards) if a <= first < a + n), 0)
        padding = self.model.body_count + PADDING * shard
        values = {**self.values, **(changed or {}), "world_offset": first, "padding_body": padding}
        width = self.storage.history_width
        values["history_offset"] = width * (shard if self._one_by_one else first)
        values["history_step"] = 0 if self._one_by_one else width
        return bind(self.kernels[name], count, values, self.device)

    @property
    def config(self) -> SolverConfig:
        """Settings of the solver; replace it with ``dataclasses.replace``."""
        return self._config

    @config.setter
    def config(self, config: SolverConfig) -> None:
        before = self._config
        if config == before:
            return
        self._config = config
        self.storage.adapt(config, before)
        self._bind_all()
        if self._phase != "advance":
            # rows depend on the settings too: those of the step in flight are made anew
            for shard in self._shards:
                self.bind("pack_rows", *shard)()

    # ------------------------------------------------------------------ stepping

    def warmup(self) -> None:
        """Compile and record everything now, which the first step would do otherwise (seconds, if not in the cache)."""
        for phase in ("collide", "solve", "advance", "step"):
            self._launches(phase)

    def step(self, dt: float, start: Start | None = None) -> None:
        """One time step of dt [s] in every world.

        Args:
            dt: time step, > 0 [s].
            start: called between ``collide`` and ``solve``; writes start impulses to ``contacts.impulse``.

        Raises:
            ValueError: dt not finite and positive, or a start impulse not finite.
            OverflowError: capacity exceeded with on_overflow="raise"; the state is that of the step before.
        """
        self.run(1, dt, start)

    def run(
        self, steps: int, dt: float, start: Start | None = None, callback: Callable[[Simulation], None] | None = None
    ) -> None:
        """Many time steps; without ``start`` and ``callback`` each thread runs its worlds through all of them at once.

        Args:
            steps: number of steps.
            dt: time step, > 0 [s].
            start: see ``step``.
            callback: called after each step.

        Raises:
            ValueError, OverflowError: see ``step``.
        """
        if steps < 0:
            raise ValueError(f"steps is {steps}; it must not be negative")
        self._set_dt(dt)
        if start is None and callback is None:
            self._run_shards(steps)
            return
        for _ in range(steps):
            if start is None:
                self._run_shards(1)
            else:
                self.collide(dt)
                start(self)
                self.storage.check_start()
                self.solve()
                self.advance()
            if callback is not None:
                callback(self)

    def collide(self, dt: float) -> None:
        """Predict velocities and find the contacts of the step; their impulses hold the start of the solve.

        Raises:
            ValueError, OverflowError: see ``step``.
        """
        self._set_dt(dt)
        self._collide()

    def solve(self, config: SolverConfig | None = None, *, pause: int | None = None) -> None:
        """Solve from ``contacts.impulse`` and the predicted velocities; the impulses then hold the solution.

        Args:
            config: settings of this one solve, which may differ from the simulation's in those of the iteration
                (``solver.ITERATION``); None: the simulation's.
            pause: stop after about so many sweeps in each world, 0 before the first, with ``resume`` to go on; with
                acceleration "aitken", which a solve that pauses takes for "adaptive", at the end of a period. Impulses,
                ``motion.solved`` and ``stats`` are then those of a solve in flight; ``running`` tells which worlds have
                not finished.

        Raises:
            ValueError: out of turn, or for another setting or a pause out of range.
        """
        if self._phase == "advance":
            raise ValueError("solve() needs collide(dt) first: the contacts are those of a finished step")
        self._solve(config, pause, resume=False)

    def resume(self, config: SolverConfig | None = None, *, pause: int | None = None) -> None:
        """Go on with a solve that paused: worlds that finished are left alone.

        Where ``stats.replaced`` is 1 a world goes on from ``contacts.impulse``, which may have been changed; the others
        end with the bits of a solve that never paused.

        Args:
            config: as in ``solve``; that of the solve in flight.
            pause: sweeps until the next pause; None: to the end.

        Raises:
            ValueError: see ``solve``.
        """
        if self._phase != "solve":
            raise ValueError("resume() needs solve(pause=...) first: no solve is in flight")
        self._solve(config, pause, resume=True)

    @property
    def running(self) -> np.ndarray:
        """Worlds whose solve is paused, bool (W,)."""
        done = self.stats.numpy("counters").reshape(-1, COUNTERS)[:, 3] != 0
        return ~done & (self.state.numpy("flags") == 0)

    def _solve(self, config: SolverConfig | None, pause: int | None, resume: bool) -> None:
        if pause is not None or resume:
            if self.schedule != "world":
                raise ValueError(f"schedule is {self.schedule!r}; only 'world' can pause a solve")
            if pause is not None and not 0 <= pause < NEVER:
                raise ValueError(f"pause is {pause}; it must lie in [0, {NEVER})")
        if config is None and pause is None and not resume:
            self._launch("solve")
        else:
            key = (config, pause, resume)
            if key not in self._solves:
                if config is not None:
                    check_iteration(config, self._config)
                    if self.storage.provide(config):
                        self._bind_all()
                changed = solver_scalars(config or self._config)
                if (pause is not None or resume) and changed["acceleration"] == ACCELERATIONS["adaptive"]:
                    changed["acceleration"] = ACCELERATIONS["aitken"]  # what a stretch remembers outlives no launch
                changed.update(resume=int(resume), pause=NEVER if pause is None else pause)
                self._solves[key] = [self._record("solve", *shard, changed) for shard in self._shards]
            self._run_launches(self._solves[key])
        self._phase = "solve"

    def advance(self) -> None:
        """Commit the step: velocities, positions, their correction, time, and the contact cache."""
        if self._phase != "solve":
            raise ValueError("advance() needs solve() first: there are no solved velocities")
        self._launch("advance")
        self._phase = "advance"

    def _set_dt(self, dt: float) -> None:
        value = float(dt)
        if not (0.0 < value < float("inf")):
            raise ValueError(f"dt is {dt!r}; it must be finite and > 0 [s]")
        if self.dtype.type(value) == 0:
            raise ValueError(f"dt is {dt!r}; it underflows {self.dtype.name}")
        target = self.motion.numpy("step_dt")
        target[...] = value
        if self.device != "cpu":
            self.motion.assign("step_dt", target)

    def _collide(self) -> None:
        self._launch("collide")
        while self._overflowed():
            self._grow()
            self._launch("collide")
        self._note_peak()
        self._phase = "collide"

    def _launch(self, phase: str) -> None:
        self._run_launches(self._launches(phase))

    def _run_launches(self, shards: list[Launch]) -> None:
        if self._pool is None:
            shards[0]()
        else:
            list(self._pool.map(lambda launch: launch(), shards))

    def _run_shards(self, steps: int) -> None:
        """All steps of every shard; a shard stops at an overflow, which is mended before it goes on."""
        if self.device != "cpu" or self.on_overflow == "raise":
            for _ in range(steps):
                self._collide()  # all worlds, so that none has moved if one raises
                self._launch("solve")
                self._launch("advance")
            self._phase = "advance"
            return
        self._left = [steps] * len(self._shards)
        while any(self._left):
            self._halt = False
            self._launches("step")  # before the threads ask for it
            if self._pool is None:
                for shard, left in enumerate(self._left):
                    self._left[shard] -= self._run_shard(shard, left)
            else:
                workers = [self._pool.submit(self._work) for _ in range(self.threads)]
                try:
                    for worker in workers:
                        worker.result()
                except BaseException:
                    # an interrupt: threads end their step, and none is left at work when the caller goes on; worlds may
                    # have come to different times
                    self._halt = True
                    wait(workers)
                    raise
            behind = np.flatnonzero(self.state.numpy("flags") & int(CAPACITY_FLAGS))
            if len(behind):
                self._grow()
            for w in behind:
                self._repeat(int(w))
        self._note_peak()
        self._phase = "advance"

    def _repeat(self, w: int) -> None:
        """The step of a world that ran out of room, and so stayed behind the others."""
        in_turn(self._phase_launches("collide", w, 1))()
        while self._overflowed():
            self._grow()
            in_turn(self._phase_launches("collide", w, 1))()
        in_turn([*self._phase_launches("solve", w, 1), *self._phase_launches("advance", w, 1)])()

    def _work(self) -> None:
        """Run chunks of the shard that is farthest behind and free, until none is left or room is needed."""
        while not self._halt:
            with self._lock:
                free = [i for i, n in enumerate(self._left) if n and i not in self._busy]
                if not free:
                    return
                shard = max(free, key=lambda i: self._left[i])
                self._busy.add(shard)
            done = 0
            try:
                done = self._run_shard(shard, min(self._left[shard], CHUNK))
            finally:
                with self._lock:
                    self._left[shard] -= done
                    self._busy.discard(shard)

    def _run_shard(self, shard: int, steps: int) -> int:
        """Steps taken until some world ran out of room; worlds that did not have taken the last one too."""
        step = self._launches("step")[shard]
        first, count = self._shards[shard]
        flags = self.state.numpy("flags")[first : first + count]
        for done in range(steps):
            if self._halt:  # another shard waits for room
                return done
            step()
            if (flags & int(CAPACITY_FLAGS)).any():
                self._halt = True
                return done + 1
        return steps

    # ------------------------------------------------------------------ capacity

    def _overflowed(self) -> bool:
        return bool((self.state.numpy("flags") & int(CAPACITY_FLAGS)).any())

    def _grow(self) -> None:
        """More room for the worlds that ran out of it; their step is then repeated from ``collide``."""
        flags = self.state.numpy("flags").copy()
        self.state.assign("flags", flags & ~int(CAPACITY_FLAGS))
        self._phase = "advance"
        self.storage.grow(flags, self._config, error=self.on_overflow == "raise")
        self._bind_all()

    def restore_contacts(self, count: np.ndarray, arrays: Mapping[str, np.ndarray], contact_dt: np.ndarray) -> None:
        """Put contacts of an earlier run into the cache that the next step starts from.

        Args:
            count: contacts of each world, (W,).
            arrays: fields of ``model.fields.CONTACTS`` by name, the worlds' contacts one after the other, sorted by
                key; key, impulse, color and age are needed.
            contact_dt: time step of the impulses, (W,) [s].

        Raises:
            ValueError: naming a missing field or a wrong shape.
        """
        self.storage.restore(count, arrays, contact_dt, self._config)
        self._phase = "advance"
        self._bind_all()

    def _note_peak(self) -> None:
        if self.device != "cpu":
            return
        for name, counts in self.storage.used().items():
            self._peak[name] = max(self._peak[name], int(counts.max(initial=0)))

    # ------------------------------------------------------------------ reports

    def capacity(self) -> dict[str, dict[str, int]]:
        """Pairs, contacts and blocks of rows: reserved in all worlds, used now, and the most one world used."""
        used, room = self.storage.used(), self.storage.reserved()
        return {
            name: {"reserved": int(room[name].sum()), "used": int(used[name].sum()), "peak_of_a_world": peak}
            for name, peak in self._peak.items()
        }

    def memory(self) -> dict[str, int]:
        """Bytes allocated: by what they grow with (bodies with their shapes and pairs, contacts with their rows)."""
        total = {"body_bytes": 0, "contact_bytes": 0, "joint_bytes": 0}
        owner = {"contact": "contact_bytes", "joint": "joint_bytes"}
        for group in (self.model, self.state, self.joints, *self.storage.groups()):
            for axis, size in group.nbytes_by_axis().items():
                key = "contact_bytes" if axis.startswith("row") else owner.get(axis, "body_bytes")
                total[key] += size
        return total

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a snapshot to continue from, bit for bit (see ``snapshot.save``)."""
        from dc_kernels.snapshot import save

        save(self, path)

    @classmethod
    def load(cls, path: str | os.PathLike[str], **options: Any) -> Simulation:
        """A simulation from a snapshot; options as for the constructor (see ``snapshot.load``)."""
        from dc_kernels.snapshot import load

        return load(path, **options)

    def explain(self) -> str:
        """What runs for this scene, what is skipped, and why."""
        from dc_kernels.explain import explain

        return explain(self)
