"""A network in the solver's place beside the solver: errors over time, piles at rest, and what a step takes.

Held-out thesis worlds are stepped from the moment in which their discs meet, by the network of the package with some
sweeps of the solver after it, and by the solver with some sweeps or to its tolerance. The truth is the solver in
float64 at 1e-8 with the time step of each. One picture holds it all, time of a step against error and overlap.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

import dc_kernels as dc
from bench import timing

SUMMARY = "a network in the solver's place: errors, overlap, energy and creep over time, time of a step, beside sweeps"
KEYS = (
    "projected_overlap_mean_mm",
    "velocity_error",
    "error_50",
    "overlap_mean_mm",
    "us_per_step",
    "over_solver_10_sweeps",
)
THREADS = 1

FIGURE = Path(__file__).resolve().parents[1] / "results" / "stepper.png"
QUICK_FIGURE = Path("out/stepper/stepper.png")
STEPS = (1, 10, 50, 250)
"""Steps after which errors are taken [1]."""
TIME_STEPS = (0.01, 0.02, 0.05, 0.1)
MEETING = {100: 0.6, 1_000: 0.9}
"""Time from which on many discs of a world touch, by their number [s]."""
LATE = 50
"""Last steps, over which bodies creep [1]."""
BATCH = 64
REFERENCE = {"tolerance": 1e-8, "relative_tolerance": 0.0, "max_sweeps": 20_000, "min_sweeps": 1}


@dataclass(frozen=True)
class Method:
    """What makes the velocities of a step."""

    name: str
    """For people."""
    sweeps: int | None = None
    """Sweeps of the solver; None: to its tolerance."""
    project: int | Literal["tolerance"] | None = None
    """Sweeps after the network; None: no network."""
    correction: Literal["ngs", "none"] = "ngs"
    """Phase that mends overlaps."""

    @property
    def key(self) -> str:
        """Name in the record."""
        if self.project is not None:
            return f"{self.project}" if self.correction == "ngs" else "draft"
        return "solver" if self.sweeps is None else f"solver_{self.sweeps}"

    def config(self) -> dc.SolverConfig:
        """Settings of the simulation."""
        most = {} if self.sweeps is None else {"max_sweeps": self.sweeps, "min_sweeps": 1}
        return dc.SolverConfig.preset("accurate", position_correction=self.correction, **most)  # type: ignore[arg-type]


METHODS = (
    Method("network, no position phase", project=0, correction="none"),
    Method("network", project=0),
    Method("network, 3 sweeps", project=3),
    Method("network, 10 sweeps", project=10),
    *(Method(f"solver, {n} sweep{'s' * (n > 1)}", n) for n in (1, 3, 10, 30)),
    Method("solver, to 1e-4 N s"),
)


class Network:
    """The network of the package, read once."""

    def __init__(self) -> None:
        from pipeline.networks.checkpoint import load_checkpoint
        from pipeline.stepper.registry import PRETRAINED

        self.model, self.manifest = load_checkpoint(PRETRAINED)

    def of(self, sim: dc.Simulation, method: Method) -> Any:
        """Return the stepper of a simulation; None: its own solver."""
        from pipeline.stepper.choice import StepperOptions
        from pipeline.stepper.solve import NetworkStepper

        if method.project is None:
            return None
        return NetworkStepper(sim, self.model, self.manifest, StepperOptions(project=method.project))


class Worlds:
    """Held-out worlds at the moment in which their discs meet."""

    def __init__(self, worlds: int, bodies: int) -> None:
        """Let them fall."""
        self.worlds, self.bodies = worlds, bodies
        sim = self.make(dc.SolverConfig.preset("accurate"))
        sim.run(round(MEETING[bodies] / 0.01), 0.01)
        names = ("position", "angle", "velocity", "angular_velocity")
        self.state = {name: sim.state.numpy(name).copy() for name in names}

    def make(self, config: dc.SolverConfig, dtype: Literal["float32", "float64"] = "float32") -> dc.Simulation:
        """Make the worlds as they are built."""
        from pipeline.options import RunOptions
        from pipeline.scenes import Thesis
        from pipeline.seeds import HELD_OUT_SEED

        run = RunOptions(worlds=self.worlds, seed=HELD_OUT_SEED, dtype=dtype)
        return run.simulation(Thesis(bodies=self.bodies), config)

    def begin(self, config: dc.SolverConfig, dtype: Literal["float32", "float64"] = "float32") -> dc.Simulation:
        """Make the worlds as they are when their discs meet."""
        sim = self.make(config, dtype)
        for name, values in self.state.items():
            sim.state.assign(name, values.astype(dtype))
        return sim


def motion(sim: dc.Simulation) -> tuple[np.ndarray, np.ndarray]:
    """Return positions and velocities of all bodies, in float64."""
    return sim.state.numpy("position").astype(float), sim.state.numpy("velocity").astype(float)


def track(sim: dc.Simulation, dt: float, steps: tuple[int, ...], stepper: Any = None) -> dict[int, Any]:
    """Return positions and velocities after some numbers of steps, and ``LATE`` steps before the last of these."""
    wanted = sorted({*steps, steps[-1] - LATE} - {0}) if steps[-1] > LATE else sorted(steps)
    found, done = {}, 0
    for step in wanted:
        sim.run(step - done, dt, stepper=stepper)
        found[step], done = motion(sim), step
    return found


def errors_over_time(worlds: Worlds, network: Network, dt: float, steps: tuple[int, ...]) -> dict[str, Any]:
    """Step the worlds by all methods; returns for each its errors to the truth, and its piles at the end."""
    truth = track(worlds.begin(dc.SolverConfig.preset("accurate", **REFERENCE), "float64"), dt, steps)  # type: ignore
    last, found = steps[-1], {}
    for method in METHODS:
        timing.progress(f"{worlds.bodies} discs, dt {dt:g}: {method.name}")
        sim = worlds.begin(method.config())
        stepper = network.of(sim, method)
        at = track(sim, dt, steps, stepper)
        kinetic = float(dc.kinetic_energy(sim).mean())
        overlap = dc.overlap(sim, recollide=dt)
        row = {
            "position_mm": [1e3 * _distance(at[n][0], truth[n][0]) for n in steps],
            "velocity": [_distance(at[n][1], truth[n][1]) for n in steps],
            "overlap_mean_mm": 1e3 * float(overlap.mean.mean()),
            "overlap_max_mm": 1e3 * float(overlap.max.max()),
            "kinetic_J": kinetic,
            "height_mm": 1e3 * float((at[last][0] - truth[last][0])[:, 1].mean()),
            "creep_mm_s": 1e3 * _distance(at[last][0], at[last - LATE][0]) / (LATE * dt) if last > LATE else None,
        }
        if stepper is not None:
            row["counts"] = dict(stepper.counts)
        found[method.key] = row
    return found


def _distance(a: np.ndarray, b: np.ndarray) -> float:
    """Return the mean distance of rows."""
    return float(np.linalg.norm(a - b, axis=1).mean())


def one_step(worlds: Worlds, network: Network, dt: float, steps: int, every: int) -> float:
    """Return the error of velocities after one step of the network alone, over that of no contacts at all.

    The states are those of the truth; errors are roots of the mean square over all of them.
    """
    truth = worlds.begin(dc.SolverConfig.preset("accurate", **REFERENCE), "float64")  # type: ignore[arg-type]
    probe = worlds.make(METHODS[1].config())
    stepper = network.of(probe, METHODS[1])
    square = np.zeros(2)
    for step in range(steps):
        if step % every == 0:
            for name in worlds.state:
                probe.state.assign(name, truth.state.numpy(name).astype(np.float32))
            probe.collide(dt)
            stepper.solve()
        truth.step(dt)
        if step % every == 0:
            after = motion(truth)[1]
            for k, values in enumerate((probe.motion.numpy("solved"), probe.motion.numpy("predicted"))):
                moving = probe.model.numpy("inv_mass") > 0
                square[k] += ((values[: len(after), :2] - after)[moving] ** 2).sum()
    return float(np.sqrt(square[0] / square[1]))


def step_times(network: Network, batch: int, rounds: int) -> dict[str, float]:
    """Return what a step of a world takes in a batch, of each method [us]."""
    worlds = Worlds(batch, 100)
    calls = {}
    for method in METHODS:
        sim = worlds.begin(method.config())
        stepper = network.of(sim, method)
        calls[method.key] = lambda sim=sim, stepper=stepper: sim.run(5, 0.01, stepper=stepper)
    times = timing.medians(timing.interleave(calls, rounds))
    return {name: 1e6 * seconds / (5 * batch) for name, seconds in times.items()}


def measure(quick: bool) -> dict[str, Any]:
    """All tables and the picture; ``--quick`` takes two worlds, two time steps, 60 steps and smaller batches."""
    import torch

    torch.set_num_threads(THREADS)
    network = Network()
    steps = (1, 10, 50, 60) if quick else STEPS
    dts = (0.01, 0.1) if quick else TIME_STEPS
    worlds = Worlds(2 if quick else 10, 100)
    values: dict[str, Any] = {"worlds": worlds.worlds, "steps": steps, "dts": dts}
    values["runs"] = {f"{dt:g}": errors_over_time(worlds, network, dt, steps) for dt in dts}
    values["velocity_error"] = {
        f"{dt:g}": one_step(worlds, network, dt, 40 if quick else 200, 10 if quick else 5) for dt in dts
    }
    large = Worlds(1, 1_000)
    values["large_steps"] = (1, 10) if quick else (1, 10, 50, 100)
    values["large"] = errors_over_time(large, network, 0.01, values["large_steps"])
    timing.progress("time of a step")
    values["us_per_step"] = {
        "1": step_times(network, 1, 3 if quick else 7),
        str(BATCH): step_times(network, 8 if quick else BATCH, 1 if quick else 3),
    }
    at = steps.index(50)
    keys = [method.key for method in METHODS]
    values["error_50"] = {dt: {k: run[k]["position_mm"][at] for k in keys} for dt, run in values["runs"].items()}
    values["overlap_mean_mm"] = {dt: {k: run[k]["overlap_mean_mm"] for k in keys} for dt, run in values["runs"].items()}
    values["projected_overlap_mean_mm"] = values["runs"]["0.01"]["3"]["overlap_mean_mm"]
    values["over_solver_10_sweeps"] = {
        batch: {k: times[k] / times["solver_10"] for k in keys} for batch, times in values["us_per_step"].items()
    }
    path = QUICK_FIGURE if quick else FIGURE
    draw(values, path)
    values["figure"] = path.name
    return values


def draw(values: dict[str, Any], path: Path) -> None:
    """Draw time of a step against error after 50 steps and overlap at the end, for each time step."""
    from pipeline.plots import style

    times = values["us_per_step"][str(BATCH)]
    panels = (
        ("error_50", "distance to the truth\nafter 50 steps [mm]"),
        ("overlap_mean_mm", "mean overlap\nat the end [mm]"),
    )
    dts = list(values["runs"])
    with style.figure(
        3.4 * len(dts) + 1.0, 6.4, f"A network in the solver's place, 100 discs, {BATCH} worlds at once"
    ) as figure:
        axes = figure.subplots(2, len(dts), sharex=True, sharey="row", squeeze=False)
        for row, (key, label) in zip(axes, panels, strict=True):
            for axis, dt in zip(row, dts, strict=True):
                _curve(axis, times, values[key][dt], network=False)
                _curve(axis, times, values[key][dt], network=True)
                axis.set(xscale="log", yscale="log")
                if key == "error_50":
                    axis.set_title(f"dt {dt} s")
                else:
                    axis.set_xlabel("time of a step [us]")
            row[0].set_ylabel(label)
        figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=9)
    style.save_figure(figure, path)


def _curve(axis: Any, times: dict[str, float], errors: dict[str, float], network: bool) -> None:
    """Draw the methods with a network, or those without."""
    from pipeline.plots import style

    chosen = [method for method in METHODS if (method.project is not None) == network and method.correction == "ngs"]
    points = [(times[m.key], max(errors[m.key], 1e-4)) for m in chosen]
    look = {"color": style.BLUE, "marker": "D"} if network else {"color": style.VERMILION, "marker": "s"}
    name = "network, then 0, 3, 10 sweeps" if network else "solver: 1, 3, 10, 30 sweeps, to its tolerance"
    axis.plot(*zip(*points, strict=True), linestyle="-", linewidth=1.0, markersize=5, label=name, **look)


def report(values: dict[str, Any]) -> str:
    """Tables for people."""
    lines = []
    header = (
        "method",
        *(f"{n} steps [mm]" for n in values["steps"]),
        "overlap",
        "max [mm]",
        "kinetic [J]",
        "height",
        "creep",
    )
    for dt, run in values["runs"].items():
        rows = [(method.name, *_cells(run[method.key])) for method in METHODS]
        lines += [f"dt {dt} s, {values['worlds']} worlds of 100 discs", timing.table(header, rows), ""]
    header = ("method", *(f"{n} steps [mm]" for n in values["large_steps"]), *header[-5:])
    rows = [(method.name, *_cells(values["large"][method.key])) for method in METHODS]
    lines += ["dt 0.01 s, one world of 1 000 discs", timing.table(header, rows), ""]
    times = values["us_per_step"]
    rows = [(method.name, *(times[batch][method.key] for batch in times)) for method in METHODS]
    lines += [timing.table(("method", *(f"us a step, batch {batch}" for batch in times)), rows), ""]
    errors = ", ".join(f"dt {dt} {value:.3f}" for dt, value in values["velocity_error"].items())
    lines.append(f"one step of the network, error of the velocities over that of no contacts at all: {errors}")
    return "\n".join(lines)


def _cells(row: dict[str, Any]) -> tuple[Any, ...]:
    """Return the cells of a method's row."""
    names = ("overlap_mean_mm", "overlap_max_mm", "kinetic_J", "height_mm", "creep_mm_s")
    return (*row["position_mm"], *(row[name] for name in names))
