"""One world on one thread and on two, beside two worlds on a thread each: settled piles, and with busy neighbours."""

from __future__ import annotations

import multiprocessing
import statistics
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from bench import timing

SUMMARY = "one world of 1e3 to 1e5 discs on two threads over one, and on cores that other processes keep busy"
KEYS = ("ratio_10000", "ratio_100000", "oversubscribed_slowdown", "bits_equal", "round_trip_ns")
THREADS = 2

SIZES = {1_000: 1, 2_000: 2, 5_000: 5, 10_000: 10, 100_000: 100}  # piles of 1 000 side by side
SETTINGS = {"default": None, "sweeps_10": 10}  # most sweeps of a step
PAIR = (-1, 0)  # keys of two worlds, each on a thread of its own
KINDS = (1, THREADS, *PAIR)
REST = 200  # steps until piles that were put side by side take as many sweeps as later
ROUNDS, ROUNDS_QUICK = 21, 3
BUSY_ROUNDS = 7
WORK, WORK_QUICK = 400_000, 100_000  # bodies times steps of a round


def _spin() -> None:
    """Keep a core busy until the process is ended."""
    while True:
        pass


def _piles(quick: bool) -> dict[tuple[int, str], dict[int, Any]]:
    """Simulations of the same pile by size and setting: on one thread, on two, and a pair on one thread each.

    All take as many steps: a pile needs fewer sweeps the longer it rests.
    """
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
            settled = dc.Simulation(sim.model.copy(), sim.state.copy(), config=config, threads=THREADS)
            settled.run(REST, cases.DT)
            with tempfile.TemporaryDirectory() as folder:
                settled.save(path := Path(folder, "settled.npz"))
                sims = {key: dc.Simulation.load(path, threads=THREADS if key == THREADS else 1) for key in KINDS}
            for each in sims.values():
                each.run(4 * FIRST_TRIES * max(MORE * AT_ONCE // bodies, 1), cases.DT)  # until it has its way
            found[bodies, name] = sims
    return found


def _steps(bodies: int, quick: bool) -> int:
    """Steps of a round."""
    return max((WORK_QUICK if quick else WORK) // bodies, 2)


def _runner(sim: Any, steps: int) -> Callable[[], None]:
    from bench import cases

    return lambda: sim.run(steps, cases.DT)


def measure(quick: bool) -> dict[str, Any]:
    """Medians over rounds that take one pile after the other; of each size the setting in which two threads gain less.

    The way that a simulation has found to be the faster one is measured, with helpers or without, not how it finds it.
    Two worlds on a thread each, at once, take as many steps as the two cores can at that time: ``worth`` is how many
    times those of the one, and ``gained`` what part of it two threads within one world reach.
    """
    from bench.round_trip import round_trip_ns

    piles = _piles(quick)
    found: dict[tuple[int, str], list[tuple[float, ...]]] = {pile: [] for pile in piles}
    trips = []
    with ThreadPoolExecutor(2) as pool:
        for number in range(ROUNDS_QUICK if quick else ROUNDS):
            timing.progress(f"round {number + 1}")
            trips.append(round_trip_ns())
            for (bodies, name), sims in piles.items():
                runners = {key: _runner(sim, _steps(bodies, quick)) for key, sim in sims.items()}
                one, two = (timing.seconds(runners[key]) for key in (1, THREADS))
                both = list(pool.map(timing.seconds, (runners[key] for key in PAIR)))
                found[bodies, name].append((one, two, *both))
    values: dict[str, Any] = {"ratio_100000": None, "round_trip_ns": statistics.median(trips)}
    equal = []
    for (bodies, name), times in found.items():
        values[f"ms_{bodies}_{name}"] = 1e3 * statistics.median(one for one, *_ in times) / _steps(bodies, quick)
        values[f"worth_{bodies}_{name}"] = statistics.median(one / a + one / b for one, _, a, b in times)
        values[f"gained_{bodies}_{name}"] = statistics.median(1 / (two / a + two / b) for _, two, a, b in times)
        ratio = statistics.median(one / two for one, two, *_ in times)
        values[f"ratio_{bodies}_{name}"] = ratio
        values[f"ratio_{bodies}"] = min(ratio, values.get(f"ratio_{bodies}") or ratio)
        sims = piles[bodies, name]
        values[f"threads_{bodies}"] = sims[THREADS].threads
        equal.append(len({each.state.numpy("position").tobytes() for each in sims.values()}) == 1)
    values["bits_equal"] = float(all(equal))

    timing.progress("with every core busy")
    sims, steps = piles[10_000, "sweeps_10"], _steps(10_000, quick)
    context = multiprocessing.get_context("spawn")
    busy = [context.Process(target=_spin, daemon=True) for _ in range(timing.machine(THREADS)["cores"])]
    try:
        for process in busy:
            process.start()
        spent = timing.interleave({str(key): _runner(sims[key], steps) for key in (1, THREADS)}, BUSY_ROUNDS)
    finally:
        for process in busy:
            process.terminate()
            process.join()
    slower = [b / a for a, b in zip(spent["1"], spent[str(THREADS)], strict=True)]
    values["oversubscribed_slowdown"] = statistics.median(slower)
    return values


def report(values: dict[str, Any]) -> str:
    """Table for people."""
    rows = [
        (
            bodies,
            values[f"threads_{bodies}"],
            *(values[f"{what}_{bodies}_{name}"] for name in SETTINGS for what in ("ms", "ratio", "worth", "gained")),
        )
        for bodies in SIZES
        if f"ratio_{bodies}_default" in values
    ]
    columns = (f"{name} {what}" for name in SETTINGS for what in ("[ms]", "ratio", "two worlds", "gained"))
    header = ("discs", "threads used", *columns)
    return "\n".join(
        [
            timing.table(header, rows),
            "ratio: one world on two threads over one thread; two worlds: two at once, a thread each, over one",
            f"every core busy, 10 000 discs: two threads take {values['oversubscribed_slowdown']:.2f} of one's time; "
            f"a line of a cache takes {values['round_trip_ns']:.0f} ns to the other core and back",
        ]
    )
