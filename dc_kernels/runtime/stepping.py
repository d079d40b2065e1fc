"""Shards of worlds that threads take through rounds of launches, each as far as it comes."""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Callable, Sequence

import numpy as np

from dc_kernels.model.dtypes import aligned_zeros
from dc_kernels.runtime.backends import Launch
from dc_kernels.runtime.capture import recording
from dc_kernels.runtime.sequences import CACHE_LINE, SEATS, Rounds, Teams, Watch, in_turn
from dc_kernels.runtime.threads import in_main_thread, run_apart, run_helped, run_together, uninterrupted, usable_cores

SHARDS_PER_THREAD = 2  # who is done first takes on what is left
# small worlds are taken through CHUNK rounds so many bodies at a time, which stay in the caches: 1 024 worlds of ten
TILE = 700  # boxes, 22 MB, take .8 of the time on one thread and .89 on two; larger worlds gain nothing
SMALL = 64  # bodies of a world
MOST_TILES = 300  # beyond, a round of all takes longer than LEVELED, and launches take long to bind
WORTH_TILES = 20  # rounds from which a shard's launches are worth binding: 1.5 ms each
LEVELED = 0.2  # that it may take to bring all shards as far as the one that is farthest, after an interrupt [s]
CHUNK = 10  # rounds that a thread takes of a shard at a time: 250 at once leaves one idle at the end for 3 %
AT_ONCE = 20_000  # bodies times rounds between two looks for an interrupt: 4 to 40 ms
LOOKED = 0.01  # between two looks, once it is known how long a round takes: a look costs 80 us, as caches are cold [s]
MORE = 5  # times so many rounds then at most
IDLE_AT_ONCE = 2_000_000  # worlds times rounds in which nothing is awake: 1 to 50 ms
SWEPT = 10_000_000  # bodies times sweeps between two looks, if no solve converges: 0.1 to 0.6 s
APART = 4  # looks that a shard may be ahead of another: what an interrupt leaves to be leveled takes that long
GRACE = 0.5  # that an interrupted round has to end by itself, before its sweeps are cut short [s]
ROWS_PER_SECOND = 100_000_000  # that a thread sweeps at least, for ``GRACE`` where a launch has no clock
WORTH_THREADS = 1_000  # bodies times rounds from which a second thread gains: to hand work over takes 80 us
WORTH_HELP = 2_000  # bodies of a shard, with fewer worlds than threads, from which a second thread gains within one
INT = np.dtype(np.int32)


