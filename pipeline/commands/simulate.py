"""Commands that run one scene: ``simulate`` and ``explain``."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from dc_kernels.model.settings import Whole
from pipeline.commands.common import Common, SceneOption
from pipeline.options import RunOptions, SolverOptions
from pipeline.process import torch_threads
from pipeline.run.simulate import Output, simulate
from pipeline.run.summary import describe
from pipeline.scenes import Scene
from pipeline.starts.start import step
from pipeline.stepper.choice import StepperOptions
from pipeline.stepper.registry import DEFAULT_START, solve_maker


@dataclass(frozen=True, kw_only=True)
class Simulate(Common):
    """Run a scene; write trajectory.h5, summary.json, summary.png and, on request, a video."""

    scene: SceneOption
    """What to run; each scene has options of its own."""
    run: RunOptions = field(default_factory=RunOptions)
    solver: SolverOptions = field(default_factory=SolverOptions)
    output: Output = field(default_factory=Output)
    stepping: StepperOptions = field(default_factory=StepperOptions)

    def __call__(self) -> dict[str, Any]:
        summary, _ = simulate(
            self.scene, self.run, self.solver, self.output, progress=not self.json, stepping=self.stepping
        )
        if not self.json:
            print(describe(summary))
        return summary


@dataclass(frozen=True, kw_only=True)
class Explain(Common):
    """Say what runs for a scene, what is skipped, and why."""

    scene: SceneOption
    """What to explain; each scene has options of its own."""
    run: RunOptions = field(default_factory=RunOptions)
    solver: SolverOptions = field(default_factory=SolverOptions)
    start: str = DEFAULT_START
    """Start of the contact solver, as for simulate; a network says how often it is called, and why not."""
    stepping: StepperOptions = field(default_factory=StepperOptions)
    steps: Whole = 100
    """Steps that are run first where a network is the start or the stepper: its calls depend on them [1]."""

    def __call__(self) -> dict[str, Any]:
        text = explain(self.scene, self.run, self.solver, self.start, self.steps, self.stepping)
        if not self.json:
            print(text)
        return {"scene": self.scene.name, "explain": text}


def explain(
    scene: Scene,
    run: RunOptions,
    solver: SolverOptions,
    start: str,
    steps: int,
    stepping: StepperOptions | None = None,
) -> str:
    """Say what runs for a scene as it stands and, with a network as start or stepper, what that did in the first steps.

    Raises:
        ValueError: for an option out of its range, an unknown start, or a network that cannot step the scene.
        OSError: a network's file cannot be read.
    """
    make = solve_maker(stepping or StepperOptions(), start, run.seed)
    sim = run.simulation(scene, solver.config())
    made = make(sim)
    if not made.report().is_network:
        return sim.explain()
    with torch_threads(run.threads):
        for _ in range(steps):
            step(made, run.dt)
    return f"{sim.explain()}\n{made.report().text}"
