"""Training a network of the theses: its options, and what each network is trained on and how unless told otherwise.

``grid_training`` does the work; this module loads without torch. What a training writes into its folder:

- ``best.safetensors``, ``last.safetensors``: the network with the least validation loss, and the last one, each with
  its manifest (``checkpoint``);
- ``training.safetensors``: what ``--resume`` continues from, bit for bit on one thread;
- ``metrics.jsonl`` and ``tensorboard/``: loss, rate, gradient and validation by step;
- ``train.json``, ``curves.png``, ``predictions.png``, with the rate finder ``rates.png``: summary and pictures.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

NetworkName = Literal["convfc", "pressure", "peak", "unet"]
LossName = Literal["grid_mse", "grid_mae", "contact_mse", "energy", "sweeps"]
OptimizerName = Literal["sgd", "adamw"]
ScheduleName = Literal["constant", "decay", "onecycle"]
DecodeName = Literal["bilinear", "reverse"]

BODIES = ("mass", "velocity_x", "velocity_y", "omega")
NORMALS = ("normal_x", "normal_y")
CACHED = ("impulse_n", "impulse_t")


@dataclass(frozen=True, kw_only=True)
class Setup:
    """What a thesis says of its network's input and training."""

    bodies: tuple[str, ...] = BODIES
    """Channels of bodies."""
    contacts: tuple[str, ...] = NORMALS
    """Channels of contacts."""
    nodes: int = 61
    """Nodes along each side of the box [1]."""
    decode: DecodeName = "reverse"
    """Way back to the contacts: bilinear (Wu), or reverse SPH (Engedal)."""
    optimizer: OptimizerName = "adamw"
    schedule: ScheduleName = "onecycle"
    rate: float = 1e-3


SETUPS: dict[NetworkName, Setup] = {
    "convfc": Setup(contacts=("normal_x",), nodes=41, decode="bilinear", optimizer="sgd", schedule="decay", rate=0.01),
    "pressure": Setup(),
    "peak": Setup(),
    "unet": Setup(bodies=("velocity_x", "velocity_y", "omega", "mass", "inertia"), contacts=()),
}


