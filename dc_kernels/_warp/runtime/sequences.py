"""Launches of compiled kernels one after the other, without Python between them; on the CPU only.

``launches`` holds four numbers for each: addresses of the compiled function, of its bounds and of its packed arguments,
and the bits of ``Activity`` without which it has nothing to do and is left out.
"""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.native import native_code
from dc_kernels.model.enums import Activity
from dc_kernels.runtime.sequences import SEATS, TEAM_BYTES
from dc_kernels.sleep.sleepers import LOOK_EVERY

LAUNCH = wp.constant(4)  # numbers of a launch
AWAKE = wp.constant(int(Activity.AWAKE))
ASLEEP = wp.constant(int(Activity.ASLEEP))
CLOCKED = wp.constant(6)  # numbers of ``sleep`` with those of time


@wp.func_native(
    native_code("runtime/launch.h", dtype="float32", EVERY=LOOK_EVERY, **{bit.name: int(bit) for bit in Activity})
)
def launch_all(
    launches: wp.array(dtype=wp.uint64),
    begin: wp.int32,
    end: wp.int32,
    shard: wp.vec2i,
    sleep: wp.array(dtype=wp.uint64),
    active: wp.int32,
) -> wp.int32: ...


@wp.func_native(native_code("runtime/pass_time.h", dtype="float32"))
def pass_time(
    rounds: wp.int32,
    shard: wp.vec2i,
    flags: wp.array(dtype=wp.int32),
    sleep: wp.array(dtype=wp.uint64),
    halt: wp.array(dtype=wp.int32),
) -> wp.int32: ...


@wp.func_native("""
#if !defined(__CUDA_ARCH__)
return __atomic_load_n(place.data, __ATOMIC_RELAXED);
#else
return 0;
#endif
""")
def read_shared(place: wp.array(dtype=wp.int32)) -> wp.int32: ...


@wp.func_native("""
#if !defined(__CUDA_ARCH__)
__atomic_store_n(place.data, value, __ATOMIC_RELAXED);
#endif
""")
def write_shared(place: wp.array(dtype=wp.int32), value: wp.int32): ...


@wp.func_native("return ((const int*)addresses.data[k])[i];")
def read_at(addresses: wp.array(dtype=wp.uint64), k: wp.int32, i: wp.int32) -> wp.int32: ...


def _team_code(name: str) -> str:
    headers = ("runtime/team.h", "runtime/lead.h", f"runtime/{name}.h")
    return native_code(*headers, dtype="float32", SEATS=SEATS, TEAM_BYTES=TEAM_BYTES)


@wp.func_native(_team_code("address"))
def address_of(which: wp.int32) -> wp.uint64: ...


@wp.func_native(_team_code("serve"))
def take_part(teams: wp.array(dtype=wp.uint64), over: wp.array(dtype=wp.int32), patience: wp.int32): ...


@cache
def kernels() -> dict[str, Any]:
    """``run_launches``, ``repeat_launches``, ``serve`` and ``find_calls``, of one thread each."""
    module = wp.get_module("dc_kernels.sequences")
    module.options.update({"enable_backward": False})

    @wp.kernel(module=module, enable_backward=False)
    def run_launches(launches: wp.array(dtype=wp.uint64), count: int, sleep: wp.array(dtype=wp.uint64)):
        """Each launch once; ``sleep`` is empty."""
        launch_all(launches, 0, count, wp.vec2i(0, 0), sleep, -1)

    @wp.kernel(module=module, enable_backward=False)
    def repeat_launches(
        launches: wp.array(dtype=wp.uint64),
        count: int,
        once: int,
        rounds: int,
        shard: wp.vec2i,
        stop_at: int,
        flags: wp.array(dtype=wp.int32),
        used: wp.array(dtype=wp.uint64),
        sleep: wp.array(dtype=wp.uint64),
        # in, out:
        peak: wp.array(dtype=wp.int32),
        halt: wp.array(dtype=wp.int32),
        done: wp.array(dtype=wp.int64),
    ):
        """Rounds of all launches, until a world's flags hold a bit of ``stop_at``: that halts whoever shares ``halt``.

        Behind the ``count`` launches come those of them that a round makes where nothing sleeps. ``shard`` is the first
        world and their number. The first ``once`` launches are made in the first round only.
        ``used`` holds the address of an int32 for each world, for several kinds of room; ``peak`` is raised to the most
        that a world used of each kind after any round, and ``done`` by the rounds taken. ``sleep`` holds the addresses
        of ``sleeping``, ``dormant`` and ``waited`` of sleepers, or nothing; behind them those of ``time`` and
        ``step_dt``, and the bytes of a number of the latter, where rounds in which nothing is awake do nothing else.
        """
        first = shard[0]
        worlds = shard[1]
        active = int(-1)
        taken = int(0)
        while taken < rounds and read_shared(halt) == 0:
            if active == ASLEEP and sleep.shape[0] == CLOCKED:
                taken += pass_time(rounds - taken, shard, flags, sleep, halt)
                continue
            if active == AWAKE:
                active = launch_all(launches, count, launches.shape[0] // LAUNCH, shard, sleep, active)
            else:
                active = launch_all(launches, wp.where(taken == 0, 0, once), count, shard, sleep, active)
            taken += 1
            full = int(0)
            for w in range(first, first + worlds):
                full = full | (flags[w] & stop_at)
            for k in range(used.shape[0]):
                most = peak[k]
                for w in range(first, first + worlds):
                    most = wp.max(most, read_at(used, k, w))
                peak[k] = most
            if full != 0:
                write_shared(halt, 1)
        done[0] = done[0] + wp.int64(taken)

    @wp.kernel(module=module, enable_backward=False)
    def serve(teams: wp.array(dtype=wp.uint64), over: wp.array(dtype=wp.int32), patience: int):
        """Take part in the jobs of teams by their addresses, until ``over`` is not 0 or so many naps found none."""
        take_part(teams, over, patience)

    @wp.kernel(module=module, enable_backward=False)
    def find_calls(address: wp.array(dtype=wp.uint64)):
        """The addresses of the functions that a team calls; 0 on a GPU."""
        for i in range(address.shape[0]):
            address[i] = address_of(i)

    return {
        "run_launches": run_launches,
        "repeat_launches": repeat_launches,
        "serve": serve,
        "find_calls": find_calls,
    }
