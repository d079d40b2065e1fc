"""Shards of worlds by backend: those that the backend's own threads take through whole steps, or those of the host."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from dc_kernels.model.dtypes import aligned_zeros
from dc_kernels.runtime import stepping
from dc_kernels.runtime.backends import BACKENDS, Launch, kernel_file
from dc_kernels.runtime.capture import recording
from dc_kernels.runtime.sequences import CACHE_LINE, PoolRounds, Rounds, Watch
from dc_kernels.runtime.stepping import INT, Shards
from dc_kernels.runtime.threads import uninterrupted


class PoolShards(Shards):
    """Shards that the backend's own threads take through whole steps, and all worlds as one for single phases."""

    def __init__(self, worlds: int, bodies: int, threads: int, backend: str) -> None:
        """Divide so many worlds with so many bodies in all."""
        super().__init__(worlds, bodies, 1)
        self.over_worlds = threads
        self._parallel, self._backend = threads > 1, backend
        self._signals = kernel_file(backend, "runtime.signals")
        self.cut_flag = aligned_zeros((self._signals.WORDS,), INT)  # with what tells a launch of an interrupt
        count = min(stepping.SHARDS_PER_THREAD * threads, worlds) if self._parallel else 1
        self._starts = np.linspace(0, worlds, count + 1).astype(INT)
        self.peak = aligned_zeros((count + 1, CACHE_LINE), INT)
        self.parts = max(count, threads)
        self._goal: list[int] = []

    def rounds(
        self,
        bind: Callable[[int, int], Sequence[Launch]],
        watch: Watch,
        together: bool,
        *,
        sweeps: int = 0,
        once: int = 0,
    ) -> list[Rounds]:
        """Rounds of all worlds: those of a whole step as one kernel."""
        launches = bind(*self.ranges[0])
        if together and all(hasattr(launch, "prepare") for launch in launches):
            return [self._whole(launches, self._starts, watch, self.peak[:-1], sweeps)]
        for launch in launches:
            getattr(launch, "prepare", bool)()
        return super().rounds(lambda *_: launches, watch, together, sweeps=sweeps, once=once)

    def run(self, rounds: Sequence[Rounds], count: int | Sequence[int]) -> bool:
        """Take rounds until none is left or one halts (see ``Shards.run``)."""
        if self.bodies * rounds[0].sweeps <= stepping.SWEPT or recording():
            return self._take_all(rounds, count)
        try:
            with self._signals.signals_in(self.cut_flag, round(stepping.GRACE * stepping.ROWS_PER_SECOND)):
                return self._take_all(rounds, count)
        finally:
            self.disturbed |= bool(self.cut_flag[0])

    def _take_all(self, rounds: Sequence[Rounds], count: int | Sequence[int]) -> bool:
        """Take rounds until none is left or one halts."""
        only = rounds[0]
        if not isinstance(only, PoolRounds) or recording():
            return super().run(rounds, count)
        self.halted = False
        self._begin(only, [count] * only.parts if isinstance(count, int) else list(count))
        self._calm()
        try:
            self._take_to(only, 0)
        except BaseException:
            with uninterrupted():
                self._settle(only)
                if not self.halted:
                    self.level(rounds)
            raise
        return self.halted

    def once(self, launches: Sequence[Launch], first: int, count: int, watch: Watch) -> None:
        """Take one round over some of the worlds."""
        self._whole(launches, np.array([0, count]), watch, self.peak[-1:], 0).take_each([1])

    def _whole(
        self, launches: Sequence[Launch], starts: np.ndarray, watch: Watch, peak: np.ndarray, sweeps: int
    ) -> PoolRounds:
        """Rounds of shards that begin at these worlds, as one kernel."""
        backend, parallel = self._backend, self._parallel
        return PoolRounds(launches, starts, watch, peak, backend=backend, parallel=parallel, sweeps=sweeps)

    def level(self, rounds: Sequence[Rounds]) -> bool:
        """Take rounds until each shard has as few ``left`` as any, or one halts; whether one did."""
        only = rounds[0]
        if not isinstance(only, PoolRounds):
            return super().level(rounds)
        self._stop = self.halted = False
        self._begin(only, self.left)
        self._take_to(only, min(self.left))
        return self.halted

    def _begin(self, only: PoolRounds, left: list[int]) -> None:
        only.halt[:] = 0
        self.left = left
        self._goal = [n + t for n, t in zip(left, only.taken.tolist())]

    def _take_to(self, only: PoolRounds, least: int) -> None:
        """Take rounds until so few are left of each shard, as long as none halts and no interrupt arrives."""
        at_once = self._at_once(only)
        while max(self.left) > least and not (self.halted or self._stop):
            only.take_each([min(n - least, at_once) for n in self.left])
            self._settle(only)

    def _settle(self, only: PoolRounds) -> None:
        """Count what was taken, however often this is called."""
        self.left = [goal - t for goal, t in zip(self._goal, only.taken.tolist())]
        self.halted = bool(only.halt.any())


def shards_of(backend: str, worlds: int, bodies: int, threads: int, *, teams: bool, tiles: bool = False) -> Shards:
    """Shards of so many worlds with so many bodies in all, as the threads of a backend take them.

    Args:
        backend: of the kernels.
        worlds: how many.
        bodies: in all.
        threads: at most so many are at work at once.
        teams: whether threads may share the loops of a world, where the backend can.
        tiles: whether a few small worlds may be taken through several rounds before the others.
    """
    if BACKENDS[backend].own_threads:
        return PoolShards(worlds, bodies, max(1, min(threads, worlds)), backend)
    hosted = not BACKENDS[backend].on_numpy
    return Shards(worlds, bodies, threads, teams=teams and BACKENDS[backend].teams, tiles=tiles and hosted)
