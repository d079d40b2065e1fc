"""One step's contact problem, solved by every setting: errors after so many sweeps, and what they took.

Each solve is made anew from the same start, so a point of a curve is a whole solve with ``max_sweeps`` at that number:
warm start, sweeps, and the residual that every solve reports at its end. float32 or not, velocities and impulses are
compared with the float64 reference of the same recorded state.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

import dc_kernels as dc
from bench import timing
from bench.cases import DT
from bench.error_time.references import Reference, mass_norm
from bench.error_time.scenes import Case, State
from dc_kernels.measure import contact_slots
from dc_kernels.model.config import ACCELERATIONS

ERRORS = ("residual", "change", "velocity", "impulse")
"""Relative natural map [1]; largest impulse change of the last sweep [N s]; error in velocity, in the mass norm, over
what the reference's impulses change velocities by [1]; error in impulses relative to the reference's [1]: no two
solvers need agree in it, since hyperstatic piles have many solutions. Of several references the one nearest in velocity
counts: with Coulomb friction velocities need not be unique either."""
FLOOR = 1e-16  # an error counts as no less
TOLERANCES = {"float32": 0.0, "float64": 1e-13}  # [N s]: a solve in float64 that reaches this is at its end
SHORT = 5e-3  # [s]: solves below this are repeated three times as often
SLOW_CAP = 1_000  # most sweeps of a network's or a scalar solve, which is timed once: their differences are large


@dataclass(frozen=True)
class Setting:
    """How a contact problem is solved."""

    method: str = "pgs"
    acceleration: str = "aitken"
    start: str = "cache"
    """cache; zero; cnn, the network of the package."""
    schedule: str = "world"
    """world: SIMD lanes; color: the scalar function, a launch a colour."""
    dtype: str = "float32"

    @property
    def label(self) -> str:
        """What tells it from the default."""
        name = "plain" if self.acceleration == "none" else self.acceleration
        parts = [name if self.method == "pgs" else f"{self.method} {name}"]
        parts += {"cache": [], "zero": ["from zero"], "cnn": ["ContactNet"]}[self.start]
        parts += ["scalar"] if self.schedule == "color" else []
        parts += ["float64"] if self.dtype == "float64" else []
        return ", ".join(parts)

    def config(self, **changed: Any) -> dc.SolverConfig:
        """The solver's settings."""
        return dc.SolverConfig(method=self.method, acceleration=self.acceleration, **changed)  # type: ignore[arg-type]

    def fields(self) -> dict[str, str]:
        """What differs from the plainest of its kind, for a line of JSON; the acceleration is always told."""
        told = {"acceleration": self.acceleration}
        for name, usual in (("method", "pgs"), ("start", "cache"), ("schedule", "world"), ("dtype", "float32")):
            if getattr(self, name) != usual:
                told[name] = getattr(self, name)
        return told


DEFAULT = Setting(acceleration=dc.SolverConfig().acceleration)


def settings(learned: bool, quick: bool = False) -> list[Setting]:
    """All that are compared: each method with each acceleration, and whatever else there is with plain and default.

    Jacobi with over-relaxation is not: mass splitting is proven up to a factor of 1. Nor are soft contacts, whose
    impulses solve no problem of the step.
    """
    found = []
    for method in ("pgs", "jacobi"):
        for acceleration in ACCELERATIONS:
            setting = Setting(method=method, acceleration=acceleration)
            try:
                setting.config()
            except ValueError:
                continue  # no such pair
            found.append(setting)
    usual = dict.fromkeys((Setting(acceleration="none"), DEFAULT))
    for other in ({"start": "zero"}, {"dtype": "float64"}, {"schedule": "color"}, {"start": "cnn"}):
        if not (learned or other.get("start") != "cnn") or (quick and other.get("schedule")):
            continue
        found += [replace(setting, **other) for setting in usual]
    return found


@dataclass
class Curve:
    """Errors and times of one setting on one state, by number of sweeps allowed; it ends where the solver does."""

    caps: list[int] = field(default_factory=list)
    sweeps: list[int] = field(default_factory=list)
    seconds: list[list[float]] = field(default_factory=list)
    errors: dict[str, list[float]] = field(default_factory=lambda: {name: [] for name in ERRORS})

    def at(self, cap: int) -> tuple[float, int, dict[str, float]] | None:
        """Median time [s], sweeps and errors with so many sweeps allowed; where it ended before, those of its end."""
        index = len([c for c in self.caps if c <= cap]) - 1
        if index < 0:
            return None
        errors = {name: values[index] for name, values in self.errors.items()}
        return self.times()[index], self.sweeps[index], errors

    def times(self) -> list[float]:
        """Median time at each number of sweeps [s], without the first call, which recorded its launch."""
        return [statistics.median(seconds[1:] or seconds) for seconds in self.seconds]


