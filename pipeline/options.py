"""Options that the commands share: how contacts are solved, what is run and on what."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Literal

import dc_kernels as dc
from dc_kernels.model.config import Tolerance
from dc_kernels.model.settings import Count, Positive, Seed, Settings, Whole
from pipeline.scenes import Scene

DEFAULT = dc.SolverConfig()


@dataclass(frozen=True, kw_only=True)
class SolverOptions(Settings):
    """Options of the contact solver."""

    method: Literal["pgs", "jacobi"] = DEFAULT.method
    """Gauss-Seidel in colour order, or Jacobi with mass splitting."""
    acceleration: Literal["none", "sor", "aitken", "nncg", "adaptive"] = DEFAULT.acceleration
    """How the method is accelerated."""
    tolerance: Tolerance = DEFAULT.tolerance
    """Impulse change of a sweep, or residual, at which a solve ends [N s or 1]."""
    relative_tolerance: Tolerance = DEFAULT.relative_tolerance
    """Impulse change at which a solve ends, in units of what a typical weight gives in a step, where smaller [1]."""
    stop: Literal["change", "residual"] = DEFAULT.stop
    """What the tolerance is compared with."""
    max_sweeps: Whole = DEFAULT.max_sweeps
    """Sweeps after which a solve ends unconverged [1]."""
    min_sweeps: Whole = DEFAULT.min_sweeps
    """Least number of sweeps of a solve [1]."""
    position_correction: Literal["ngs", "baumgarte", "none"] = DEFAULT.position_correction
    """How overlaps are mended: in a phase of its own after the velocities, by a velocity bias, or not at all."""
    sleep: bool = DEFAULT.sleep
    """Let bodies fall asleep that have come to rest with all that they touch."""

    def config(self, history: bool = False) -> dc.SolverConfig:
        """Make the settings of the kernels; with ``history`` they keep the impulse change of every sweep."""
        return dc.SolverConfig(**asdict(self), history=history)


@dataclass(frozen=True, kw_only=True)
class RunOptions(Settings):
    """Options of a run: its worlds, its time step, and what it computes on."""

    worlds: Count = 1
    """Worlds, of the seeds seed, seed + 1, ... [1]."""
    seed: Seed = 0
    """Seed of the first world [1]."""
    dt: Positive = 0.01
    """Time step [s]."""
    threads: Count = 1
    """Threads that share the worlds [1]."""
    dtype: Literal["float32", "float64"] = "float32"
    """Scalar type of all arrays."""
    backend: Literal["warp", "numpy", "taichi"] = "warp"
    """Whose kernels are run: Warp's, Taichi's, or those of the slow NumPy oracle."""
    device: str = "cpu"
    """Device of the Warp kernels: cpu, or cuda:0, ..."""

    def simulation(self, scene: Scene, config: dc.SolverConfig) -> dc.Simulation:
        """Make the scene's worlds, ready to step.

        Raises:
            ValueError: for an option out of its range.
        """
        arrays = scene.build(self.worlds, self.seed).finalize(self.dtype, device=self.device, backend=self.backend)
        return dc.Simulation(*arrays, config=config, threads=self.threads)
