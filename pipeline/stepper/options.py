"""Options of the training of a stepper; this module loads without torch."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from dc_kernels.model.settings import Count, Limits, NotNegative, Positive, Seed, Settings
from pipeline.networks.registry import OptimizerName, ScheduleName, Share, Width


@dataclass(frozen=True, kw_only=True)
class StepperTrainOptions(Settings):
    """Options of a training of a stepper; the defaults are those of the weights in the package."""

    data: tuple[Path, ...] = ()
    """Data sets, of ``deep-contact generate``, that differ only in worlds and seeds; none: thesis worlds, which are
    made in the folder data of ``out``."""
    worlds: Count = 112
    """Worlds of the data set that is made if none is given [1]."""
    out: Path = Path("out/stepper")
    """Output folder, made if missing; files of an earlier training are replaced."""
    resume: bool = False
    """Continue the training in that folder, also to more steps than first planned."""
    steps: Count = 6000
    """Steps of the training [1]."""
    batch_size: Count = 16
    """Worlds of a step [1]."""
    every: tuple[Count, ...] = (1, 1, 1, 2, 5, 10)
    """Numbers of recorded steps from t to t + dt, of which one is drawn for each training step: 1 2 5 10 are dt 0.01
    to 0.1 s [1]."""
    rollout: tuple[Count, ...] = (1, 1, 1, 3)
    """Numbers of time steps that the network rolls out, used in turn by the training steps; gradients pass through
    all of them [1]."""
    loss: Literal["bodies", "grid"] = "bodies"
    """Loss: the error at the bodies, through the gather, or at the nodes, as in the draft."""
    width: Width = 1.0
    """Factor on the filters and hidden units of a network of the theses [1]."""
    dropout: Share = 0.4
    """Dropout rate of ConvFC and Peak [1]."""
    sizes: tuple[tuple[str, str], ...] = ()
    """Fields of the network's own configuration: name and value, as in --sizes rounds 6 hidden 8."""
    nodes: Annotated[int, Limits(least=8, below=2**16)] = 61
    """Nodes along the longer side of the grid of a network of the theses [1]."""
    optimizer: OptimizerName = "adamw"
    """SGD with Nesterov momentum 0.9, as in the draft, or AdamW."""
    schedule: ScheduleName = "onecycle"
    """Learning rate over the steps: constant, divided by (1 + decay steps), or one cycle."""
    rate: Positive = 2e-3
    """Learning rate, of "onecycle" the highest."""
    decay: NotNegative = 1e-6
    """Rate at which the schedule "decay" falls [1/step]."""
    weight_decay: NotNegative = 1e-4
    """Weight decay of the optimiser [1]."""
    clip: Positive = 1.0
    """Gradient norm to which larger gradients are clipped [1]."""
    validation: Annotated[float, Limits(above=0.0, below=1.0)] = 0.1
    """Share of the worlds used for validation [1]."""
    seed: Seed = 0
    """Seed of the weights, of the worlds and times of each step, and of the data set that is made [1]."""
    threads: Count = 1
    """Number of threads of torch; only one gives equal bits from run to run [1]."""
    log_every: Count = 50
    """Steps between two lines of the log [1]."""
    save_every: Count = 500
    """Steps between two validations and saves [1]."""

    def check(self) -> None:
        """Raise a ``ValueError`` where there is nothing to draw from."""
        for name in ("every", "rollout"):
            if not getattr(self, name):
                raise ValueError(f"{name} is (); it must hold numbers >= 1")
