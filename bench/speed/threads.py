"""One world on one thread and on more: whole steps of settled piles, and what busy neighbours cost a team."""

from __future__ import annotations

import multiprocessing
import statistics
from collections.abc import Callable
from typing import Any

from bench import timing

SUMMARY = "one world of 1e3 to 1e5 discs on two threads over one, and on cores that other processes keep busy"
KEYS = ("ratio_10000", "ratio_100000", "oversubscribed_slowdown", "bits_equal", "round_trip_ns")
THREADS = 2

SIZES = {1_000: 1, 2_000: 2, 5_000: 5, 10_000: 10, 100_000: 100}  # piles of 1 000 side by side
SETTINGS = {"default": None, "sweeps_10": 10}  # most sweeps of a step
ROUNDS, ROUNDS_QUICK = 7, 3
WORK, WORK_QUICK = 400_000, 100_000  # bodies times steps of a round


def _spin() -> None:
    """Keep a core busy until the process is ended."""
    while True:
        pass


def _piles(quick: bool) -> dict[tuple[int, str], dict[int, Any]]:
    """Simulations of the same pile by size and setting, on one thread and on two."""
    import dc_kernels as dc
    from bench import cases
    from dc_kernels.runtime.stepping import AT_ONCE, MORE
    from dc_kernels.runtime.threads import FIRST_TRIES

    one = cases.settled(1_000)
    found: dict[tuple[int, str], dict[int, Any]] = {}
    for bodies, copies in SIZES.items():
        if quick and bodies == 100_000:
            continue
        sim = cases.side_by_side(one, copies) if copies > 1 else one
        for name, sweeps in SETTINGS.items():
            config = dc.SolverConfig() if sweeps is None else dc.SolverConfig(max_sweeps=sweeps)
            sims = {}
            for threads in (1, THREADS):
                sims[threads] = dc.Simulation(sim.model.copy(), sim.state.copy(), config=config, threads=threads)
                # until it has its way
                sims[threads].run(4 * FIRST_TRIES * max(MORE * AT_ONCE // bodies, 1), cases.DT)
            found[bodies, name] = sims
    return found


def _steps(bodies: int, quick: bool) -> int:
    """Steps of a round."""
    return max((WORK_QUICK if quick else WORK) // bodies, 2)


def _runner(sim: Any, steps: int) -> Callable[[], None]:
    from bench import cases

    return lambda: sim.run(steps, cases.DT)


def measure(quick: bool) -> dict[str, Any]:
    """Medians of the ratios of each round; of each size the setting in which two threads gain less.

    The way that a simulation has found to be the faster one is measured, with helpers or without, not how it finds it.
    """
    from bench.round_trip import round_trip_ns

    rounds = ROUNDS_QUICK if quick else ROUNDS
    piles = _piles(quick)
    values: dict[str, Any] = {"ratio_100000": None}
    equal, trips = [], []
    for (bodies, name), sims in piles.items():
        timing.progress(f"{bodies} discs, {name}")
        steps = _steps(bodies, quick)
        trips.append(round_trip_ns())
        times = timing.interleave({str(threads): _runner(sim, steps) for threads, sim in sims.items()}, rounds)
        trips.append(round_trip_ns())
        values[f"round_trip_ns_{bodies}_{name}"] = statistics.mean(trips[-2:])
        ratio = statistics.median(a / b for a, b in zip(times["1"], times[str(THREADS)], strict=True))
        values[f"ms_{bodies}_{name}"] = 1e3 * statistics.median(times["1"]) / steps
        values[f"ratio_{bodies}_{name}"] = ratio
        values[f"ratio_{bodies}"] = min(ratio, values.get(f"ratio_{bodies}") or ratio)
        values[f"threads_{bodies}"] = sims[THREADS].threads
        first, second = (sim.state.numpy("position").tobytes() for sim in sims.values())
        equal.append(first == second)
    values["bits_equal"] = float(all(equal))
    values["round_trip_ns"] = statistics.median(trips)

    timing.progress("with every core busy")
    sims, steps = piles[10_000, "sweeps_10"], _steps(10_000, quick)
    context = multiprocessing.get_context("spawn")
    busy = [context.Process(target=_spin, daemon=True) for _ in range(timing.machine(THREADS)["cores"])]
    try:
        for one in busy:
            one.start()
        times = timing.interleave({str(threads): _runner(sim, steps) for threads, sim in sims.items()}, rounds)
    finally:
        for one in busy:
            one.terminate()
            one.join()
    slower = [b / a for a, b in zip(times["1"], times[str(THREADS)], strict=True)]
    values["oversubscribed_slowdown"] = statistics.median(slower)
    return values


def report(values: dict[str, Any]) -> str:
    """Table for people."""
    rows = [
        (
            bodies,
            values[f"threads_{bodies}"],
            *(values[f"{what}_{bodies}_{name}"] for name in SETTINGS for what in ("ms", "ratio", "round_trip_ns")),
        )
        for bodies in SIZES
        if f"ratio_{bodies}_default" in values
    ]
    columns = (f"{name} {what}" for name in SETTINGS for what in ("[ms]", "ratio", "round trip [ns]"))
    header = ("discs", "threads used", *columns)
    return "\n".join(
        [
            timing.table(header, rows),
            f"every core busy, 10 000 discs: two threads take {values['oversubscribed_slowdown']:.2f} of one's time",
        ]
    )
