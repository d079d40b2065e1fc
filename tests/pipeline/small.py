"""What several tests of training share: a small scene, a short training, a pile."""

from __future__ import annotations

from pathlib import Path

import dc_kernels as dc
from pipeline.scenes import Thesis
from pipeline.training.options import TrainOptions

SCENE = Thesis(bodies=6)
PNG = b"\x89PNG"


def options(data: Path, out: Path, **changes) -> TrainOptions:
    """A training of a second or two."""
    small = {"width": 0.25, "nodes": 17, "stride": 8, "batch_size": 8, "epochs": 2, "log_every": 2}
    return TrainOptions(data=data, out=out, **{**small, **changes})


def settled(scene, worlds: int = 3, steps: int = 60, dtype: str = "float32") -> dc.Simulation:
    """A simulation between collide and solve."""
    sim = dc.Simulation(*scene.build(worlds, 0).finalize(dtype))
    sim.run(steps, 0.01)
    sim.collide(0.01)
    return sim
