"""What one contact costs in one sweep of projected Gauss-Seidel.

Two solves of the same contacts that differ in nothing but the number of sweeps: the difference of their times, over
the difference in sweeps and the contacts, is the price of a sweep alone, without preparing rows or storing impulses.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from bench import timing

SUMMARY = "projected Gauss-Seidel, ns per contact and sweep: general contacts and discs only"
KEYS = ("ns_general", "ns_discs")
THREADS = 1

KINDS = {"general": False, "discs": True}  # is the solver free to leave out what only other shapes need?
WORK = 8_000_000  # contact updates between the short and the long solve: some 50 ms
ROUNDS, ROUNDS_QUICK = 9, 5


def measure(quick: bool) -> dict[str, Any]:
    """Nanoseconds for each kind and size, and their medians over the sizes."""
    from bench import cases

    values: dict[str, Any] = {}
    piles: dict[int, Any] = {}
    for target, (bodies, copies) in cases.SWEEP_PILES.items():
        timing.progress(f"{target} contacts")
        if bodies not in piles:
            piles[bodies] = cases.settled(bodies)
        found = measure_size(piles[bodies], copies, ROUNDS_QUICK if quick else ROUNDS)
        values |= {f"{key}_{target}": value for key, value in found.items()}
    for kind in KINDS:
        values[f"ns_{kind}"] = statistics.median(values[f"ns_{kind}_{target}"] for target in cases.SWEEP_PILES)
    return values


def measure_size(pile: Any, copies: int, rounds: int) -> dict[str, float]:
    """Nanoseconds of both kinds on copies of a settled pile, its discs, contacts and colours."""
    import dc_kernels as dc
    from bench import cases

    sims, functions = {}, {}
    for kind, specialize in KINDS.items():
        sim = cases.side_by_side(pile, copies, threads=1, specialize=specialize)
        sim.config = dc.SolverConfig(acceleration="none", tolerance=0.0)
        sim.collide(cases.DT)
        sims[kind] = sim
    contacts = cases.contact_count(sims["discs"])
    more = max(WORK // contacts, 10)
    lengths = {"short": more // 4, "long": more // 4 + more}

    def solver(sim: dc.Simulation, sweeps: int) -> Callable[[], float]:
        def solve() -> float:
            sim.config = replace(sim.config, max_sweeps=sweeps)  # binds the launches anew: not in the time
            return timing.seconds(sim.solve)

        return solve

    for kind, sim in sims.items():
        for length, sweeps in lengths.items():
            functions[f"{kind} {length}"] = solver(sim, sweeps)
    times = timing.interleave(functions, rounds, clock=lambda solve: solve())
    result: dict[str, float] = {"contacts": contacts, "discs": cases.dynamic_count(sims["discs"])}
    for kind, sim in sims.items():
        done = int(sim.stats.numpy("sweeps").max())  # of the long solve, which was the last
        if done != lengths["long"]:
            raise RuntimeError(f"the solve ended after {done} sweeps instead of {lengths['long']}")
        spent = [b - a for a, b in zip(times[f"{kind} short"], times[f"{kind} long"], strict=True)]
        result[f"ns_{kind}"] = 1e9 * statistics.median(spent) / (more * contacts)
        result[f"colors_{kind}"] = int(sim.stats.numpy("colors").max())
    return result


def report(values: dict[str, Any]) -> str:
    """Table for people."""
    from bench.cases import SWEEP_PILES

    rows: list[tuple[Any, ...]] = [
        (
            f"{values[f'contacts_{target}']:,d}".replace(",", " "),
            values[f"discs_{target}"],
            values[f"colors_discs_{target}"],
            values[f"ns_general_{target}"],
            values[f"ns_discs_{target}"],
        )
        for target in SWEEP_PILES
    ]
    rows.append(("median", None, None, values["ns_general"], values["ns_discs"]))
    return timing.table(("contacts", "discs", "colours", "general [ns]", "discs only [ns]"), rows)
