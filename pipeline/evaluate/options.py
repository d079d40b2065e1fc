"""Worlds and settings of the thesis protocol and of the evaluation.

Worlds, seeds and settings are those of the theses: 100 discs that fall into a box, 250 steps of 0.01 s, sweeps until
the largest impulse change is below 1e-4 N s, at most 1000; all worlds in one batch. The theses' engine left overlaps of
5 mm alone and looked no further ahead than a step's own motion; so does the protocol, unlike the solver's defaults.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import dc_kernels as dc
from dc_kernels.model.config import Tolerance
from dc_kernels.model.settings import Count, NotNegative, Positive, Seed, Settings
from pipeline.options import RunOptions, SolverOptions
from pipeline.scenes import THESIS_BODIES, Thesis
from pipeline.seeds import HELD_OUT_SEED

Acceleration = Literal["none", "sor", "aitken", "nncg", "adaptive"]
Loop = Literal["closed", "open"]


@dataclass(frozen=True, kw_only=True)
class ProtocolOptions(Settings):
    """Options of the thesis protocol; the defaults are the theses'."""

    starts: tuple[str, ...] = ("none", "builtin", "copy")
    """Starts: none, builtin, random, bad, copy, copyN (rounded to N decimals), grid, grid-bilinear (copy
    through splat and gather); cnn, cnn-start (the pretrained network, in mid-solve too or at the start only), or a
    trained network: PATH.safetensors or LABEL=PATH.safetensors."""
    accelerations: tuple[Acceleration, ...] = ("none",)
    """Accelerations of the solver; each runs with every start."""
    method: Literal["pgs", "jacobi"] = "pgs"
    """Gauss-Seidel in colour order, or Jacobi with mass splitting."""
    worlds: Count = 10
    """Number of worlds, with the seeds seed, seed + 1, ... [1]."""
    seed: Seed = HELD_OUT_SEED
    """Seed of the first world [1]."""
    bodies: Count = THESIS_BODIES
    """Discs in each world; the box grows with them [1]."""
    steps: Count = 250
    """Steps [1]."""
    dt: Positive = 0.01
    """Time step [s]."""
    tolerance: Tolerance = 1e-4
    """Impulse change of a sweep at which a solve ends [N s]."""
    max_sweeps: Count = 1000
    """Largest number of sweeps of a solve [1]."""
    slop: NotNegative = 5e-3
    """Overlap that is not corrected [diameters]."""
    speculative: NotNegative = 0.0
    """Gap below which a contact is made even if it does not close within the step [diameters]."""
    threads: Count = 1
    """Number of threads that share the worlds [1]."""
    dtype: Literal["float32", "float64"] = "float32"
    """Scalar type of all arrays."""
    history: bool = True
    """Whether the impulse change of every sweep is recorded and plotted; --no-history leaves both out."""

    def check(self) -> None:
        """Raise a ``ValueError`` where nothing is to be run."""
        if not self.starts or not self.accelerations:
            raise ValueError("starts and accelerations must each name at least one")

    def simulation(self, acceleration: Acceleration) -> dc.Simulation:
        """Make the worlds, ready to step; their kernels are compiled."""
        solver = SolverOptions(
            method=self.method,
            acceleration=acceleration,
            tolerance=self.tolerance,
            max_sweeps=self.max_sweeps,
            min_sweeps=1,
        )
        run = RunOptions(worlds=self.worlds, seed=self.seed, dt=self.dt, threads=self.threads, dtype=self.dtype)
        config = replace(
            solver.config(self.history),
            slop=self.slop,
            speculative=self.speculative,
            speculative_max=self.speculative,
        )
        sim = run.simulation(Thesis(bodies=self.bodies), config)
        sim.warmup()
        return sim


@dataclass(frozen=True, kw_only=True)
class EvaluationOptions(ProtocolOptions):
    """Options of the comparison of all starts and networks on the same held-out worlds."""

    starts: tuple[str, ...] = ("none", "builtin", "copy", "copy2", "copy0", "grid", "grid-bilinear", "random", "bad")
    """Starts: none, builtin, random, bad, copy, copyN (rounded to N decimals), grid, grid-bilinear (copy
    through splat and gather); cnn, cnn-start (the pretrained network, in mid-solve too or at the start only), or a
    trained network: PATH.safetensors or LABEL=PATH.safetensors."""
    loops: tuple[Loop, ...] = ("closed", "open")
    """Trajectory of the states: each start's own (closed), or that of Builtin (open)."""

    def check(self) -> None:
        """Raise a ``ValueError`` where nothing is to be run."""
        super().check()
        if not self.loops:
            raise ValueError("loops must name at least one")
