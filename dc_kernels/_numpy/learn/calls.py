"""The verdict on a correction after some sweeps, who answers the next call of each world, and what became of it."""

from __future__ import annotations

import math
from typing import Any

from dc_kernels._numpy.common import Kernels
from dc_kernels.learn.channels import FOREVER, Answer, Scale


def kernels(dtype: str) -> Kernels:
    """``decide_calls`` and ``settle_calls``; the arrays bring their scalar type."""
    return {"decide_calls": decide_calls, "settle_calls": settle_calls}


def decide_calls(
    tid: int, world_offset: int, rules: Any, state: Any, contacts: Any, stats: Any, calls: Any, reading: Any
) -> None:
    """Judge the correction before the last sweeps, and say how each world is answered (``reading.answer``)."""
    w = tid + world_offset
    reading.answer[w] = Answer.NOTHING
    if not calls.asking[w]:
        return
    steps = stats.iteration[w]
    now, before = float(steps.step_last), float(steps.step_before)
    if steps.finished or state.flags[w]:
        calls.asking[w] = 0
        return
    if calls.waiting[w]:
        calls.waiting[w] = 0
        if not now < rules.harm**2 * calls.before[w]:
            first = contacts.contact_start[w]
            mine = slice(first, first + contacts.contact_count[w])
            contacts.impulse[mine] = reading.known[mine] = reading.before[mine]
            stats.replaced[w] = 1
            calls.undone[w] += 1
        if not now < calls.before[w]:
            calls.pause[w] = 1
            calls.failures[w] += 1
            calls.failed[w] += 1
    tried = calls.made[w]
    if not rules.middle or tried >= rules.most or 3 * calls.failures[w] >= 2 * tried + 3 * rules.trust:
        calls.asking[w] = 0
    elif calls.pause[w]:
        calls.pause[w] -= 1
    else:
        done = float(rules.tolerance) ** 2
        left = 0.0 if now < before else FOREVER
        if done < now < before:
            left = math.log(now / done) / math.log(before / now)
        enough = contacts.contact_count[w] <= rules.small or left >= rules.pays
        reading.answer[w] = Answer.NETWORK if enough else Answer.EVEN


def settle_calls(tid: int, world_offset: int, begin: int, reading: Any, stats: Any, calls: Any) -> None:
    """Count the calls that were answered, and note what they are to be judged by."""
    k = tid + world_offset
    if reading.answer[k] == Answer.NOTHING:
        return
    w = reading.active[k]
    count = reading.packed_start[k + 1] - reading.packed_start[k]
    calls.before[w] = count * reading.scale[k][Scale.STEP] ** 2 if begin else stats.iteration[w].step_last
    taken = calls.waiting[w] = stats.replaced[w]
    calls.made[w] += 1
    calls.calls[w] += 1
    calls.asked[w] += reading.answer[k] == Answer.NETWORK
    if not taken:
        calls.pause[w] = 1 + begin
        calls.failures[w] += 1
        calls.refused[w] += 1
