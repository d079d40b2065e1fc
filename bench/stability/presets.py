"""The solver's settings by name in closed loop: sweeps, time, overlap, creep, drift and energy of piles and stacks.

Every scene runs from its start with the same steps of 0.01 s. "accurate" solves each step to an impulse change of
1e-4 N s; what another preset leaves beyond that is the price of its shorter solves.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

import dc_kernels as dc
from bench import timing
from bench.cases import DT, simulation
from bench.error_time.scenes import HeavyOnLight, MixedMasses
from dc_kernels.measure import contact_slots, kinetic_energy, potential_energy
from pipeline import scenes

SUMMARY = (
    "presets of the solver in closed loop: sweeps, time, overlap, creep, drift, energy of piles, stacks, a tumbler"
)
KEYS = ("scenes", "overlap_mean_more_mm", "overlap_mean_more_masses_mm", "sweeps_over_accurate")
THREADS = 1

PRESETS = ("accurate", "strict", "default", "fast")
EVERY = 10  # steps between two looks at overlaps
TOUCHING = 1e-3  # gap below which surfaces touch [length_scale]
LAST = 50  # steps over which bodies drift
SPREAD = ("mixed_masses", "heavy_on_light")  # masses of one scene differ by four decades
MEASURES = ("ms", "sweeps", "most_sweeps", "overlap_mm", "overlap_max_mm", "creep_mm_s", "drift_mm_s", "energy_j")


@dataclass(frozen=True)
class Case:
    """A scene, how many worlds of it, and how long they run."""

    scene: scenes.Scene
    steps: int
    worlds: int = 1
    large: bool = False


CASES = {
    "thesis_100": Case(scenes.Thesis(), 250, worlds=16),
    "impact_1000": Case(scenes.Thesis(bodies=1000), 300),
    "impact_10000": Case(scenes.Thesis(bodies=10_000), 300, large=True),
    "mixed_300": Case(scenes.Mixed(bodies=300), 300),
    "tumbler_400": Case(scenes.Tumbler(bodies=400), 300, large=True),
    "pyramid_465": Case(scenes.Pyramid(rows=30), 300),
    "stack_10": Case(scenes.Stack(), 300),
    "mixed_masses": Case(MixedMasses(bodies=300), 300),
    "heavy_on_light": Case(HeavyOnLight(), 300),
}


def measure(quick: bool) -> dict[str, Any]:
    """Figures of each scene and preset; how much more the default's bodies overlap, and its share of the sweeps.

    ``overlap_mean_more_mm`` is the most by which a scene's mean overlap with the default exceeds that with "accurate",
    of scenes with like masses, ``overlap_mean_more_masses_mm`` that of the others.
    """
    found: dict[str, dict[str, Any]] = {}
    for name, case in CASES.items():
        if not (quick and case.large):
            timing.progress(name)
            found[name] = {preset: run(case, preset) for preset in PRESETS}
    more = {name: of["default"]["overlap_mm"] - of["accurate"]["overlap_mm"] for name, of in found.items()}
    shares = [of["default"]["sweeps"] / of["accurate"]["sweeps"] for of in found.values()]
    return {
        "scenes": found,
        "overlap_mean_more_mm": max(value for name, value in more.items() if name not in SPREAD),
        "overlap_mean_more_masses_mm": max(more[name] for name in SPREAD),
        "sweeps_over_accurate": float(np.exp(np.mean(np.log(shares)))),
    }


def run(case: Case, preset: str) -> dict[str, float]:
    """Step a case from its start; see ``MEASURES``: time and sweeps are of a step, energies those at the end."""
    sim = simulation(case.scene, case.worlds, 7, config=dc.SolverConfig.preset(preset))
    sim.warmup()
    dynamic = sim.model.numpy("body_type") == dc.BodyType.DYNAMIC
    touching = TOUCHING * float(sim.model.numpy("length_scale").max())
    spent, sweeps, most, overlaps, deepest = 0.0, 0.0, 0, [], 0.0
    before = sim.state.numpy("position")[dynamic].copy()
    for step in range(case.steps):
        if step == case.steps - LAST:
            before = sim.state.numpy("position")[dynamic].copy()
        if step % EVERY == EVERY - 1:
            sim.collide(DT)
            gap = sim.contacts.numpy("gap")[contact_slots(sim.contacts)[0]]
            overlap = np.maximum(-gap[gap < touching], 0.0)
            overlaps.append(overlap.mean() if len(overlap) else 0.0)
            deepest = max(deepest, overlap.max(initial=0.0))
            spent += timing.seconds(sim.solve) + timing.seconds(sim.advance)
        else:
            spent += timing.seconds(lambda: sim.step(DT))
        sweeps += sim.stats.numpy("sweeps").mean()
        most = max(most, int(sim.stats.numpy("sweeps").max()))
    moved = np.linalg.norm(sim.state.numpy("position")[dynamic] - before, axis=1).mean()
    values = (
        1e3 * spent / case.steps,
        sweeps / case.steps,
        most,
        1e3 * np.mean(overlaps),
        1e3 * deepest,
        1e3 * np.linalg.norm(sim.state.numpy("velocity")[dynamic], axis=1).mean(),
        1e3 * moved / (LAST * DT),
        kinetic_energy(sim).sum() + potential_energy(sim).sum(),
    )
    return dict(zip(MEASURES, map(float, values), strict=True))


def report(values: dict[str, Any]) -> str:
    """Table for people."""
    header = ("scene", "preset", "ms", "sweeps", "most", "overlap [mm]", "max", "creep [mm/s]", "drift", "energy [J]")
    rows = [
        (name, preset, *(of[measure] for measure in MEASURES))
        for name, presets in values["scenes"].items()
        for preset, of in presets.items()
    ]
    return timing.table(header, rows)
