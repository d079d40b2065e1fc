"""The four networks of 2018, trained on a small data set: what the bench of learning compares with."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench import timing

NAMES = ("convfc", "pressure", "peak", "unet")
WORLDS, EPOCHS, STRIDE = 60, 6, 5
WORLDS_QUICK, EPOCHS_QUICK = 8, 1
WIDTH = {"convfc": 0.25, "peak": 0.5}  # of their 33 and 4 million weights small data need few


@dataclass(frozen=True)
class Network:
    """A trained network and how it was trained."""

    path: Path
    summary: dict[str, Any]


def train_all(folder: Path, quick: bool) -> dict[str, Network]:
    """Train each network in a folder; seeds below those of the tests, the theses' margins.

    Args:
        folder: for data and networks.
        quick: fewer worlds and one epoch.

    Returns:
        Networks by name.
    """
    import dc_kernels as dc
    from pipeline.contactnet.rollouts import THESES_SETTINGS
    from pipeline.data.generate import generate
    from pipeline.data.recipe import GenerateOptions, Recipe
    from pipeline.training.grid import train_grid_network
    from pipeline.training.options import TrainOptions

    data = folder / "data"
    worlds = WORLDS_QUICK if quick else WORLDS
    options = GenerateOptions(worlds=worlds, shard_worlds=worlds // 4)
    generate(Recipe(options=options, solver=dc.SolverConfig(**THESES_SETTINGS)), data, threads=1, progress=False)  # type: ignore[arg-type]
    networks = {}
    for name in NAMES:
        timing.progress(f"training {name}")
        training = TrainOptions(
            data=data,
            out=folder / name,
            epochs=EPOCHS_QUICK if quick else EPOCHS,
            stride=STRIDE,
            width=WIDTH.get(name, 1.0),
        )
        summary = train_grid_network(name, training, progress=False)  # type: ignore[arg-type]
        kept = ("parameters", "steps", "training_s", "best_loss")
        networks[name] = Network(folder / name / "best.safetensors", {key: summary[key] for key in kept})
    return networks
