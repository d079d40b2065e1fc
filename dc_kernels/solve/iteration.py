"""State of a solve in flight."""

from __future__ import annotations

# a world's iteration in flight: sweeps done, sweeps into the Aitken period, its length, finished, periods without
# progress, plain sweeps to follow them, a period's end put off by a pause, sweep whose step was measured for a pause;
# of "adaptive": sweeps into the stretch, its method, length of the stretch before, periods without Anderson's update to
# come, how many when it next does harm, iterates remembered, whether the period began with an update
COUNTERS = 16
# change of this sweep, |step|^2 of the sweep before the period's last, of the period or sweep before, least so far, of
# the last two sweeps before a pause; of "adaptive": rate of each method, |step|^2 of the stretch's first sweep,
# Nesterov's t, |step|^2 before Anderson's update, its eight sums of products; least change of a stretch's first sweep,
# or of any since half the cap
NORMS = 21
ADAPT_AITKEN, ADAPT_MOMENTUM, ADAPT_ANDERSON = 0, 1, 2  # methods of "adaptive"
# arrays of row impulses that an accelerated solve looks back on: two iterates and their steps, the iterate of the least
# change
HISTORY = 5
BEST = 4
RETREAT = 4.0  # times the least change: a solve that hits its cap beyond goes back to where that was
ANDERSON_PERIOD = 3  # sweeps between two updates
ANDERSON_REST, ANDERSON_REST_MAX = 4, 64  # periods without it after one that did harm
NEVER = 2**30  # sweeps until a pause, where there is none
