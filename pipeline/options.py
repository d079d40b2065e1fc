"""Options that the commands share: how contacts are solved, what is run and on what."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Literal

import dc_kernels as dc
from dc_kernels.model.config import Tolerance
from dc_kernels.model.settings import Count, Positive, Seed, Settings, Whole
from pipeline.scenes import Scene


@dataclass(frozen=True, kw_only=True)
class SolverOptions(Settings):
    """Options of the contact solver."""

    preset: Literal["default", "strict", "accurate", "fast", "thesis"] = "default"
    """Named settings, which the options below change: default ends a solve when the bodies' motion hardly changes,
    strict also requires this of each contact in collisions, accurate ends at an impulse change of 1e-4 N s, fast
    after 10 sweeps; thesis is the theses' protocol."""
    method: Literal["pgs", "jacobi"] | None = None
    """Gauss-Seidel in colour order, or Jacobi with mass splitting; None, here and below: as in the preset."""
    acceleration: Literal["none", "sor", "aitken", "nncg", "adaptive"] | None = None
    """Acceleration of the sweeps."""
    tolerance: Tolerance | None = None
    """Impulse change of a sweep, or residual, at which a solve ends [N s or 1]."""
    relative_tolerance: Tolerance | None = None
    """Impulse change at which a solve ends, relative to the impulse of a typical weight in a step, if that is
    smaller [1]."""
    stop: Literal["change", "residual", "motion"] | None = None
    """Criterion that ends a solve: the tolerance of the impulse change or of the residual, or the change of the
    bodies' motion."""
    max_sweeps: Whole | None = None
    """Largest number of sweeps of a solve [1]."""
    min_sweeps: Whole | None = None
    """Smallest number of sweeps of a solve [1]."""
    position_correction: Literal["ngs", "baumgarte", "none"] | None = None
    """How overlaps are corrected: in a separate phase after the velocities, by a velocity bias, or not at all."""
    sleep: bool = False
    """Let bodies fall asleep when they and all bodies that they touch have come to rest."""

    def named(self) -> dict[str, Any]:
        """The options by name, with what the preset stands for."""
        config = self.config()
        stop, tolerance, relative = config.ends_at
        values = {name: getattr(config, name) for name in asdict(self)}
        return values | {"preset": self.preset, "stop": stop, "tolerance": tolerance, "relative_tolerance": relative}

    def config(self, history: bool = False) -> dc.SolverConfig:
        """Make the settings of the kernels; with ``history`` they keep the impulse change of every sweep."""
        changed = {name: value for name, value in asdict(self).items() if value is not None}
        return dc.SolverConfig.preset(changed.pop("preset"), **changed, history=history)


@dataclass(frozen=True, kw_only=True)
class RunOptions(Settings):
    """Options of a run: its worlds, its time step, threads, backend and device."""

    worlds: Count = 1
    """Number of worlds, with the seeds seed, seed + 1, ... [1]."""
    seed: Seed = 0
    """Seed of the first world [1]."""
    dt: Positive = 0.01
    """Time step [s]."""
    threads: Count = 1
    """Number of threads that share the worlds [1]."""
    dtype: Literal["float32", "float64"] = "float32"
    """Scalar type of all arrays."""
    backend: Literal["warp", "numpy", "taichi"] = "warp"
    """Backend of the kernels: Warp, Taichi, or the slow NumPy oracle."""
    device: str = "cpu"
    """Device of the Warp kernels: cpu, or cuda:0, ..."""

    def simulation(self, scene: Scene, config: dc.SolverConfig) -> dc.Simulation:
        """Make the scene's worlds, ready to step.

        Raises:
            ValueError: for an option out of its range.
        """
        arrays = scene.build(self.worlds, self.seed).finalize(self.dtype, device=self.device, backend=self.backend)
        return dc.Simulation(*arrays, config=config, threads=self.threads)
