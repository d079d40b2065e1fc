"""Start the contact solver from a network that answers images: bodies and contacts -> grid -> network -> contacts.

images, network and solver share their memory: nothing is copied on the way unless some worlds have no contacts, which
the network then does not see.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dc_kernels.grid.grid import Grid
from dc_kernels.grid.images import Images
from dc_kernels.measure import contact_slots
from dc_kernels.runtime.optional import require

if TYPE_CHECKING:
    from dc_kernels.simulation import Simulation


class GridStart:
    """A start strategy for ``sim.step(dt, start=...)``: what a network answers to the images of a simulation.

    The images are those that the network was trained on, of the same grid, channels, kernel and bins. A world whose
    answer holds NaN or inf at a contact starts from its cached impulses instead.

    Attributes:
        images: the images that the network reads.
        calls: times that it ran.
        skipped: worlds and steps without contacts, which it did not run for.
        dropped: worlds and steps whose answer was not finite.
    """

    def __init__(self, model: Any, manifest: Mapping[str, Any], sim: Simulation) -> None:
        """Allocate the images of a network.

        Args:
            model: maps (B, channels, rows, columns) to (B, 2 bins, rows, columns), in float32.
            manifest: of its checkpoint: "grid", "images", "decode".
            sim: of float32, on the CPU.

        Raises:
            ValueError: for a simulation of another dtype, or a manifest of a network that reads no images.
        """
        if sim.dtype != np.float32:
            raise ValueError(f"sim.dtype is {sim.dtype.name}; networks answer in float32")
        for name in ("grid", "images", "decode"):
            if name not in manifest:
                raise ValueError(f"the manifest has no {name!r}: the network was not trained on images of a simulation")
        self.torch = require("torch", "pipeline")
        self.model = model.eval()
        self.sim = sim
        grid = manifest["grid"]
        self.images = Images(sim, Grid(**{**grid, "origin": tuple(grid["origin"])}), **manifest["images"])
        self.reverse = bool(manifest["decode"]["reverse"])
        self.calls = self.skipped = self.dropped = 0
        self._output: Any = None

    def __call__(self, sim: Simulation) -> None:
        """Write the start impulses of all worlds with contacts.

        Raises:
            ValueError: for another simulation, or an answer of another shape.
        """
        if sim is not self.sim:
            raise ValueError("the network was bound to another simulation")
        busy = np.flatnonzero(sim.contacts.numpy("contact_count"))
        self.skipped += self.images.worlds - len(busy)
        if not len(busy):
            return
        self.calls += 1
        self.images.splat()
        pixels = self.images.tensor()
        with self.torch.inference_mode():
            if len(busy) == len(pixels):
                output = self.model(pixels)
            else:
                answers = self.model(pixels[busy])
                if self._output is None:
                    self._output = answers.new_zeros((len(pixels), *answers.shape[1:]))
                output = self._output
                output[busy] = answers
        impulse = sim.contacts.numpy("impulse")
        slots, world = contact_slots(sim.contacts)
        cached = impulse[slots]
        self.images.start_from(output, reverse=self.reverse)
        lost = np.unique(world[~np.isfinite(impulse[slots]).all(axis=1)])
        if len(lost):
            self.dropped += len(lost)
            back = np.isin(world, lost)
            impulse[slots[back]] = cached[back]


def grid_starter(network: Path | str | Any, sim: Simulation, manifest: Mapping[str, Any] | None = None) -> GridStart:
    """The start strategy of a trained network.

    Args:
        network: the path of its checkpoint, or the network itself.
        sim: that it is to start.
        manifest: of a network that is given itself.

    Raises:
        OSError: the checkpoint cannot be read.
        ValueError: it is no checkpoint, or of a network that reads no images; see also ``GridStart``.
    """
    if not isinstance(network, str | Path):
        if manifest is None:
            raise ValueError("manifest is None; a network that is given itself needs one")
        return GridStart(network, manifest, sim)
    from pipeline.networks.checkpoint import load_checkpoint

    return GridStart(*load_checkpoint(network), sim)
