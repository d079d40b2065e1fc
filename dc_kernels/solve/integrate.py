"""Semi-implicit Euler (Wu 2018, chapter 2.1): velocities before the contacts, positions after them."""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels.model.arrays import ArrayGroup, Model
from dc_kernels.model.fields import MOTION
from dc_kernels.model.room import world_of
from dc_kernels.runtime.capture import recording, refuse_recording
from dc_kernels.runtime.inputs import check_time_step

PADDING = 8  # bodies between the padding bodies of two shards: more than a cache line


class Motion(ArrayGroup):
    """Velocities and displacements of the step in flight (``model.fields.MOTION``)."""

    table = MOTION


class Integrator:
    """Velocities and displacements of a step; its kernels are ``predict``, ``displace`` and ``commit``.

    Behind the bodies lies a padding body for each shard of worlds, which empty solver lanes write to.
    """

    def __init__(self, model: Model, shards: int, method: str, weight: np.ndarray) -> None:
        """Allocate.

        Args:
            model: whose bodies move.
            shards: parts that its worlds are divided into.
            method: of the solver.
            weight: of a typical body in each world, (W,) [N].
        """
        bodies = model.body_count + PADDING * shards
        sizes = {**model.sizes, "body+1": bodies, "body sum": bodies if method == "jacobi" else 1}
        motion = Motion(sizes, model.dtype, model.device, model.backend)
        motion.fill("weight", weight)
        self.adopt(motion)

    def adopt(self, motion: Motion) -> None:
        """Take over the motion of the same bodies."""
        self.motion = motion
        self._step_dt = motion.numpy("step_dt")  # making a view takes longer than a small world's kernels
        # of one world it is written in a third of the time that NumPy takes
        self._only: Any = memoryview(self._step_dt) if len(self._step_dt) == 1 else None  # type: ignore[arg-type]
        self._on_cpu = motion.device == "cpu"
        self._checked: float | None = None  # the last time step that was found right
        self._checked_each: tuple[np.dtype, tuple[int, ...], bytes] | None = None  # those of each world that were

    def weigh(self, model: Model) -> None:
        """Weigh the typical bodies of a model that has changed."""
        self.motion.assign("weight", typical_weight(model))

    def set_time_step(self, dt: float | np.ndarray, parts: int = 1) -> None:
        """Write the time step [s] of all worlds, or of each, (W,), or one of so many equal parts of it.

        Raises:
            ValueError: for one that is not finite and positive.
            RuntimeError: for one of each world in a recording.
        """
        if parts > 1:
            check_time_step(dt, len(self._step_dt), self.motion.dtype)
            dt = dt / parts
        if self._on_cpu and isinstance(dt, float) and dt == self._checked and not recording():
            if self._only is None:
                self._step_dt.fill(dt)
            else:
                self._only[0] = dt
            return
        each = (dt.dtype, dt.shape, dt.tobytes()) if type(dt) is np.ndarray else None
        if (each is None or each != self._checked_each) and (not isinstance(dt, float) or dt != self._checked):
            check_time_step(dt, len(self._step_dt), self.motion.dtype)
            self._checked, self._checked_each = dt if isinstance(dt, float) else None, each
        if recording():
            if np.ndim(dt):
                refuse_recording("a time step of each world", "a graph holds one of all")
            self.motion.step_dt.fill_(float(dt))  # a replay may find that of another call
        elif self.motion.device == "cpu":
            self._step_dt[...] = dt
        else:
            self.motion.assign("step_dt", np.broadcast_to(dt, self._step_dt.shape))

    def provide(self, method: str) -> bool:
        """Allocate what a method needs and has not got yet; whether there was any."""
        missing = method == "jacobi" and self.motion.sizes["body sum"] == 1
        if missing:
            self.motion.reallocate(("summed",), **{"body sum": self.motion.sizes["body+1"]})
        return missing


def typical_weight(model: Model) -> np.ndarray:
    """Gravity times the geometric mean of the dynamic bodies' masses, (W,) [N]; 0 in a world without any.

    The geometric mean follows light bodies among heavy ones, and not to where a heavy one's round-off lies above it.
    """
    worlds = world_of(model.numpy("body_start"))
    dynamic = model.numpy("inv_mass") > 0
    mass = model.numpy("mass").astype(np.float64)[dynamic]
    count = np.bincount(worlds[dynamic], minlength=model.world_count)
    total = np.bincount(worlds[dynamic], weights=np.log(mass), minlength=model.world_count)
    mean = np.where(count > 0, np.exp(total / np.maximum(count, 1)), 0.0)
    return (mean * np.linalg.norm(model.numpy("gravity").astype(np.float64), axis=1)).astype(model.dtype)
