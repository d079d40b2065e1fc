"""Phases and steps of all worlds: when launches are bound, what an overflow or an interrupt leaves to be done."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from dc_kernels.model.arrays import State
from dc_kernels.model.config import SolverConfig
from dc_kernels.model.enums import CAPACITY_FLAGS
from dc_kernels.runtime.backends import Launch
from dc_kernels.runtime.capture import recording
from dc_kernels.runtime.sequences import Rounds, Watch
from dc_kernels.runtime.stepping import Shards
from dc_kernels.runtime.threads import uninterrupted
from dc_kernels.stages import PHASES, Phase, Turn
from dc_kernels.storage import Storage


class Phases:
    """The part of a simulation that takes its worlds through phases and steps, together whatever happens.

    An interrupt arrives when a phase, or a step, has ended in all worlds or in none; only where Python makes the
    launches (the backend numpy, schedule "color") it may fall into one. It is not kept waiting: where the phase or step
    takes longer than ``stepping.GRACE`` from then on, solves and position corrections end after the sweep that they are
    in, as if it were the last that ``max_sweeps`` or ``position_iterations`` allow, and worlds cut short are not
    ``finished`` in ``stats.iteration``. A solve called by itself that is cut short does not count as ``phase``.
    """

    state: State
    storage: Storage
    device: str
    on_overflow: str
    _config: SolverConfig
    _shards: Shards
    _turn: Turn
    _rounds: dict[str, list[Rounds]]
    _watch: Watch
    _flags: np.ndarray

    def _bind_all(self) -> None:
        """Take arrays and settings anew."""
        raise NotImplementedError

    def _phase_launches(
        self, phase: Phase, first: int, count: int, changed: Mapping[str, Any] | None = None
    ) -> list[Launch]:
        """Launches of a phase over worlds from ``first`` on."""
        raise NotImplementedError

    def bind(self, name: str, first: int, count: int, changed: Mapping[str, Any] | None = None) -> Launch:
        """A launch of a kernel over the worlds first .. first + count, one thread each; with ``changed`` arguments."""
        raise NotImplementedError

    def _phase_rounds(self, phase: Any) -> list[Rounds]:
        """A phase, or the whole "step", over each shard; bound when first wanted."""
        if phase not in self._rounds:
            phases: tuple[Phase, ...] = PHASES if phase == "step" else (phase,)
            # a whole step that runs out of room halts all shards; else all should say what they need
            self._rounds[phase] = self._bind_rounds(phases, together=phase == "step")
        return self._rounds[phase]

    def _bind_rounds(
        self, phases: tuple[Phase, ...], changed: Mapping[str, Any] | None = None, together: bool = False
    ) -> list[Rounds]:
        def bind(first: int, count: int) -> list[Launch]:
            parts = [self._phase_launches(phase, first, count, changed) for phase in phases]
            if self._config.sleep:  # a step enters and leaves its worlds once
                parts = [part[k > 0 : len(part) - (k + 1 < len(parts))] for k, part in enumerate(parts)]
            return [launch for part in parts for launch in part]

        # only collide runs out of room; to look costs a GPU copies for which the host waits
        watch = self._watch if "collide" in phases else self._watch._replace(stop_at=0, used=())
        if not together:
            watch = watch._replace(clock=())
        sweeps = 0
        if "solve" in phases:
            sweeps = (changed or {}).get("max_sweeps", self._config.max_sweeps)
        if "advance" in phases and self._config.corrects_positions:
            sweeps = max(sweeps, self._config.position_iterations)
        once = int(self._config.sleep and phases[0] == "collide")  # what a user wrote is looked for once in a call
        return self._shards.rounds(bind, watch, together, sweeps=sweeps, once=once)

    def _take(self, phase: Phase, rounds: list[Rounds] | None = None) -> bool:
        """Run a phase in all worlds, or record it; whether one ran out of room."""
        rounds = rounds or self._phase_rounds(phase)
        try:
            if self._shards.run(rounds, 1):
                return True
        finally:
            shards = self._shards
            if not (shards.halted or any(shards.left) or (shards.disturbed and shards.cut_flag[0])):
                self._turn.ran = phase
        if recording():
            self._turn.recorded = phase
        return False

    def _collide(self) -> None:
        while self._take("collide"):
            self._grow()

    def _run_steps(self, steps: int) -> None:
        """All steps of every shard; a shard stops at an overflow, which is mended before it goes on."""
        rounds = self._phase_rounds("step")
        if recording():
            self._shards.run(rounds, steps)
            self._turn.recorded = "advance"
            return
        if self.device != "cpu" or self.on_overflow == "raise":
            for _ in range(steps):
                self._collide()  # all worlds, so that none has moved if one raises
                self._take("solve")
                self._take("advance")
            return
        self._turn.ran = "advance"
        left: int | list[int] = steps
        try:
            while self._shards.run(rounds, left):
                left = self._shards.left
                self._mend()
                rounds = self._phase_rounds("step")
        except BaseException:
            with uninterrupted():
                self._mend()
                while self._shards.level(self._phase_rounds("step")):
                    self._mend()
            raise

    def cut_short(self) -> None:
        """Let a step or phase that another thread is in end soon: each sweep is the last, as after an interrupt.

        For a program that gives up what its threads compute: they cannot be interrupted. Nothing is done where no call
        is under way, and what comes after that call is not cut short.
        """
        self._shards.cut_short()

    def _mend(self) -> None:
        """Make room for worlds that ran out of it, and take the step that they stayed behind with."""
        with uninterrupted():
            while len(behind := np.flatnonzero(self._flags & int(CAPACITY_FLAGS))):
                self._grow()
                for run in np.split(behind, np.flatnonzero(np.diff(behind) > 1) + 1):
                    first, count = int(run[0]), len(run)
                    launches = [one for phase in PHASES for one in self._phase_launches(phase, first, count)]
                    self._shards.once(launches, first, count, self._watch)

    def _grow(self) -> None:
        """More room for the worlds that ran out of it; their step is then repeated from ``collide``."""
        with uninterrupted():
            flags = self.state.numpy("flags").copy()
            self.state.assign("flags", flags & ~int(CAPACITY_FLAGS))
            self._turn.ran = "advance"
            self.storage.grow(flags, self._config, error=self.on_overflow == "raise")
            self._bind_all()
