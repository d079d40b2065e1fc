"""Thesis worlds with a network in the loop: sweeps and wall time over those of re-using the cached impulses.

Ten held-out worlds, closed loop, 1e-4 N s, cap 1000, the theses' margins. The networks of 2018 are trained here on a
small data set first. ContactNet is the one in the package; it is asked in the calls that it pays in, in the others it
moves contacts as "even share" does in all: every contact by the same share of Aitken's step, at the same sweeps. What
ContactNet gains over that, the network gains.
"""

from __future__ import annotations

import statistics
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from bench import timing

SUMMARY = "start strategies and networks on held-out thesis worlds: sweeps, wall time, over the cached impulses"
KEYS = (
    "pgs_ratio",
    "worlds_better",
    "accelerated_ratio",
    "wall_ratio",
    "accelerated_ratio_1000",
    "wall_ratio_1000",
    "world_s",
)
THREADS = 1

STARTS = ("none", "builtin", "copy", "copy2", "copy0", "grid", "random", "bad")
DRIVERS = ("even share", "contactnet start", "contactnet")
BATCH, BATCH_QUICK = 64, 16  # worlds of the wall times
LARGE = {"bodies": 1_000, "cap": 5_000, "first": 90, "last": 390}


def measure(quick: bool) -> dict[str, Any]:
    """All tables; ``--quick`` takes 3 worlds, a smaller batch, fewer large states and shorter trainings."""
    import torch

    from bench.learning import thesis_networks
    from pipeline.evaluate.options import EvaluationOptions
    from pipeline.evaluate.runs import against
    from pipeline.evaluate.worlds import run_worlds

    torch.set_num_threads(THREADS)
    options = EvaluationOptions(worlds=3 if quick else 10, history=False)
    make = starts()
    values: dict[str, Any] = {"worlds": options.worlds, "rows": []}
    with tempfile.TemporaryDirectory() as folder:
        timing.progress("training the networks of 2018")
        networks = thesis_networks.train_all(Path(folder), quick)
        values["networks"] = {name: network.summary for name, network in networks.items()}
        plain = {}
        for name in (*STARTS, *networks, *DRIVERS):
            timing.progress(f"{name}, plain PGS")
            start = f"{name}={networks[name].path}" if name in networks else name
            plain[name] = run_worlds(options, start, "none", make=make.get(name))
    fast = {}
    for name in ("builtin", *DRIVERS):
        timing.progress(f"{name}, Aitken")
        fast[name] = run_worlds(options, name, "aitken", make=make.get(name))
    for runs in (plain, fast):
        base = runs["builtin"]
        values["rows"] += [{**run.summary(), "start": name, **against(run, base)} for name, run in runs.items()]
    best, best_fast = (against(runs["contactnet"], runs["builtin"]) for runs in (plain, fast))
    values |= {
        "pgs_ratio": best["sweeps_ratio"],
        "worlds_better": best["worlds_better"],
        "accelerated_ratio": best_fast["sweeps_ratio"],
        "accelerated_worlds_better": best_fast["worlds_better"],
        "even_ratio": against(plain["even share"], plain["builtin"])["sweeps_ratio"],
        "even_accelerated_ratio": against(fast["even share"], fast["builtin"])["sweeps_ratio"],
        "pgs_counts": dict(plain["contactnet"].counts),
        "accelerated_counts": dict(fast["contactnet"].counts),
    }
    timing.progress("wall times")
    values |= wall_times(BATCH_QUICK if quick else BATCH, 1 if quick else 3)
    timing.progress("worlds of 1 000 discs")
    values |= large_worlds(2 if quick else 10, 30 if quick else 12)
    return values


def starts() -> dict[str, Any]:
    """Return what makes each start for a simulation, by name."""
    from pipeline.contactnet.network import EvenShare
    from pipeline.starts.learned import CallOptions, LearnedSolve
    from pipeline.starts.registry import maker

    return {
        "even share": lambda sim: LearnedSolve(sim, EvenShare(), CallOptions()),
        "contactnet start": maker("cnn-start"),
        "contactnet": maker("cnn"),
    }