class Solver:
    """A setting on a state, ready to be solved again and again."""

    def __init__(self, state: State, setting: Setting, references: Sequence[Reference]) -> None:
        """Find the contacts; everything but the solve is done here."""
        options: dict[str, Any] = {"schedule": setting.schedule}
        self.setting, self.references = setting, references
        self.base = setting.config(tolerance=TOLERANCES[setting.dtype])
        self.sim = state.simulation(setting.dtype, config=self.base, **options)
        self.learned: Any = None
        if setting.start == "cnn":
            import torch

            from pipeline.starts.registry import maker

            torch.set_num_threads(1)
            self.learned = maker("cnn")(self.sim)
        self.sim.collide(DT)
        self.slots, _ = contact_slots(self.sim.contacts)
        self.impulse = self.sim.contacts.numpy("impulse")
        self.start = self.impulse[self.slots].copy()
        if setting.start == "zero":
            self.start[:] = 0.0
        if references:
            # contacts at the edge of the speculative margin may be there in one precision only
            keys = self.sim.contacts.numpy("key")[self.slots]
            _, self.own, self.its = np.intersect1d(keys, references[0].key, return_indices=True)

    def solve(self, config: dc.SolverConfig) -> float:
        """Wall time of one solve from the start [s]."""
        self.impulse[self.slots] = self.start
        if self.learned is None:
            return timing.seconds(lambda: self.sim.solve(config))
        if self.sim.config != config:  # the network's driver takes the simulation's
            self.sim.config = config
            self.learned.solve()  # records its launches
            self.impulse[self.slots] = self.start
        return timing.seconds(self.learned.solve)

    def errors(self) -> dict[str, float]:
        """Of the solve that was made last; NaN without a reference."""
        stats = self.sim.stats
        found = {"residual": float(stats.numpy("residual")[0]), "change": float(stats.numpy("change")[0])}
        if not self.references:
            return found | {"velocity": float("nan"), "impulse": float("nan")}
        solved = self.sim.motion.numpy("solved")[: self.sim.model.body_count, :3].astype(np.float64)
        far = [mass_norm(self.sim, solved - reference.velocity) for reference in self.references]
        reference = self.references[int(np.argmin(far))]
        impulse = np.zeros_like(reference.impulse)
        impulse[self.its] = self.impulse[self.slots][self.own]
        size = float(np.linalg.norm(reference.impulse))
        return found | {
            "velocity": min(far) / max(reference.moved, 1e-300),
            "impulse": float(np.linalg.norm(impulse - reference.impulse)) / max(size, 1e-300),
        }


def curves(
    case: Case, state: State, references: Sequence[Reference], chosen: list[Setting], advance: Callable[[str], None]
) -> dict[Setting, Curve]:
    """The curve of each setting on a state, in rounds over all of them.

    Args:
        case: how far and how often.
        state: the recorded state.
        references: those that were reached.
        chosen: the settings.
        advance: called with a setting's label when its first round is over.
    """
    solvers: dict[Setting, Solver] = {}
    found: dict[Setting, Curve] = {}
    for setting in chosen:
        solver, curve = Solver(state, setting, references), Curve()
        solver.solve(replace(solver.base, max_sweeps=2))  # loads and records
        slow = setting.start == "cnn" or setting.schedule == "color"
        for cap in [cap for cap in case.ladder if not slow or cap <= SLOW_CAP]:
            config = replace(solver.base, max_sweeps=cap)
            curve.caps.append(cap)
            curve.seconds.append([solver.solve(config) for _ in range(2 if slow else 1)])
            curve.sweeps.append(int(solver.sim.stats.numpy("sweeps")[0]))
            for name, value in solver.errors().items():
                curve.errors[name].append(max(value, FLOOR) if np.isfinite(value) else float("nan"))
            if curve.sweeps[-1] < cap:
                break
        found[setting] = curve
        if not slow:
            solvers[setting] = solver
        advance(setting.label)
    for _ in range(3 * case.repeats):
        for setting, solver in solvers.items():
            curve = found[setting]
            solver.solve(replace(solver.base, max_sweeps=1))  # its memory is in the cache again
            for cap, times in zip(curve.caps, curve.seconds, strict=True):
                if len(times) <= case.repeats or min(times) < SHORT:
                    times.append(solver.solve(replace(solver.base, max_sweeps=cap)))
    return found


def default_points(states: list[State], references: list[list[Reference]], repeats: int) -> Iterator[dict[str, Any]]:
    """The default solver on each state, at its own tolerance: seconds, sweeps and errors."""
    for state, found in zip(states, references, strict=True):
        solver = Solver(state, DEFAULT, found)
        seconds = [solver.solve(dc.SolverConfig()) for _ in range(1 + 3 * repeats)][1:]
        sweeps = int(solver.sim.stats.numpy("sweeps")[0])
        yield {"seconds": statistics.median(seconds), "sweeps": sweeps, "errors": solver.errors()}
