"""Options of a training of networks that read images; this module loads without torch."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from dc_kernels.model.settings import Count, Limits, NotNegative, Positive, Seed, Settings, Whole
from pipeline.networks.registry import DecodeName, OptimizerName, ScheduleName, Share, Width

LossName = Literal["grid_mse", "grid_mae", "contact_mse", "energy", "sweeps"]
CACHED = ("impulse_n", "impulse_t")


@dataclass(frozen=True, kw_only=True)
class TrainOptions(Settings):
    """Options of a training: the data, the network, the loss, the steps, and the files."""

    data: Path | tuple[Path, ...] = Path("out/data")
    """Data set, of ``deep-contact generate``: a folder, or several that differ only in worlds and seeds."""
    out: Path = Path("out/train")
    """Output folder, made if missing; files of an earlier training are replaced."""
    resume: bool = False
    """Continue the training in that folder, also to more epochs than first planned."""
    epochs: Count = 10
    """Number of passes over all training states [1]."""
    batch_size: Count = 32
    """States of a step, of all processes together [1]."""
    width: Width = 1.0
    """Factor on the network's filters and hidden units [1]."""
    dropout: Share = 0.4
    """Dropout rate of ConvFC and Peak [1]."""
    sizes: tuple[tuple[str, str], ...] = ()
    """Fields of the network's own configuration: name and value, as in --sizes hidden 32 kernel 5."""
    nodes: Annotated[int, Limits(least=8, below=2**16)] | None = None
    """Nodes along the longer side of the grid; None: as in the network's setup [1]."""
    h: Positive | None = None
    """Support radius of the splat; None: 2 spacings [m]."""
    bins: Count = 1
    """Number of bins of normal directions, over the half circle, that separate contacts [1]."""
    walls: NotNegative = 100.0
    """Mass of the nodes that walls cover [kg]."""
    cached: bool = False
    """Let the network also read the impulses of the previous step."""
    loss: LossName = "grid_mse"
    """Loss: the error at the nodes, at the contacts, its energy, or the error after sweeps of the solver."""
    sweeps: Whole = 20
    """Sweeps of the loss "sweeps" [1]."""
    scaling: Literal["channel", "none"] = "channel"
    """Divide inputs and outputs by their RMS in the training states, or leave them in their units."""
    decode: DecodeName | None = None
    """Gather at the contacts: bilinear, or reverse SPH; None: as in the network's setup."""
    optimizer: OptimizerName | None = None
    """SGD with Nesterov momentum 0.9, or AdamW; None: as in the network's setup."""
    schedule: ScheduleName | None = None
    """Learning rate over the steps: constant, divided by (1 + decay steps), or one cycle; None: as in the network's
    setup."""
    rate: Positive | None = None
    """Learning rate, of "onecycle" the highest; None: as in the network's setup."""
    find_rate: bool = False
    """Find the learning rate by a short training in which it grows (Smith 2017)."""
    decay: NotNegative = 1e-6
    """Rate at which the schedule "decay" falls [1/step]."""
    weight_decay: NotNegative = 0.0
    """Weight decay of the optimiser [1]."""
    clip: Positive | None = None
    """Gradient norm to which larger gradients are clipped [1]."""
    validation: Annotated[float, Limits(above=0.0, below=1.0)] = 0.1
    """Share of the worlds used for validation [1]."""
    stride: Count = 1
    """Use every so many-th step of a world [1]."""
    seed: Seed = 0
    """Seed of the weights, the order of the states, and dropped values [1]."""
    threads: Count = 1
    """Number of threads of torch and of the kernels; only one gives equal bits from run to run [1]."""
    workers: Whole = 0
    """Processes that read the data [1]."""
    log_every: Count = 20
    """Steps between two lines of the log [1]."""
    save_every: Count = 500
    """Steps between two saves, in addition to those at the end of each epoch [1]."""

    def check(self) -> None:
        """Raise a ``ValueError`` for options that exclude each other."""
        if self.find_rate and self.rate is not None:
            raise ValueError(f"rate is {self.rate}, and find_rate asks for another one; give one of the two")
