"""Piles at rest, run on in closed loop by every setting and by the peers: penetration and drift against wall time.

All begin from the same recorded state, ours with the impulses cached in it, as a run in progress would have them.
Penetration and drift are measured in one way for all: our narrowphase in float64 on the positions.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

import dc_kernels as dc
from bench import timing
from bench.cases import DT
from bench.error_time.scenes import Case, State
from bench.peers.engines import ENGINES
from bench.peers.gauge import Gauge
from dc_kernels.model.config import ACCELERATIONS

ERRORS = ("penetration", "penetration_max", "drift")
"""Mean overlap of the touching pairs and the largest [m], means and maximum over four times of the run; mean
displacement of a body in its last second, per second [m/s]."""
SAMPLES = 4
STEPS = (0.02, 0.005, 0.0025)  # time steps beside DT [s]
PLAIN = {("acceleration", "none"): "plain", ("stop", "change"): "accurate"}  # words for settings
SHORT = 0.5  # [s]: shorter runs are timed three times


@dataclass(frozen=True)
class Run:
    """One engine with its settings."""

    engine: str = "deep-contact"
    dt: float = DT
    """Time step [s]."""
    iterations: tuple[int, ...] = ()
    """Of a peer."""
    changed: dict[str, Any] = field(default_factory=dict)
    """Settings of ours that are not the default."""

    @property
    def label(self) -> str:
        """What tells it from the default."""
        parts = ["/".join(map(str, self.iterations))] if self.iterations else []
        named = {"acceleration": "{}", "max_sweeps": "{} sweeps", "tolerance": "to {:g}", "position_correction": "{}"}
        parts += [
            PLAIN.get((name, value)) or named[name].format(value)
            for name, value in self.changed.items()
            if not (name == "tolerance" and value == 0.0)
        ]
        parts += [f"dt {self.dt:g}"] if self.dt != DT else []
        return " ".join(parts) or "default"

    def fields(self) -> dict[str, Any]:
        """For a line of JSON."""
        told: dict[str, Any] = {"kind": "run", "engine": self.engine, "setting": self.label, "dt": self.dt}
        if self.iterations:
            told["iterations"] = list(self.iterations)
        return told | self.changed


def runs(quick: bool) -> list[Run]:
    """One setting varied at a time, and number of sweeps or iterations with the time step; the default is first."""
    found = [Run(), Run(changed={"stop": "change"})]
    found += [Run(changed={"tolerance": tolerance}) for tolerance in ((1e-2,) if quick else (1e-2, 1e-3, 1e-5))]
    found += [Run(changed={"max_sweeps": n, "tolerance": 0.0}) for n in ((10,) if quick else (3, 10, 30, 100))]
    if not quick:
        usual = dc.SolverConfig()
        found += [Run(changed={"acceleration": name}) for name in ACCELERATIONS if name != usual.acceleration]
        found += [Run(changed={"position_correction": name}) for name in ("baumgarte", "none")]
        found += [Run(dt=dt) for dt in STEPS]
        found += [Run(dt=dt, changed={"max_sweeps": 10, "tolerance": 0.0}) for dt in STEPS[1:]]
    for engine, (_, choices) in ENGINES.items():
        found += [Run(engine, iterations=n) for n in (choices[1:2] if quick else choices)]
        if not quick:
            found += [Run(engine, dt, choices[1]) for dt in STEPS[1:]]
    return found


class _Ours:
    """A simulation as a world of ``peers.engines``."""

    def __init__(self, state: State, run: Run) -> None:
        self.sim = state.simulation(config=dc.SolverConfig(**run.changed))
        self.sim.warmup()

    def run(self, steps: int, dt: float) -> None:
        self.sim.run(steps, dt)

    def places(self) -> tuple[np.ndarray, np.ndarray]:
        return self.sim.state.numpy("position").copy(), self.sim.state.numpy("angle").copy()


def points(case: Case, state: State, chosen: list[Run], advance: Callable[[str], None]) -> list[dict[str, Any]]:
    """A point for each run: wall time per simulated second, ``ERRORS``, and what it was."""
    gauge = Gauge(*state.scene.build(1, state.seed).finalize(dtype="float64"))
    dynamic = gauge.model.numpy("body_type") == dc.BodyType.DYNAMIC
    started: tuple[Any, ...] | None = None
    found = []
    for run in chosen:
        times: list[float] = []
        point: dict[str, Any] = {}
        while not times or (len(times) < 3 and times[0] < SHORT):
            if run.engine == "deep-contact":
                world: Any = _Ours(state, run)
            else:
                if started is None:
                    exact = state.simulation("float64")
                    started = (exact.model, exact.state, exact.joints)
                world = ENGINES[run.engine][0](*started, *run.iterations)
            seconds, samples = _timed(world, case.seconds, run.dt)
            if not times:
                point = _errors(gauge, dynamic, samples)
            times.append(seconds / case.seconds)
        found.append({**run.fields(), "seconds": statistics.median(times), **point})
        advance(run.label)
    return found


def _timed(world: Any, duration: float, dt: float) -> tuple[float, list[tuple[np.ndarray, np.ndarray]]]:
    """Wall time [s], and places at ``SAMPLES`` times up to the end and one second before it, which is first."""
    ends = sorted({round(duration * (i + 1) / SAMPLES, 9) for i in range(SAMPLES)} | {round(duration - 1.0, 9)})
    total, now = 0.0, 0
    samples = {}
    for end in ends:
        steps = round(end / dt)
        total += timing.seconds(lambda n=steps - now: world.run(n, dt))  # type: ignore[misc]
        now, samples[end] = steps, world.places()
    before = samples.pop(round(duration - 1.0, 9)) if round(duration - 1.0, 9) not in _quarters(duration) else None
    return total, [before or samples[round(duration - 1.0, 9)], *samples.values()]


def _quarters(duration: float) -> set[float]:
    return {round(duration * (i + 1) / SAMPLES, 9) for i in range(SAMPLES)}


def _errors(gauge: Gauge, dynamic: np.ndarray, samples: list[tuple[np.ndarray, np.ndarray]]) -> dict[str, float | None]:
    (before, _), *rest = samples
    if not all(np.isfinite(part).all() for sample in rest for part in sample):
        return dict.fromkeys(ERRORS)
    overlaps = [gauge.overlaps(*sample) for sample in rest]
    moved = np.linalg.norm(rest[-1][0][dynamic] - before[dynamic], axis=1)
    return {
        "penetration": float(np.mean([o.mean() if len(o) else 0.0 for o in overlaps])),
        "penetration_max": float(max(o.max(initial=0.0) for o in overlaps)),
        "drift": float(moved.mean()),
    }