def thesis_simulation(worlds: int, acceleration: str, bodies: int = 100, cap: int = 1000) -> Any:
    """Held-out thesis worlds with the protocol's settings."""
    from pipeline.evaluate.options import EvaluationOptions

    options = EvaluationOptions(worlds=worlds, bodies=bodies, max_sweeps=cap, history=False)
    return options.simulation(acceleration)  # type: ignore[arg-type]


def wall_times(batch: int, rounds: int) -> dict[str, Any]:
    """A batch of worlds on plain PGS, and one world alone, from the first to the last of 250 steps."""
    from pipeline.starts.start import step

    make = starts()
    parts: dict[str, float] = {}

    def learned(worlds: int, acceleration: str, name: str = "contactnet") -> Any:
        def run() -> None:
            sim = thesis_simulation(worlds, acceleration)
            start = make[name](sim)
            for _ in range(250):
                step(start, 0.01)
            if name == "contactnet":
                parts.clear()
                parts.update(start.report().seconds)

        return run

    def builtin(worlds: int, acceleration: str) -> Any:
        return lambda: thesis_simulation(worlds, acceleration).run(250, 0.01)

    one = {
        "learned": learned(1, "none"),
        "even": learned(1, "none", "even share"),
        "builtin": builtin(1, "none"),
        "learned_accelerated": learned(1, "aitken"),
        "even_accelerated": learned(1, "aitken", "even share"),
        "builtin_accelerated": builtin(1, "aitken"),
    }
    single = timing.interleave(one, rounds)
    all_at_once = {
        "builtin": builtin(batch, "none"),
        "even": learned(batch, "none", "even share"),
        "learned": learned(batch, "none"),
    }
    many = timing.interleave(all_at_once, rounds, warmup=0)

    def ratio(name: str) -> float:
        return statistics.median(a / b for a, b in zip(many[name], many["builtin"], strict=True))

    median = timing.medians(single)
    return {
        "wall_ratio": ratio("learned"),
        "even_wall_ratio": ratio("even"),
        "batch": batch,
        "batch_s": timing.medians(many),
        "batch_parts_s": dict(parts),
        "world_s": median["learned"],
        "world_even_s": median["even"],
        "world_builtin_s": median["builtin"],
        "world_accelerated_s": median["learned_accelerated"],
        "world_even_accelerated_s": median["even_accelerated"],
        "world_builtin_accelerated_s": median["builtin_accelerated"],
    }


def large_worlds(worlds: int, every: int) -> dict[str, Any]:
    """States of 1 000 discs from impact to rest, each solved with and without the network (Aitken, cap 5 000)."""
    first, last = LARGE["first"], LARGE["last"]
    sim = thesis_simulation(worlds, "aitken", LARGE["bodies"], LARGE["cap"])
    made = {name: make(sim) for name, make in starts().items() if name != "contactnet start"}
    sweeps: dict[str, list[np.ndarray]] = {name: [] for name in ("builtin", *made)}
    wall = dict.fromkeys(sweeps, 0.0)
    sim.run(first, 0.01)
    for _ in range(first, last, every):
        sim.collide(0.01)
        start = sim.contacts.numpy("impulse").copy()
        for name in (*made, "builtin"):  # the trajectory goes on with the last one
            sim.contacts.numpy("impulse")[...] = start
            wall[name] += timing.seconds(made[name].solve if name in made else sim.solve)
            sweeps[name].append(sim.stats.numpy("sweeps").copy())
        sim.advance()
        sim.run(every - 1, 0.01)
    arrays = {name: np.array(found) for name, found in sweeps.items()}
    done = arrays["builtin"] < LARGE["cap"]
    mean = {name: float(found[done].mean()) for name, found in arrays.items()}
    return {
        "accelerated_ratio_1000": mean["contactnet"] / mean["builtin"],
        "accelerated_ratio_1000_error": ratio_error(arrays["contactnet"], arrays["builtin"], done),
        "even_ratio_1000": mean["even share"] / mean["builtin"],
        "wall_ratio_1000": wall["contactnet"] / wall["builtin"],
        "sweeps_1000": mean,
        "wall_1000_s": wall,
        "parts_1000_s": dict(made["contactnet"].report().seconds),
        "calls_1000": made["contactnet"].report().counts["calls"] / done.size,
        "states_1000": int(done.sum()),
        "unconverged_1000": int((~done).sum()),
        "unconverged_learned_1000": int((done & (arrays["contactnet"] >= LARGE["cap"])).sum()),
    }


