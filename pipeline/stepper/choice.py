"""Options of a run with a stepper; this module loads without torch."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from dc_kernels.model.settings import Limits, Settings, Whole


@dataclass(frozen=True, kw_only=True)
class StepperOptions(Settings):
    """Options of what makes the velocities of a step."""

    stepper: Literal["solver", "network"] = "solver"
    """Who makes the velocities of a step: the contact solver, or a network in its place."""
    weights: Path | None = None
    """File of the network of --stepper network, .safetensors, by train-stepper; None: the one in the package."""
    project: Whole | Literal["tolerance"] = 0
    """Sweeps of the solver on the network's velocities; 0: none, as in Wu's draft; tolerance: to its own [1]."""
    energy: Annotated[float, Limits(least=1.0, size=1e6)] = 1.02
    """Kinetic energy, over that without contacts, from which on a world falls back to the solver for the step [1]."""
