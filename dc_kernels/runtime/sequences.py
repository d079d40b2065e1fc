"""Several launches as one call: on the CPU without Python between them, as one compiled loop over their addresses.

Warp's own graphs cost 0.7 us a launch more, and only one thread at a time may record one.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from dc_kernels.model.arrays import to_numpy
from dc_kernels.model.dtypes import aligned_zeros
from dc_kernels.model.enums import Activity
from dc_kernels.runtime.backends import Launch, bind, kernel_file, make_kernels
from dc_kernels.runtime.capture import recording
from dc_kernels.runtime.threads import Trial

SEATS = 64  # threads that may share one world
SPLITS = 4  # lines of a cache with a number for each colour
PLAN = 141  # lines of a cache for who sums up what
BEGINS = SEATS // 16  # lines of a cache for where the parts of threads begin
SEAT = 3  # lines of a cache for each thread
TEAM_BYTES = 64 * (3 + BEGINS + SEAT * SEATS + SPLITS + SPLITS * SEATS + PLAN)  # that hold a team
WHOLE = 65536  # of which each thread has a share
ENOUGH = 32  # phases that tell how fast threads are
LEARNED = 0.7  # exponent: what they tell is disturbed now and then
NEARLY = 1.03  # times the least that the longest spent, up to which they are left: what moves has to change caches
LEAST_SHARE = 4  # times that a thread may take less than as many each, or more
NAP = 50  # that a member who finds nothing sleeps between two looks [us]
PATIENCE = 200_000  # naps after which it leaves, even if nobody told it to
CACHE_LINE = 16  # int32: what threads write, each for itself, lies so far apart


def in_turn(launches: Sequence[Launch]) -> Launch:
    """One call that makes several."""

    def run() -> None:
        for launch in launches:
            launch()

    return run


def as_one(launches: Sequence[Launch]) -> Launch:
    """Launches as one call, of no cost beyond the kernels' where they are bound on Warp's CPU."""
    table = address_table(launches)
    if table is None:
        return in_turn(list(launches))
    return _Run(list(launches), table)


class Needing:
    """A launch that does nothing without some ``Activity`` of its worlds: compiled rounds leave it out then.

    Attributes:
        needs: bits of ``Activity``.
    """

    def __init__(self, launch: Launch, needs: int) -> None:
        """``needs``: bits of ``Activity``."""
        self._launch, self.needs = launch, int(needs)

    @property
    def addresses(self) -> tuple[int, int, int] | None:
        """Those of the launch."""
        return getattr(self._launch, "addresses", None)

    def __call__(self) -> None:
        """Launch, whatever it needs."""
        self._launch()


def address_table(launches: Sequence[Launch]) -> np.ndarray | None:
    """What ``_warp/runtime/sequences.py`` runs, (n, 4) uint64; None where some launch has no addresses."""
    rows: list[tuple[int, ...]] = []
    for launch in launches:
        addresses = getattr(launch, "addresses", None)
        if addresses is None:
            return None
        rows.append((*addresses, getattr(launch, "needs", 0)))
    return np.array(rows, np.uint64) if rows else None


def awake_table(table: np.ndarray, once: int) -> np.ndarray:
    """Of a table of addresses what is launched after the first ``once`` where nothing sleeps; it needs no look then."""
    rows = table[once:]
    rows = rows[rows[:, 3] & np.uint64(Activity.ASLEEP) == 0]
    rows[:, 3] &= np.uint64(Activity.RESTED)
    return rows


class _Run:
    """Bound launches, which it keeps alive, by their addresses."""

    def __init__(self, launches: list[Launch], table: np.ndarray) -> None:
        self.launches = launches
        values = {"launches": table, "count": len(launches), "sleep": np.zeros(0, np.uint64)}
        self._run = _bind("run_launches", values)

    def __call__(self) -> None:
        if recording():
            in_turn(self.launches)()
        else:
            self._run()


class Watch(NamedTuple):
    """What is looked at after each round: arrays of the backend with one int32 for each world."""

    flags: Any
    """Bits of each world."""
    stop_at: int
    """Bits that halt."""
    used: tuple[Any, ...]
    """How much of each kind of room a world uses."""
    sleep: tuple[Any, ...] = ()
    """``sleeping``, ``dormant`` and ``waited`` of sleepers, by which launches are left out; empty without sleep."""
    clock: tuple[Any, ...] = ()
    """Time and time step of each world, where nothing else goes on in rounds of whole steps in which nothing is awake
    but in the first; empty where something does."""

    @property
    def addresses(self) -> np.ndarray:
        """Those of ``sleep`` and ``clock``, as ``_warp/runtime/sequences.py`` takes them."""
        width = [self.clock[1].strides[0]] if self.clock else []
        return np.array([*(array.ptr for array in (*self.sleep, *self.clock)), *width], np.uint64)


class Rounds:
    """Rounds of launches over a shard of worlds, many in one call, until one halts; bound when first wanted.

    Attributes:
        halt: an int32, not 0 once a round has halted; several shards may share it.
        worlds: number of worlds in the shard.
        sweeps: over all bodies, that a round may make.
        helped: whether helpers within worlds shorten a round.
        wanted: rounds that were asked of it and of the shards that it is the whole of.
    """

    def __init__(
        self,
        bind: Callable[[int, int], Sequence[Launch]],
        first: int,
        count: int,
        watch: Watch,
        peak: np.ndarray,
        halt: np.ndarray,
        *,
        sweeps: int = 0,
        once: int = 0,
    ) -> None:
        """Remember what is launched.

        Args:
            bind: launches of one round over so many worlds from a first one.
            first: world of the shard.
            count: worlds of the shard.
            watch: what is looked at after each round.
            peak: an int32 for each kind of room, raised to the most that a world used after any round.
            halt: of int32, of which the first is set when a flag says so, and looked at before each round.
            sweeps: over all bodies, that a round may make.
            once: launches at the beginning that only the first of the rounds taken in one call makes.
        """
        self._make = bind
        self._launches: list[Launch] | None = None
        self._once, self.helped, self.wanted = once, Trial(), 0
        self.watch, self.peak, self.halt, self.sweeps = watch, peak, halt, sweeps
        self._first, self.worlds = first, count
        self._done = aligned_zeros((CACHE_LINE,), np.dtype(np.int64))
        # of which a number is read and written in half the time
        self._taken: Any = memoryview(self._done)  # type: ignore[arg-type]
        self._stopped: Any = memoryview(halt)  # type: ignore[arg-type]
        self._counted = 0
        self._bound_to = 1  # rounds that the bound launch takes
        self._run: Any = None

    def bind(self) -> list[Launch]:
        """Bind the launches of one round, if they are not; return them."""
        if self._launches is None:
            launches = list(self._make(self._first, self.worlds))
            self._run = self._repeated(launches)
            self._launches = launches
        return self._launches

    def _repeated(self, launches: list[Launch]) -> Any:
        """A call that takes rounds of them; None where they cannot be made without Python."""
        table = address_table(launches)
        if table is None:
            return None
        watch, once = self.watch, self._once
        return _bind(
            "repeat_launches",
            {
                "launches": np.concatenate((table, awake_table(table, once))) if watch.sleep else table,
                "count": len(launches),
                "once": once,
                "rounds": 1,
                "shard": (self._first, self.worlds),
                "stop_at": watch.stop_at,
                "flags": watch.flags,
                "used": np.array([array.ptr for array in watch.used], np.uint64),
                "sleep": watch.addresses,
                "peak": self.peak,
                "halt": self.halt,
                "done": self._done,
            },
        )

    @property
    def compiled(self) -> bool:
        """Whether the launches of a round are made without Python between them, so that no interrupt falls into one."""
        return bool(self.bind()) and self._run is not None

    def take_one(self) -> bool:
        """Take one round, whatever has halted before; whether it halts."""
        self._stopped[0] = 0
        if self._run is not None and self._bound_to == 1:  # as ``take`` does, in half the time
            self._run.launch_now()
        else:
            self.take(1)
        return self._stopped[0] != 0

    def take(self, rounds: int) -> None:
        """Take so many rounds, or fewer if one halts; ``count`` tells how many, with the one that halts."""
        launches = self.bind()
        if self._run is not None:
            if rounds != self._bound_to:
                self._bound_to = -1  # until it is so: an interrupt may fall between the two
                self._run.set("rounds", rounds)
                self._bound_to = rounds
            self._run.launch_now()
            return
        worlds = slice(self._first, self._first + self.worlds)
        for i in range(rounds):
            if self.halt[0]:
                break
            for launch in launches[self._once if i else 0 :]:
                launch()
            self._done[0] += 1
            for k, used in enumerate(self.watch.used):
                self.peak[k] = max(int(self.peak[k]), int(to_numpy(used)[worlds].max(initial=0)))
            if self.watch.stop_at and (to_numpy(self.watch.flags)[worlds] & self.watch.stop_at).any():
                self.halt[0] = 1

    def count(self) -> int:
        """Rounds taken since this was last asked; an interrupt right after they were taken loses none."""
        done = self._taken[0]
        found, self._counted = done - self._counted, done
        return found

    def record(self, rounds: int) -> None:
        """Make so many rounds part of the graph that this thread records."""
        for _ in range(rounds):
            for launch in self.bind():
                launch()


class PoolRounds(Rounds):
    """Rounds over all shards at once, each as far as it comes; the backend's kernel for it is compiled here.

    Attributes:
        parts: shards.
        taken: rounds that each shard has taken since this was made, (S,) int32.
    """

    def __init__(
        self,
        launches: Sequence[Launch],
        starts: np.ndarray,
        watch: Watch,
        peak: np.ndarray,
        *,
        backend: str,
        parallel: bool,
        sweeps: int = 0,
    ) -> None:
        """Bind and compile.

        Args:
            launches: one round.
            starts: first world of each shard, and their number, (S + 1,) int32.
            watch: what is looked at after each round of a shard.
            peak: an int32 for each kind of room in the row of each shard, raised to the most that a world used.
            backend: of the launches.
            parallel: whether threads share the shards.
            sweeps: over all bodies, that a round may make.

        Raises:
            ValueError: where the launches are not kernels that one kernel can call.
        """
        self._launches, self.watch, self.peak, self.sweeps = list(launches), watch, peak, sweeps
        self.worlds, self.parts = int(starts[-1] - starts[0]), len(starts) - 1
        self.halt, self.taken, self._todo = (aligned_zeros((self.parts,), np.dtype(np.int32)) for _ in range(3))
        self._run = kernel_file(backend, "runtime.sequences").repeated(
            launches,
            starts.astype(np.int32),
            parallel=parallel,
            todo=self._todo,
            taken=self.taken,
            halt=self.halt,
            flags=to_numpy(watch.flags),
            stop_at=watch.stop_at,
            used=[to_numpy(one) for one in watch.used],
            peak=peak,
        )

    def take_each(self, rounds: Sequence[int]) -> None:
        """Take so many rounds of each shard, or fewer of one that halts; ``taken`` tells how many."""
        self._todo[:] = rounds
        self._run()


class Shares:
    """How much of each loop the threads of a team take, by how fast they are: cores differ in kind, clock and load.

    Attributes:
        of: the share of each thread; their sum is 1.
    """

    def __init__(self, begins: Any) -> None:
        """Give all as much.

        Args:
            begins: where each thread's part begins, in units of 1 / ``WHOLE``, int32; written.
        """
        self._begins = begins
        self._set([1.0 / len(begins)] * len(begins))

    def learn(self, spent: Sequence[float]) -> None:
        """Change them by the time that each has spent with its share, most of the way to where all spend as much."""
        size, mean = len(spent), sum(spent) / len(spent)
        if max(spent) < NEARLY * min(spent):
            return
        wanted = [
            min(max(one * (mean / time) ** LEARNED, 1.0 / (LEAST_SHARE * size)), LEAST_SHARE / size)
            for one, time in zip(self.of, spent)
        ]
        self._set([one / sum(wanted) for one in wanted])

    def _set(self, of: list[float]) -> None:
        self.of = of
        self._begins[:] = [round(WHOLE * sum(of[:p])) for p in range(len(of))]


class Teams:
    """Memory by which threads share the loops of worlds: a team for each shard (``_warp/native/runtime/team.h``).

    A thread that leads runs the kernels of its shard, which open jobs; members take part in the jobs of all teams.

    Attributes:
        addresses: of each team, as ``Launch.team`` takes them.
    """

    def __init__(self, teams: int, size: int) -> None:
        """Seat teams of so many threads each, their leaders among them."""
        self._memory = aligned_zeros((teams, TEAM_BYTES // 64, 64), np.dtype(np.uint8))
        self.addresses = [self._memory.ctypes.data + i * self._memory.strides[0] for i in range(teams)]
        give_way, sleep, nap = _system_calls()
        head = self._memory[:, 0].view(np.uint64)
        head[:, 0], head[:, 1], head[:, [3, 4, 6]] = give_way, sleep, _team_calls()
        head.view(np.uint32)[:, 4:6] = nap, min(size, SEATS)
        self._closed = head.view(np.int32)[:, 10]
        begins = self._memory[:, 1 : 1 + BEGINS].reshape(teams, -1).view(np.int32)
        self._shares = [Shares(begins[i, :size]) for i in range(teams)]
        seats = self._memory[:, 3 + BEGINS :][:, : SEAT * SEATS].reshape(teams, SEATS, -1).view(np.uint64)
        self._spent = seats[:, :size, 16:18]  # by each thread of each team, and in how many phases
        self._over = aligned_zeros((CACHE_LINE,), np.dtype(np.int32))
        self._process = os.getpid()
        table = np.array(self.addresses, np.uint64)
        self._serve = _bind("serve", {"teams": table, "over": self._over, "patience": PATIENCE})

    def begin(self) -> None:
        """Prepare for members; those of a process that forked are not there."""
        if self._process != os.getpid():
            self._process = os.getpid()
            self._memory[:, 1 + BEGINS :] = 0
        self._over[0] = 0

    def open_jobs(self, wanted: bool) -> None:
        """Let leaders open jobs, or take their loops alone; between two launches."""
        self._closed[:] = not wanted

    def balance(self) -> None:
        """Share loops by how fast threads were since they last were so shared; between two launches."""
        for shares, seats in zip(self._shares, self._spent):
            spent = seats.tolist()
            if all(ticks and phases >= ENOUGH for ticks, phases in spent):
                shares.learn([ticks / phases for ticks, phases in spent])
                seats[:] = 0

    def serve(self) -> None:
        """Be a member of all teams, until ``end`` is called."""
        self._serve.launch_now()

    def end(self) -> None:
        """Let members leave."""
        self._over[0] = 1


@cache
def _team_calls() -> list[int]:
    """Addresses of compiled functions: to take a job, whether anybody is there, and who sums up what."""
    address = aligned_zeros((3,), np.dtype(np.uint64))
    _bind("find_calls", {"address": address}).launch_now()
    return [int(one) for one in address]


@cache
def _system_calls() -> tuple[int, int, int]:
    """Addresses of what gives way to other threads and what sleeps, and for how long that is to sleep."""
    if os.name == "nt":
        system = ctypes.CDLL("kernel32")
        calls, nap = (system.SwitchToThread, system.Sleep), 1
    else:
        system = ctypes.CDLL(None)
        calls, nap = (system.sched_yield, system.usleep), NAP
    give_way, sleep = (ctypes.cast(call, ctypes.c_void_p).value or 0 for call in calls)
    return give_way, sleep, nap


def _bind(name: str, values: dict[str, Any]) -> Any:
    """A launch of a kernel of ``_warp/runtime/sequences.py`` on numpy arrays, which it keeps alive."""
    import warp as wp

    from dc_kernels.runtime.launches import shared_array

    arrays = {
        key: shared_array(value.reshape(-1), wp.dtype_from_numpy(value.dtype), value.__array_interface__["data"][0])
        for key, value in values.items()
        if isinstance(value, np.ndarray)
    }
    return bind(make_kernels("warp", "runtime.sequences")[name], 1, {**values, **arrays}, "cpu")
