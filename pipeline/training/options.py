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
    """Data set, of ``deep-contact generate``: a folder, or several that differ in worlds and seeds alone."""
    out: Path = Path("out/train")
    """Folder of the files, made if missing; files of an earlier training are replaced."""
    resume: bool = False
    """Continue the training in that folder, also to more epochs than it was to have."""
    epochs: Count = 10
    """Times that all training states are seen [1]."""
    batch_size: Count = 32
    """States of a step, of all processes together [1]."""
    width: Width = 1.0
    """Factor on the network's filters and hidden units [1]."""
    dropout: Share = 0.4
    """Share of values that ConvFC and Peak drop in training [1]."""
    sizes: tuple[tuple[str, str], ...] = ()
    """Fields of the network's own configuration: name and value, as in --sizes hidden 32 kernel 5."""
    nodes: Annotated[int, Limits(least=8, below=2**16)] | None = None
    """Nodes along the longer side of the grid; None: as the network's setup has it [1]."""
    h: Positive | None = None
    """Support radius of the splat; None: 2 spacings [m]."""
    bins: Count = 1
    """Parts of the half circle of normal directions that contacts are kept apart in [1]."""
    walls: NotNegative = 100.0
    """Mass of the nodes that walls cover [kg]."""
    cached: bool = False
    """Let the network also read the impulses of the step before."""
    loss: LossName = "grid_mse"
    """What is minimized: at the nodes, at the contacts, as energy, or after sweeps of the solver."""
    sweeps: Whole = 20
    """Sweeps of the loss "sweeps" [1]."""
    scaling: Literal["channel", "none"] = "channel"
    """Divide channels and answers by their RMS in the training states, or leave them in their units."""
    decode: DecodeName | None = None
    """Way back to the contacts: bilinear, or reverse SPH; None: as the network's setup has it."""
    optimizer: OptimizerName | None = None
    """SGD with Nesterov momentum 0.9, or AdamW; None: as the network's setup has it."""
    schedule: ScheduleName | None = None
    """The rate over the steps: constant, / (1 + decay steps), or one cycle; None: as the network's setup has it."""
    rate: Positive | None = None
    """Learning rate, of "onecycle" the highest; None: as the network's setup has it."""
    find_rate: bool = False
    """Find the learning rate by a short training in which it grows (Smith 2017)."""
    decay: NotNegative = 1e-6
    """Rate at which the schedule "decay" falls [1/step]."""
    weight_decay: NotNegative = 0.0
    """Weight decay of the optimiser [1]."""
    clip: Positive | None = None
    """Longest gradient, to which longer ones are cut [1]."""
    validation: Annotated[float, Limits(above=0.0, below=1.0)] = 0.1
    """Share of the worlds that is kept for validation [1]."""
    stride: Count = 1
    """Steps of a world from one that is used to the next [1]."""
    seed: Seed = 0
    """Seed of the weights, the order of the states, and dropped values [1]."""
    threads: Count = 1
    """Threads of torch and of the kernels; bits are the same from run to run on one [1]."""
    workers: Whole = 0
    """Processes that read the data [1]."""
    log_every: Count = 20
    """Steps between two lines of the log [1]."""
    save_every: Count = 500
    """Steps between two saves, beside those at the end of each epoch [1]."""

    def check(self) -> None:
        """Raise a ``ValueError`` for options that exclude each other."""
        if self.find_rate and self.rate is not None:
            raise ValueError(f"rate is {self.rate}, and find_rate asks for another one; give one of the two")
