"""How far two cores are from each other: what a line of a cache takes from one to the other and back."""

from __future__ import annotations

import statistics
import threading
from functools import cache
from typing import Any

import warp as wp

from bench import timing

TIMES = 20_000  # of a part: 1 to 10 ms, to which the start of a thread adds some 50 us
PARTS = 5
LINE = 32  # int32: two lines of a cache, as they may be fetched in pairs

CODE = """
#if !defined(__CUDA_ARCH__)
int *const mine = place.data + line * me, *const other = place.data + line * (1 - me);
for (int i = 1; i <= times; ++i) {
    if (me == 0) __atomic_store_n(mine, i, __ATOMIC_RELEASE);
    while (__atomic_load_n(other, __ATOMIC_ACQUIRE) < i)
#if defined(__x86_64__)
        __builtin_ia32_pause();
#else
        ;
#endif
    if (me == 1) __atomic_store_n(mine, i, __ATOMIC_RELEASE);
}
#endif
"""


@cache
def _exchange() -> Any:
    """Make the kernel by which one of two threads answers the other so many times."""

    @wp.func_native(CODE)
    def answer(place: wp.array(dtype=wp.int32), line: wp.int32, me: wp.int32, times: wp.int32): ...  # type: ignore[valid-type]

    module = wp.get_module("bench.round_trip")
    module.options.update({"enable_backward": False})

    @wp.kernel(module=module)
    def exchange(place: wp.array(dtype=wp.int32), line: int, me: int, times: int):  # type: ignore[valid-type]
        answer(place, line, me, times)

    return exchange


def round_trip_ns() -> float:
    """Measure the median time of a round trip between two threads [ns], over some parts of many each."""
    place = wp.zeros(2 * LINE, dtype=wp.int32, device="cpu")
    calls = [
        wp.launch(_exchange(), dim=1, inputs=[place, LINE, me, TIMES], device="cpu", record_cmd=True) for me in (0, 1)
    ]
    spent = []
    for _ in range(PARTS):
        place.zero_()
        other = threading.Thread(target=calls[1].launch)
        other.start()
        spent.append(timing.seconds(calls[0].launch))
        other.join()
    return 1e9 * statistics.median(spent) / TIMES
