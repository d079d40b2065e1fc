"""Everything but the solve: what a body costs in collide and advance, and how much memory bodies and contacts take.

The piles have settled; steps are real ones, with a solve between the two timed phases. The time is the mean over
consecutive steps, so that the steps in which the broadphase is rebuilt count with their share.
"""

from __future__ import annotations

import statistics
import time
from typing import Any

from bench import timing

SUMMARY = "all but the solve, ns per body and step, and bytes per body and contact, at 1e2 to 1e5 discs a world"
KEYS = ("ns_per_body", "bytes_per_body", "bytes_per_contact")
THREADS = 1

ROUNDS, ROUNDS_QUICK = 7, 3
STEPS, STEPS_QUICK = 40, 10  # in each round


def phases(sim: Any, steps: int, dt: float) -> dict[str, float]:
    """Mean seconds of a step's phases over consecutive steps."""
    spent = {"collide": 0.0, "solve": 0.0, "advance": 0.0}
    for _ in range(steps):
        for phase, function in (("collide", lambda: sim.collide(dt)), ("solve", sim.solve), ("advance", sim.advance)):
            begin = time.perf_counter()
            function()
            spent[phase] += time.perf_counter() - begin
    return {phase: seconds / steps for phase, seconds in spent.items()}


def measure(quick: bool) -> dict[str, Any]:
    """Values of each size and the worst of them."""
    from bench import cases

    sims: dict[int, Any] = {}
    for bodies, worlds in cases.SCALING_WORLDS.items():
        timing.progress(f"settling {worlds} x {bodies} discs")
        if quick and bodies == 100_000:  # spares minutes of falling
            sims[bodies] = cases.side_by_side(sims[10_000], 10)
        else:
            sims[bodies] = cases.settled(bodies, worlds)
    # not of the bar: what it costs to number the bodies of a large world without regard to their places
    shuffled = cases.side_by_side(sims[1_000], 100, shuffled=True)
    timing.progress("timed rounds")
    steps = STEPS_QUICK if quick else STEPS
    rounds: dict[int, list[dict[str, float]]] = {bodies: [] for bodies in sims}
    for _ in range(ROUNDS_QUICK if quick else ROUNDS):
        for bodies, sim in sims.items():
            rounds[bodies].append(phases(sim, steps, cases.DT))

    values: dict[str, Any] = {}
    found = [phases(shuffled, steps, cases.DT) for _ in range(ROUNDS_QUICK)]
    values["ns_per_body_shuffled"] = statistics.median(1e4 * (f["collide"] + f["advance"]) for f in found)
    for bodies, sim in sims.items():
        moving, contacts, memory = cases.dynamic_count(sim), cases.contact_count(sim), sim.memory()
        for phase in ("collide", "solve", "advance"):
            median = statistics.median(found[phase] for found in rounds[bodies])
            values[f"{phase}_ns_{bodies}"] = 1e9 * median / moving
        values[f"ns_per_body_{bodies}"] = (
            1e9 / moving * statistics.median(found["collide"] + found["advance"] for found in rounds[bodies])
        )
        values[f"bytes_per_body_{bodies}"] = memory["body_bytes"] / moving
        values[f"bytes_per_contact_{bodies}"] = memory["contact_bytes"] / contacts
        values[f"contacts_per_body_{bodies}"] = contacts / moving
    for key in KEYS:
        values[key] = max(values[f"{key}_{bodies}"] for bodies in sims)
    return values


def report(values: dict[str, Any]) -> str:
    """Table for people."""
    from bench.cases import SCALING_WORLDS

    columns = ("contacts_per_body", "collide_ns", "advance_ns", "ns_per_body", "bytes_per_body", "bytes_per_contact")
    rows: list[tuple[Any, ...]] = [
        (f"{worlds} x {bodies}", *(values[f"{column}_{bodies}"] for column in columns))
        for bodies, worlds in SCALING_WORLDS.items()
    ]
    rows.append(("1 x 100000, shuffled", None, None, None, values["ns_per_body_shuffled"], None, None))
    rows.append(("worst", None, None, None, *(values[key] for key in KEYS)))
    header = ("worlds x discs", "contacts/body", "collide [ns]", "advance [ns]", "both [ns]", "B/body", "B/contact")
    return timing.table(header, rows)
