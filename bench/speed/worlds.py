"""Whole thesis worlds per second on one core, beside pymunk and pybox2d in the same run.

Ours is a batch of worlds from its random placement to the end of the last step: scene, arrays, simulation, 250 steps,
each solved until no impulse changes by more than 1e-4 N s. The peers get the same initial worlds, placed beforehand
and not in their time, and build and step them one by one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bench import timing
from bench.peers import peers

SUMMARY = "thesis worlds per second and core, beside pymunk and pybox2d, with the overlap each one leaves"
KEYS = (
    "worlds_per_s",
    "overlap_mean_mm",
    "mean_sweeps",
    "threads_ratio",
    *peers.PEERS,
    *(f"{name}_overlap_mm" for name in peers.PEERS),
)
THREADS = 2

TOLERANCE = 1e-4  # [N s]
ROUNDS, ROUNDS_QUICK = 5, 3
PEER_WORLDS, PEER_WORLDS_QUICK = 8, 2  # in each round; they take the seeds of the first of ours


@dataclass
class Batch:
    """One engine's worlds: ``run`` builds and steps them all and returns the final positions of each."""

    worlds: int
    run: Callable[[], list[np.ndarray]]
    positions: list[np.ndarray] = field(default_factory=list)

    def __call__(self) -> None:
        """Run, and keep where the discs ended."""
        self.positions = self.run()


def measure(quick: bool) -> dict[str, Any]:
    """Rates from median times, overlaps of the last round, sweeps of an extra run that is not timed."""
    import dc_kernels as dc
    from bench import cases
    from pipeline import scenes

    scene = scenes.Thesis()
    config = dc.SolverConfig(tolerance=TOLERANCE, start="cache")

    def ours(threads: int) -> Callable[[], list[np.ndarray]]:
        def run() -> list[np.ndarray]:
            sim = cases.simulation(scene, cases.BATCH, config=config, threads=threads)
            sim.run(cases.STEPS, cases.DT)
            return cases.disc_positions(sim.model, sim.state)

        return run

    def theirs(name: str, worlds: int) -> Callable[[], list[np.ndarray]]:
        initial = cases.disc_worlds(scene, worlds)
        return lambda: [peers.PEERS[name](world, cases.STEPS, cases.DT) for world in initial]

    count = PEER_WORLDS_QUICK if quick else PEER_WORLDS
    batches = {"ours": Batch(cases.BATCH, ours(1)), "ours_2": Batch(cases.BATCH, ours(2))}
    batches |= {name: Batch(count, theirs(name, count)) for name in peers.PEERS}

    timing.progress("sweeps of every step")  # this run also compiles and fills the caches
    mean_sweeps, share_capped = count_sweeps(cases.simulation(scene, cases.BATCH, config=config), config.max_sweeps)
    timing.progress("timed rounds")
    times = timing.interleave(batches, ROUNDS_QUICK if quick else ROUNDS, warmup=0)
    median = timing.medians(times)
    rate = {name: batch.worlds / median[name] for name, batch in batches.items()}
    ratios = [one / two for one, two in zip(times["ours"], times["ours_2"], strict=True)]

    walls = cases.disc_worlds(scene, 1)[0].walls
    values: dict[str, Any] = {}
    for name, batch in batches.items():
        radii = np.full(scene.bodies, scene.radius)
        found = np.concatenate([peers.overlaps(positions, radii, walls) for positions in batch.positions])
        values[f"{name}_overlap_mm"] = peers.mean_overlap_mm(found)
        values[f"{name}_overlap_max_mm"] = 1e3 * float(found.max(initial=0.0))
        values[f"{name}_pairs_per_world"] = len(found) / batch.worlds
    return {
        "worlds_per_s": rate["ours"],
        "overlap_mean_mm": values["ours_overlap_mm"],
        "mean_sweeps": mean_sweeps,
        "share_capped": share_capped,
        "worlds_per_s_2_threads": rate["ours_2"],
        "threads_ratio": float(np.median(ratios)),
        **{name: rate[name] for name in peers.PEERS},
        **values,
        "worlds": {name: batch.worlds for name, batch in batches.items()},
        "seconds": times,
    }


def count_sweeps(sim: Any, cap: int) -> tuple[float, float]:
    """Mean sweeps of a world's step, and the share of them that reach the cap; only steps with contacts count."""
    import dc_kernels as dc
    from bench import cases

    counted: list[np.ndarray] = []

    def note(sim: dc.Simulation) -> None:
        sweeps = np.array(sim.stats.numpy("sweeps"))
        counted.append(sweeps[sim.contacts.numpy("contact_count") > 0])

    sim.run(cases.STEPS, cases.DT, callback=note)
    sweeps = np.concatenate(counted)
    return float(sweeps.mean()), float((sweeps >= cap).mean())


def report(values: dict[str, Any]) -> str:
    """Table for people."""
    texts = {"ours": "deep-contact to 1e-4 N s", "ours_2": "deep-contact, 2 threads", **peers.PEER_TEXT}
    rates = {
        "ours": values["worlds_per_s"],
        "ours_2": values["worlds_per_s_2_threads"],
        **{name: values[name] for name in peers.PEERS},
    }
    rows = [
        (
            text,
            rates[name],
            values[f"{name}_overlap_mm"],
            values[f"{name}_overlap_max_mm"],
            values[f"{name}_pairs_per_world"],
        )
        for name, text in texts.items()
    ]
    header = ("thesis worlds, 250 steps of 0.01 s", "worlds/s", "overlap mean [mm]", "max [mm]", "touching pairs")
    return "\n".join(
        [
            timing.table(header, rows),
            "",
            f"mean sweeps of a step {values['mean_sweeps']:.1f}, {values['share_capped']:.2%} of them at the cap; "
            f"2 threads over 1: {values['threads_ratio']:.2f}",
        ]
    )
