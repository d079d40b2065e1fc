"""A StepNet in lanes, which makes the velocities of a step where the simulation has bodies and contacts, without torch.

network = StepNetworkInLanes(sim, grid, walls, layers)
sim.collide(dt)
velocity = network(np.ones(worlds, bool))  # and its impulses in sim.contacts.impulse
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels.grid.grid import Grid
from dc_kernels.learn.groups import STEP_NETWORK, Asking
from dc_kernels.learn.layers import padded
from dc_kernels.learn.step_channels import BodyWork, ContactWork
from dc_kernels.learn.step_layers import StepLayers, pack, scratch_size
from dc_kernels.model.dtypes import aligned_zeros
from dc_kernels.runtime.backends import host_threads, kernel_file, make_kernels
from dc_kernels.runtime.memory import check_memory
from dc_kernels.runtime.program import Kernel, Program
from dc_kernels.runtime.threads import shard_worlds
from dc_kernels.simulation import Simulation


class StepNetworkInLanes:
    """Answers worlds after ``collide``, one by one on the simulation's threads: bits depend on the world alone.

    Attributes:
        velocity: velocities and spins of all bodies, those of the worlds asked for by the network, (N, 3) [m/s, rad/s].
    """

    def __init__(self, sim: Simulation, grid: Grid, walls: np.ndarray, layers: StepLayers) -> None:
        """Allocate what the kernels need.

        Args:
            sim: on the CPU.
            grid: of the image.
            walls: 1 at the nodes that static shapes cover, (W, rows, columns).
            layers: the network.

        Raises:
            ValueError: for a trunk of too many scales.
            MemoryError: naming maps that would not fit.
        """
        self.sim, self.grid, self.layers = sim, grid, layers
        self._walls = walls
        self._weight = pack(layers).astype(sim.dtype)
        self._shards = shard_worlds(sim.model.world_count, host_threads(sim.backend, sim.threads))
        size = len(self._shards), scratch_size(layers, *grid.shape)
        what = f"the maps of {size[0]} thread(s) on a grid of {grid.rows} x {grid.columns}"
        check_memory(what, float(sim.dtype.itemsize) * size[0] * size[1])
        self._scratch = aligned_zeros(size, sim.dtype)
        self._width = np.array(layers.widths, np.int32)
        self._bound = -1
        with sim.calls:
            self._keep_bound()

    def load(self, layers: StepLayers) -> None:
        """Take other weights of the same shapes."""
        self._weight[...] = pack(layers)

    def set_walls(self, walls: np.ndarray) -> None:
        """Take other walls, (W, rows, columns)."""
        with self.sim.calls:
            self._walls = walls
            self._keep_bound()
            self.asking.assign("wall", walls.astype(self.sim.dtype))

    def __call__(self, asked: np.ndarray) -> np.ndarray:
        """Make the velocities of worlds, and write the impulses of their contacts.

        Args:
            asked: which worlds, bool (W,).

        Returns:
            ``velocity``, in which the next call writes.
        """
        with self.sim.calls:
            self._keep_bound()
            self._asked[:] = asked
            self._run()
            return self.velocity

    def _keep_bound(self) -> None:
        """Bind to the simulation's present arrays where these are others than at the last time."""
        sim = self.sim
        if self._bound == sim.layout_version:
            return
        self._bound = sim.layout_version
        backend, dtype = sim.backend, sim.dtype.name
        near, kept = (padded(self.layers.sizes[name]) for name in ("near", "kept"))
        rows, columns = self.grid.shape
        sizes = {"world": sim.model.world_count, "body": sim.model.body_count, "contact": sim.contacts.sizes["contact"]}
        sizes |= {"grid row": rows, "grid column": columns}
        sizes |= {"body column": BodyWork.SEEN + near + kept, "contact column": ContactWork.HIDDEN + kept}
        asking = Asking(sizes, sim.dtype, backend=backend)
        self._asked, self.velocity = asking.numpy("asked"), asking.numpy("velocity")
        asking.numpy("shard")[[first for first, _ in self._shards]] = np.arange(len(self._shards))
        asking.assign("wall", self._walls.astype(sim.dtype))
        groups = kernel_file(backend, "groups")
        given: dict[str, Any] = {
            **self.layers.sizes,
            "weight": self._weight,
            "width": self._width,
            "scratch": self._scratch,
            "spacing": self.grid.spacing,
            "origin_x": self.grid.origin[0],
            "origin_y": self.grid.origin[1],
            "rows": rows,
            "columns": columns,
        }
        values = {
            **sim.values,
            "network": groups.group("step_network", dtype, STEP_NETWORK, given),
            "asking": groups.array_group(asking, "asking"),
        }
        kernel = Kernel(make_kernels(backend, "learn.step_network", dtype)["answer_worlds"], values)
        self.network, self.asking = values["network"], asking
        self._run = Program([kernel], sim.model.world_count, backend=backend, threads=sim.threads)