def ratio_error(mine: np.ndarray, base: np.ndarray, counted: np.ndarray) -> float:
    """Return the standard error of the ratio of two means, from leaving out one world after the other (jackknife).

    States of a world are much alike, so that worlds are what is drawn.

    Args:
        mine: numbers of states and worlds, (S, W), W >= 2.
        base: those to compare with, (S, W).
        counted: which of them count, bool (S, W).
    """
    sums = np.where(counted, [mine, base], 0).sum(axis=1).astype(float)  # of each world, (2, W)
    left = sums.sum(axis=1, keepdims=True) - sums
    ratios = left[0] / left[1]
    worlds = len(ratios)
    return float(np.sqrt((worlds - 1) / worlds * ((ratios - ratios.mean()) ** 2).sum()))


def report(values: dict[str, Any]) -> str:
    """Tables for people."""
    header = (
        "start, solver",
        "mean",
        "median",
        "worlds",
        "/ builtin",
        "better in",
        "calls",
        "asked",
        "MSE normal",
        "tangent",
    )
    rows = []
    for row in values["rows"]:
        means = row["world_mean_sweeps"]
        calls, asked = (row["counts"].get(name) for name in ("calls", "asked"))
        rows.append(
            (
                f"{row['start']}, {row['solver']}",
                row["mean_sweeps"],
                row["median_sweeps"],
                f"{min(means):.0f}-{max(means):.0f}",
                row["sweeps_ratio"],
                f"{row['worlds_better']} of {values['worlds']}",
                None if calls is None else calls / row["states"],
                None if asked is None else asked / row["states"],
                row["start_error_normal"],
                row["start_error_tangent"],
            )
        )
    batch, parts = values["batch_s"], values["batch_parts_s"]
    split = ", ".join(f"{name} {seconds:.2f}" for name, seconds in parts.items())
    sweeps, wall = values["sweeps_1000"], values["wall_1000_s"]
    lines = [
        timing.table(header, rows),
        "",
        f"{values['batch']} worlds, plain PGS: {batch['learned']:.2f} s with ContactNet, {batch['even']:.2f} s with an "
        f"even share, {batch['builtin']:.2f} s from the cache, ratios {values['wall_ratio']:.2f} and "
        f"{values['even_wall_ratio']:.2f}; ContactNet's parts [s]: {split}",
        f"one world: {values['world_s']:.2f} s (even share {values['world_even_s']:.2f}, cache "
        f"{values['world_builtin_s']:.3f}); with Aitken {values['world_accelerated_s']:.2f} s (even share "
        f"{values['world_even_accelerated_s']:.2f}, cache {values['world_builtin_accelerated_s']:.3f})",
        f"1 000 discs, Aitken, {values['states_1000']} states that converge without it: sweeps "
        f"{sweeps['contactnet']:.0f} with ContactNet, {sweeps['even share']:.0f} with an even share, "
        f"{sweeps['builtin']:.0f} without, ratio {values['accelerated_ratio_1000']:.2f} +- "
        f"{values['accelerated_ratio_1000_error']:.2f}; wall "
        f"{wall['contactnet']:.2f}, {wall['even share']:.2f} and {wall['builtin']:.2f} s, ratio "
        f"{values['wall_ratio_1000']:.2f}; "
        f"{values['calls_1000']:.1f} calls a state",
    ]
    return "\n".join(lines)
