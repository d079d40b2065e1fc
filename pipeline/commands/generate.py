"""The command ``generate``."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dc_kernels.model.config import SolverConfig
from dc_kernels.model.settings import Whole
from pipeline.commands.common import Common, SceneOption
from pipeline.data.generate import describe, generate
from pipeline.data.packing import Compression
from pipeline.data.recipe import GenerateOptions, Recipe
from pipeline.scenes import Thesis


@dataclass(frozen=True, kw_only=True)
class Generate(Common):
    """Make a data set of worlds on all cores, each state with its label, or continue one that was interrupted."""

    scene: SceneOption = field(default_factory=Thesis)
    """What stands in the worlds; each scene has options of its own."""
    options: GenerateOptions = field(default_factory=GenerateOptions)
    solver: SolverConfig = field(default_factory=lambda: SolverConfig.preset("accurate"))
    config: Path | None = None
    """TOML file of options, with tables scene, ranges and solver: its values replace the defaults."""
    out: Path = Path("out/data")
    """Folder of the shards and of index.h5."""
    compression: Compression = "zstd"
    """Compression of the shards: zstd, which HDF5 reads with the package hdf5plugin, or gzip, slower and a little
    larger."""
    threads: Whole = 0
    """Number of shards made at once; 0: one for each core [1]."""
    scheduler: str | None = None
    """Address of a Dask scheduler, tcp://..., whose workers make the shards instead."""

    def __call__(self) -> dict[str, Any]:
        recipe = Recipe(scene=self.scene, options=self.options, solver=self.solver)
        summary = generate(
            recipe, self.out, self.threads, self.scheduler, progress=not self.json, compression=self.compression
        )
        if not self.json:
            print(describe(summary))
        return summary
