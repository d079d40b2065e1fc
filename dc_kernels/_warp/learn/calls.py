"""The verdict on a correction after some sweeps, who answers the next call of each world, and what became of it."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.groups import group_types, struct_type
from dc_kernels.learn.channels import FOREVER, Answer, Scale
from dc_kernels.learn.groups import CALLS, READING, RULES


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """``decide_calls``, a thread each world; ``settle_calls``, a thread each world that is asked for."""
    t = group_types(dtype)
    real = t.real
    zero = real(0.0)
    Reading, Calls = struct_type("reading", dtype, READING), struct_type("calls", dtype, CALLS)
    Rules = struct_type("rules", dtype, RULES)
    module = kernel_module("calls", dtype)

    @wp.func(module=module)
    def judge(w: int, harm: real, contacts: t.Contacts, reading: Reading, stats: t.Stats, calls: Calls):
        """Take back what did harm; a world whose sweeps take no smaller steps leaves out a call."""
        now = stats.iteration[w].step_last
        calls.waiting[w] = 0
        # comparisons with NaN are false
        if not (now < harm * harm * calls.before[w]):
            for c in range(contacts.contact_start[w], contacts.contact_start[w] + contacts.contact_count[w]):
                contacts.impulse[c] = reading.before[c]
                reading.known[c] = reading.before[c]
            stats.replaced[w] = 1
            calls.undone[w] = calls.undone[w] + wp.int64(1)
        if not (now < calls.before[w]):
            calls.pause[w] = 1
            calls.failures[w] = calls.failures[w] + 1
            calls.failed[w] = calls.failed[w] + wp.int64(1)

    @wp.func(module=module)
    def sweeps_left(w: int, tolerance: real, stats: t.Stats):
        """Sweeps to the tolerance at the rate of the last two; FOREVER where they do not converge."""
        now = stats.iteration[w].step_last
        before = stats.iteration[w].step_before
        if not (now < before):
            return real(FOREVER)
        if now <= tolerance * tolerance:
            return zero
        return wp.log(now / (tolerance * tolerance)) / wp.log(before / now)

    @wp.kernel(module=module, enable_backward=False)
    def decide_calls(
        world_offset: int,
        rules: Rules,
        state: t.State,
        # in, out:
        contacts: t.Contacts,
        stats: t.Stats,
        calls: Calls,
        reading: Reading,
    ):
        """Judge the correction before the last sweeps, and say how each world is answered (``reading.answer``)."""
        w = wp.tid() + world_offset
        reading.answer[w] = Answer.NOTHING
        if calls.asking[w] == 0:
            return
        if stats.iteration[w].finished != 0 or state.flags[w] != 0:
            calls.asking[w] = 0
            return
        if calls.waiting[w] != 0:
            judge(w, rules.harm, contacts, reading, stats, calls)
        tried = calls.made[w]
        if rules.middle == 0 or tried >= rules.most or 3 * calls.failures[w] >= 2 * tried + 3 * rules.trust:
            calls.asking[w] = 0
            return
        if calls.pause[w] > 0:
            calls.pause[w] = calls.pause[w] - 1
            return
        reading.answer[w] = Answer.NETWORK
        if contacts.contact_count[w] > rules.small and sweeps_left(w, rules.tolerance, stats) < rules.pays:
            reading.answer[w] = Answer.EVEN

    @wp.kernel(module=module, enable_backward=False)
    def settle_calls(
        world_offset: int,
        begin: int,
        reading: Reading,
        stats: t.Stats,
        # in, out:
        calls: Calls,
    ):
        """Count the calls that were answered, and note what they are to be judged by."""
        k = wp.tid() + world_offset
        if reading.answer[k] == Answer.NOTHING:
            return
        w = reading.active[k]
        calls.before[w] = stats.iteration[w].step_last
        if begin == 1:  # the step that all contacts would take alone
            sigma = reading.scale[k][Scale.STEP]
            calls.before[w] = real(reading.packed_start[k + 1] - reading.packed_start[k]) * sigma * sigma
        calls.waiting[w] = stats.replaced[w]
        calls.made[w] = calls.made[w] + 1
        calls.calls[w] = calls.calls[w] + wp.int64(1)
        if reading.answer[k] == Answer.NETWORK:
            calls.asked[w] = calls.asked[w] + wp.int64(1)
        if stats.replaced[w] == 0:
            calls.pause[w] = 1 + begin
            calls.failures[w] = calls.failures[w] + 1
            calls.refused[w] = calls.refused[w] + wp.int64(1)

    return {"decide_calls": decide_calls, "settle_calls": settle_calls}
