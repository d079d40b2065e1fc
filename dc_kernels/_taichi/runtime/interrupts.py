"""An interrupt within a launch, which holds Python's lock: a kernel looks at what ``runtime.signals`` writes."""

import signal

from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.runtime.signals import ASKED, NUMBERS, PATIENCE, SWEPT

INTERRUPT = int(signal.SIGINT)
BYTE = 255
OVERHEAD = 64  # rows that take as long as a sweep of none


@ti.func
def is_cut(rows, words: ti.template()):
    """Whether sweeping is to end: asked for, or so many rows were swept since an interrupt as there is patience for.

    Args:
        rows: of the sweep that has just been made.
        words: ``launch.cut``.
    """
    cut = words[ASKED] != 0
    if words[NUMBERS] != 0:
        seen = False
        at = 4 * NUMBERS + 1
        end = 4 * words.shape[0]
        while at < end:
            number = (words[at >> 2] >> (8 * (at & 3))) & BYTE
            at += 1
            if number == INTERRUPT:
                seen = True
            if seen or number == 0:
                at = end
        if seen:
            swept = words[SWEPT]
            if swept <= words[PATIENCE]:
                words[SWEPT] = swept + rows + OVERHEAD
            else:
                cut = True
    return cut