class Shards:
    """Worlds in shards, and what each has still to do.

    Attributes:
        threads: at most so many take shards at once.
        ranges: first world and number of worlds of each shard.
        parts: parts of the worlds that may be at work at once, each with a padding body of its own.
        peak: the most that a world used of each kind of room, an int32 for each kind in the row of a shard, or of all.
        left: rounds that each shard has still to take.
        halted: whether one of the rounds taken last halted.
        disturbed: whether the rounds taken last were interrupted or cut short.
        cut_flag: an int32 that kernels look at after each sweep: not 0 once an interrupt has cut sweeps short.
        idle: tells whether no world does anything until something is written to it; None: each may.
        over_worlds: threads that share the worlds, whether those of the host or the backend's own.
        helpers: threads beyond one a world, which share the loops of kernels within worlds.
        teams: address of the team of each shard, for the kernels of its worlds; 0 without helpers.
    """

    def __init__(self, worlds: int, bodies: int, threads: int, *, teams: bool = False, tiles: bool = False) -> None:
        """Divide so many worlds with so many bodies in all.

        Args:
            worlds: how many.
            bodies: in all.
            threads: at most so many are at work at once.
            teams: whether the kernels share their loops among threads, where these are more than the worlds.
            tiles: whether a few small worlds may be taken through several rounds before the others.
        """
        self.threads = self.over_worlds = max(1, min(threads, worlds))
        self.helpers = 0
        count = 1 if self.threads == 1 else SHARDS_PER_THREAD * self.threads
        if tiles and bodies <= min(SMALL * worlds, MOST_TILES * TILE):
            count = max(count, bodies // TILE)
        count = min(count, max(worlds, 1))
        edges = np.linspace(0, worlds, count + 1).astype(int) if count > 1 else (0, worlds)
        self.ranges = [(int(a), int(b - a)) for a, b in itertools.pairwise(edges)]
        self.parts = count
        self.bodies, self._worlds = max(bodies, 1), max(worlds, 1)
        self.peak = aligned_zeros((count + 1, CACHE_LINE), INT)
        self.left = [0] * count
        self.halted = False
        self.cut_flag = aligned_zeros((CACHE_LINE,), INT)
        self._turn = threading.Condition()
        self._busy: set[int] = set()
        self._stop = self._apart = False
        self.disturbed = False
        self.idle: Callable[[], bool] | None = None
        self._timer: threading.Timer | None = None
        self._teams: Teams | None = None
        if teams and self.threads == worlds and bodies >= WORTH_HELP * worlds:
            self.helpers = max(0, min(threads, usable_cores(), SEATS) - self.threads)
        if self.helpers:
            self._teams = Teams(count, self.helpers + 1)
        self.teams = [0] * count if self._teams is None else self._teams.addresses

    def _at_once(self, rounds: Rounds, spent: float | None = None) -> int:
        """Count the rounds between two looks for an interrupt, where those before took ``spent`` each, if known [s]."""
        bodies = max(self.bodies * rounds.worlds // self._worlds, 1)
        swept = SWEPT // max(rounds.sweeps, 1)
        if spent is None:
            return max(min(AT_ONCE, swept) // bodies, 1)
        # an interrupt cuts short the sweeps of a thread apart
        most = MORE * AT_ONCE if self._apart else min(MORE * AT_ONCE, swept)
        return max(min(most // bodies, int(LOOKED / max(spent, 1e-9))), 1)

    def rounds(
        self,
        bind: Callable[[int, int], Sequence[Launch]],
        watch: Watch,
        together: bool,
        *,
        sweeps: int = 0,
        once: int = 0,
    ) -> list[Rounds]:
        """Rounds of each shard, and if there are several of all shards as one.

        Args:
            bind: launches of a round over so many worlds from a first one.
            watch: what is looked at after each round.
            together: whether a shard that halts halts the others too.
            sweeps: over all bodies, that a round may make.
            once: launches at the beginning of ``bind``'s that only the first of the rounds taken in one call makes.
        """
        shared = aligned_zeros((CACHE_LINE,), INT)

        def rounds_of(first: int, count: int, peak: np.ndarray, halt: np.ndarray) -> Rounds:
            return Rounds(bind, first, count, watch, peak, halt, sweeps=sweeps, once=once)

        found = [
            rounds_of(*shard, peak, shared if together else aligned_zeros((CACHE_LINE,), INT))
            for shard, peak in zip(self.ranges, self.peak)
        ]
        if len(found) > 1:
            found.append(rounds_of(0, self._worlds, self.peak[-1], shared))
        found[-1].bind()  # an interrupt while kernels are compiled ends no round
        return found

    def run(self, rounds: Sequence[Rounds], count: int | Sequence[int]) -> bool:
        """Take rounds until none is left or one halts; whether one did, with ``left`` still to be taken.

        Args:
            rounds: as ``rounds`` gives them.
            count: rounds to take: of all shards, or of each.

        Raises:
            BaseException: an interrupt, when no thread is at work any more; compiled rounds are then taken on until
                each shard has come as far as that which came farthest, unless one has halted. Where that would take
                longer than ``GRACE``, sweeps end early: then ``cut_flag`` is set.
        """
        whole, recorded = rounds[-1], recording()
        if count == 1 and not recorded and (only := self.brief(rounds)) is not None:
            return self.run_once(only)
        self.left = [count] * len(self.ranges) if isinstance(count, int) else list(count)
        longest = max(self.left)
        self.halted = False
        if not longest:
            return False
        if recorded:
            whole.record(longest)
            return False
        for one in rounds:
            one.halt[0] = 0
        self._calm()
        try:
            tiled = self.threads == 1 < len(self.ranges) and longest > 1 and not self._is_idle()
            ahead = CHUNK if tiled else 1  # of a shard to the next
            self._apart = self.bodies * whole.sweeps * ahead > SWEPT and whole.compiled and in_main_thread()
            # to start a thread takes longer than an idle step
            if self._apart and not (longest == 1 and self._is_idle()):
                run_apart(lambda: self._run(rounds, longest), self._interrupt)
            else:
                self._run(rounds, longest)
        except BaseException:
            self._interrupted(rounds)
            raise
        return self.halted

    def _is_idle(self) -> bool:
        return self.idle is not None and self.idle()

    def once(self, launches: Sequence[Launch], first: int, count: int, watch: Watch) -> None:
        """Take one round over so many worlds from a first one, as their launches and ``watch`` say."""
        in_turn(launches)()

    def _calm(self) -> None:
        """Forget an interrupt of rounds before."""
        if self.disturbed:
            if self._timer is not None:
                self._timer.cancel()
                self._timer.join()
            self.disturbed, self._stop, self._timer, self.cut_flag[0] = False, False, None, 0

    def brief(self, rounds: Sequence[Rounds]) -> Rounds | None:
        """Rounds of which ``run_once`` takes one: of one shard, and so short that no interrupt waits; else None."""
        alone = len(rounds) == 1 and not (self.helpers or self.disturbed)
        return rounds[0] if alone and self.bodies * rounds[0].sweeps <= SWEPT else None

    def run_once(self, only: Rounds) -> bool:
        """Do what ``run`` does with one round of ``brief``, outside of recordings; whether it halts.

        In small worlds all else that ``run`` does takes longer.
        """
        left = self.left = [1]
        self.halted = False
        try:
            self.halted = only.take_one()
            left[0] -= only.count()
        except BaseException:
            self._interrupted([only])
            raise
        return self.halted

    def _interrupted(self, rounds: Sequence[Rounds]) -> None:
        """Count what was taken before an interrupt, and level the shards unless one has halted."""
        with uninterrupted():
            taken = rounds[-1].count()
            self.left = [left - taken - shard.count() for left, shard in zip(self.left, rounds)]
            self.halted = any(one.halt[0] for one in rounds)
            if not self.halted:
                self.level(rounds)

    def cut_short(self) -> None:
        """Let what another thread has under way end after the sweep that it is in."""
        self.disturbed = True
        self.cut_flag[0] = 1

    def _interrupt(self, ended: threading.Event) -> None:
        """Wait for what is under way; what takes longer than ``GRACE`` from now on, leveling too, sweeps no more."""
        with uninterrupted():
            self._stop = self.disturbed = True
            self._timer = threading.Timer(GRACE, self.cut_flag.__setitem__, (0, 1))
            self._timer.daemon = True
            self._timer.start()
            ended.wait()

    def _run(self, rounds: Sequence[Rounds], longest: int) -> None:
        """Take the rounds ``left``, of which ``longest`` is the most, with helpers where they gain anything."""
        teams = self._teams
        if teams is None:
            self._take_rounds(rounds, longest)
            return
        trial, begun = rounds[-1].helped, time.perf_counter()
        many = len(rounds) == 1 and longest > 1  # helpers that have come are tried between rounds
        if many or trial.other:
            teams.begin()
            teams.open_jobs(True)
            run_helped(lambda: self._take_rounds(rounds, longest, teams), teams.serve, self.helpers, teams.end)
            teams.balance()
        else:
            teams.open_jobs(False)
            self._take_rounds(rounds, longest)
        if not many:
            trial.took((time.perf_counter() - begun) / longest)

    def _take_rounds(self, rounds: Sequence[Rounds], longest: int, teams: Teams | None = None) -> None:
        shards, whole = rounds[: len(self.ranges)], rounds[-1]
        whole.wanted += longest
        shared, idle = self._is_shared(whole, longest), self._is_idle()
        if shared and not idle:
            self._share(shards, whole)
        elif longest == min(self.left):
            # the first round sees what was written between two calls, and may wake some: it takes 100 ns a world
            at_once, n = 1 if longest == 1 or shared else self._at_once(whole), len(self.left)
            tried = teams if longest > 1 and len(rounds) == 1 else None
            while longest and not (whole.halt[0] or self._stop):
                begun = time.perf_counter()
                if tried is not None:
                    tried.open_jobs(whole.helped.other)
                whole.take(min(longest, at_once))
                done = whole.count()
                longest -= done
                spent = (time.perf_counter() - begun) / max(done, 1)
                if tried is not None:
                    whole.helped.took(spent)
                    tried.balance()
                at_once = self._at_once(whole, spent)
                self.left = [longest] * n
                if self._is_idle():
                    at_once = max(at_once, IDLE_AT_ONCE // self._worlds)
                elif shared and longest and not (whole.halt[0] or self._stop):
                    self._share(shards, whole)
                    self.halted = any(shard.halt[0] for shard in shards)
                    return
            self.halted = bool(whole.halt[0])
            return
        else:
            for i in range(len(shards)):
                self._take_one(rounds, i, 0)
        self.halted = any(shard.halt[0] for shard in shards)

    def _is_shared(self, whole: Rounds, longest: int) -> bool:
        """Whether so many rounds of worlds that are awake gain by threads, or by tiles."""
        tiled = len(self.ranges) > 1 and longest > 1 and whole.wanted >= WORTH_TILES
        return (self.threads > 1 or tiled) and self.bodies * longest >= WORTH_THREADS

    def level(self, rounds: Sequence[Rounds]) -> bool:
        """Take compiled rounds until each shard has as few ``left`` as any, or one halts; whether one did."""
        if not all(one.compiled for one in rounds):
            return False
        self._stop = False
        for one in rounds:
            one.halt[0] = 0
        ahead = min(self.left)
        for i in range(len(self.ranges)):
            self._take_one(rounds, i, ahead)
        self.halted = any(one.halt[0] for one in rounds)
        return self.halted

    def _take_one(self, rounds: Sequence[Rounds], i: int, least: int) -> None:
        """Take rounds of a shard until so few are left, as long as it doesn't halt and no interrupt arrives."""
        while self.left[i] > least and not (rounds[i].halt[0] or self._stop):
            rounds[i].take(min(self.left[i] - least, self._at_once(rounds[i])))
            self.left[i] -= rounds[i].count()

    def _share(self, shards: Sequence[Rounds], whole: Rounds) -> None:
        """All threads take chunks of shards, whichever is farthest behind."""
        self._busy.clear()
        for one in shards:
            one.bind()  # here, by one thread
        at_once = min(CHUNK, self._at_once(shards[0]))
        spent = [LEVELED] * len(shards)  # by a round of each, as far as is known [s]
        apart = max(APART * self._at_once(whole), at_once)
        seen = [False] * len(shards)  # whether a shard has looked for what was written between two calls

        def stop() -> None:
            self._stop = self.disturbed = True
            with self._turn:
                self._turn.notify_all()

        def work() -> None:
            try:
                while (i := self._next(shards, apart)) is not None:
                    chunk = max(min(at_once, int(LEVELED / sum(spent))), 1)
                    if seen[i] and self._is_idle():
                        chunk = max(chunk, IDLE_AT_ONCE // self._worlds)
                    chunk = min(self.left[i], chunk)
                    begun = time.perf_counter()
                    shards[i].take(chunk)
                    spent[i], seen[i] = (time.perf_counter() - begun) / chunk, True
                    with self._turn:
                        self.left[i] -= shards[i].count()
                        self._busy.discard(i)
                        self._turn.notify_all()
            except BaseException:
                stop()
                raise

        run_together(work, self.threads, stop)

    def _next(self, shards: Sequence[Rounds], apart: int) -> int | None:
        """Wait for the free shard that is farthest behind, if at most ``apart`` ahead; None if none is free."""
        with self._turn:
            while not self._stop:
                left = {i: n for i, n in enumerate(self.left) if n and not shards[i].halt[0]}
                free = [i for i in left if i not in self._busy]
                if not free:
                    return None
                i = max(free, key=left.__getitem__)
                if left[i] + apart >= max(left.values()):
                    self._busy.add(i)
                    return i
                self._turn.wait()  # for whom a thread is at work on
        return None