@dataclass(frozen=True, kw_only=True)
class TrainOptions:
    """What is trained on, how, and what is written."""

    data: Path = Path("out/data")
    """Data set, of ``deep-contact generate``."""
    out: Path = Path("out/train")
    """Folder of the files, made if missing; files of an earlier training are replaced."""
    resume: bool = False
    """Continue the training in that folder."""
    epochs: int = 10
    """Times that all training states are seen [1]."""
    batch_size: int = 32
    """States of a step, of all processes together [1]."""
    width: float = 1.0
    """Factor on the network's filters and hidden units [1]."""
    dropout: float = 0.4
    """Share of values that ConvFC and Peak drop in training [1]."""
    nodes: int | None = None
    """Nodes along the longer side of the grid; None: as the thesis has it [1]."""
    h: float | None = None
    """Support radius of the splat; None: 2 spacings [m]."""
    bins: int = 1
    """Parts of the half circle of normal directions that contacts are kept apart in [1]."""
    walls: float = 100.0
    """Mass of the nodes that walls cover [kg]."""
    cached: bool = False
    """Let the network also read the impulses of the step before."""
    loss: LossName = "grid_mse"
    """What is minimized: see losses.py."""
    sweeps: int = 20
    """Sweeps of the loss "sweeps" [1]."""
    scaling: Literal["channel", "none"] = "channel"
    """Divide channels and answers by their RMS in the training states, or leave them in their units."""
    decode: DecodeName | None = None
    """Way back to the contacts: bilinear, or reverse SPH; None: as the thesis has it."""
    optimizer: OptimizerName | None = None
    """SGD with Nesterov momentum 0.9, or AdamW; None: SGD for convfc, else AdamW."""
    schedule: ScheduleName | None = None
    """The rate over the steps: constant, / (1 + decay steps), or one cycle; None: decay for convfc, else one cycle."""
    rate: float | None = None
    """Learning rate, of "onecycle" the highest; None: 0.01 for convfc, else 0.001."""
    find_rate: bool = False
    """Find the learning rate by a short training in which it grows (Smith 2017)."""
    decay: float = 1e-6
    """Of the schedule "decay" [1/step]."""
    weight_decay: float = 0.0
    """Of the optimiser."""
    clip: float | None = None
    """Longest gradient, to which longer ones are cut [1]."""
    validation: float = 0.1
    """Share of the worlds that is kept for validation [1]."""
    stride: int = 1
    """Every so many steps of a world are used [1]."""
    seed: int = 0
    """Of the weights, the order of the states, and dropped values [1]."""
    threads: int = 1
    """Threads of torch and of the kernels; bits are the same from run to run on one [1]."""
    workers: int = 0
    """Processes that read the data [1]."""
    log_every: int = 20
    """Steps between two lines of the log [1]."""
    save_every: int = 500
    """Steps between two saves, beside those at the end of each epoch [1]."""

    def check(self) -> None:
        """Raise a ``ValueError`` that names the option which is out of its range."""
        least = {"bins": 1, "epochs": 1, "batch_size": 1, "stride": 1, "threads": 1, "log_every": 1, "save_every": 1}
        for name, low in {**least, "seed": 0, "workers": 0, "sweeps": 0}.items():
            if getattr(self, name) < low:
                raise ValueError(f"{name} is {getattr(self, name)}; it must be >= {low}")
        for name in ("decay", "weight_decay", "walls"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise ValueError(f"{name} is {getattr(self, name)}; it must be finite and >= 0")
        if self.nodes is not None and self.nodes < 8:
            raise ValueError(f"nodes is {self.nodes}; it must be >= 8")
        if self.clip is not None and not self.clip > 0.0:
            raise ValueError(f"clip is {self.clip}; it must be > 0")
        if not 0.0 < self.validation < 1.0:
            raise ValueError(f"validation is {self.validation}; it must lie in (0, 1)")
        if self.find_rate and self.rate is not None:
            raise ValueError(f"rate is {self.rate}, and find_rate asks for another one; give one of the two")


def train(network: NetworkName, options: TrainOptions | None = None, progress: bool = True) -> dict[str, Any]:
    """Train a network; Ctrl-C ends it early, with whole files to resume from.

    Under ``torchrun`` each process takes its share of every batch; the first one prints and writes.

    Args:
        network: convfc, pressure, peak or unet.
        options: what is trained on, how, and what is written.
        progress: show a bar on stderr.

    Returns:
        The content of ``train.json``.

    Raises:
        ValueError: for an option out of its range, a data set that is none or too small, states of held-out seeds, or
            a loss that is not finite, naming the step.
        ImportError: naming the extra, without torch, h5py or matplotlib.
    """
    options = options or TrainOptions()
    options.check()
    if network not in SETUPS:
        raise ValueError(f"network is {network!r}; it must be one of {tuple(SETUPS)}")
    from pipeline.training.grid import train_grid

    return train_grid(network, options, progress)


def describe_training(summary: dict[str, Any]) -> str:
    """What a training did, in a few lines."""
    metrics, choices = summary["metrics"], summary["choices"]
    lines = [
        f"{summary['network']}: {summary['parameters']:,} weights, {summary['epochs']} epochs, "
        f"{summary['steps']} steps, {summary['training_s']:.0f} s"
        + ("" if summary["complete"] else "; interrupted, --resume goes on"),
        f"{choices['optimizer']}, schedule {choices['schedule']}, rate {choices['rate']:.3g}",
    ]
    if metrics:
        loss, best, zero = metrics["loss"], summary["best_loss"], metrics["loss_zero"]
        lines.append(f"validation loss: last {loss:.4g}, best {best:.4g}, that of zero impulses {zero:.4g}")
        lines += [
            f"squared error of {name} impulses, over that of zero: {metrics[name]:.3g}; cached impulses "
            f"{metrics[f'{name}_cache']:.3g}; the truth by the grid {metrics[f'{name}_grid']:.2g}"
            for name in ("normal", "tangential")
        ]
    lines.append(f"{summary['out']}: {', '.join(summary['files'])}")
    return "\n".join(lines)
