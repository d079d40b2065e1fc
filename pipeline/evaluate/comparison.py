"""Runs of many starts and networks on the same worlds: the thesis protocol, and the evaluation in both loops."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from pipeline.evaluate.options import Acceleration, EvaluationOptions, Loop, ProtocolOptions
from pipeline.evaluate.runs import Run, summaries
from pipeline.evaluate.worlds import run_worlds, split_label
from pipeline.process import progress_bar, torch_threads
from pipeline.starts.registry import is_network, maker


def protocol(
    options: ProtocolOptions | None = None,
    pairs: Sequence[tuple[str, Acceleration]] | None = None,
    progress: bool = True,
    runs: list[Run] | None = None,
) -> list[Run]:
    """Run the thesis protocol, in closed loop.

    Args:
        options: of the protocol; the theses' if None.
        pairs: start and acceleration of each run; None: every combination in the options.
        progress: show a bar on stderr.
        runs: where each goes when it is done, so that Ctrl-C leaves those before; None: a new list.

    Returns:
        One ``Run`` for each pair, in order.

    Raises:
        OSError: a network's file cannot be read.
        ValueError: for an option out of its range.
    """
    options = options or ProtocolOptions()
    return _run_all(options, pairs, ("closed",), progress, runs)


def evaluation(
    options: EvaluationOptions | None = None,
    pairs: Sequence[tuple[str, Acceleration]] | None = None,
    progress: bool = True,
    runs: list[Run] | None = None,
) -> list[Run]:
    """Run all starts and networks on the same worlds, in each of the loops.

    Args:
        options: of the evaluation; the defaults if None.
        pairs: start and acceleration of each run; None: every combination in the options.
        progress: show a bar on stderr.
        runs: where each goes when it is done, so that Ctrl-C leaves those before; None: a new list.

    Returns:
        One ``Run`` for each loop and pair: the loops in order, the pairs in order in each.
    """
    options = options or EvaluationOptions()
    return _run_all(options, pairs, options.loops, progress, runs)


def _run_all(
    options: ProtocolOptions,
    pairs: Sequence[tuple[str, Acceleration]] | None,
    loops: Sequence[Loop],
    progress: bool,
    runs: list[Run] | None,
) -> list[Run]:
    """Run each pair in each loop, after all that can fail has been tried, into ``runs``."""
    pairs = pairs or [(start, acceleration) for acceleration in options.accelerations for start in options.starts]
    makers = {}
    for start, _ in pairs:  # before anything is computed
        name = split_label(start)[1]
        if is_network(name) and options.dtype != "float32":
            raise ValueError(f"dtype is {options.dtype!r}; the network {name} answers in float32")
        makers[start] = maker(name, options.seed)
    runs = [] if runs is None else runs
    total = len(loops) * len(pairs) * options.steps
    with torch_threads(options.threads), progress_bar(total=total, unit="step", show=progress) as bar:
        for loop, (start, acceleration) in itertools.product(loops, pairs):
            bar.set_description(f"{split_label(start)[0]}, {acceleration}, {loop} loop")
            runs.append(run_worlds(options, start, acceleration, bar, loop=loop, make=makers[start]))
    return runs


def report(options: ProtocolOptions, runs: Sequence[Run], complete: bool = True) -> dict[str, Any]:
    """Return what ``--json`` prints and the JSON file holds."""
    return {"options": asdict(options), "complete": complete, "runs": summaries(runs)}
