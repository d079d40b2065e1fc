"""Starts of the contact solver from a network that answers images: bodies and contacts -> grid -> network -> contacts.

Images, network and solver share their memory: nothing is copied on the way unless some worlds have no contacts, which
the network then does not see.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

import dc_kernels as dc
from dc_kernels.measure import contact_slots
from dc_kernels.runtime.imports import require
from pipeline.starts.impulses import ImpulseStart
from pipeline.starts.start import Report


class GridNetworkStart(ImpulseStart):
    """Starts from what a network answers to the images of a simulation.

    The images are those that the network was trained on, of the same grid, channels, kernel and bins. A world whose
    answer holds NaN or inf at a contact starts from its cached impulses instead.

    Attributes:
        images: the images that the network reads.
        calls: worlds and steps that it answered.
        skipped: worlds and steps without contacts, for which it did not run.
        dropped: worlds and steps whose answer was not finite.
    """

    def __init__(self, sim: dc.Simulation, model: Any, manifest: Mapping[str, Any]) -> None:
        """Allocate the images of a network.

        Args:
            sim: of float32, on the CPU.
            model: maps (B, channels, rows, columns) to (B, 2 bins, rows, columns), in float32.
            manifest: of its checkpoint: "images", "decode".

        Raises:
            ValueError: for a simulation of another dtype, or a manifest of a network that reads none or other images.
        """
        super().__init__(sim)
        if sim.dtype != np.float32:
            raise ValueError(f"sim.dtype is {sim.dtype.name}; networks answer in float32")
        for name in ("images", "decode"):
            if name not in manifest:
                raise ValueError(f"the manifest has no {name!r}: the network was not trained on images of a simulation")
        self.torch = require("torch", "pipeline")
        self.model = model.eval()
        spec, decode = dc.ImageSpec.from_dict(manifest["images"]), manifest["decode"]
        if not isinstance(decode, Mapping) or "reverse" not in decode:
            raise ValueError(f"the manifest's decode is {decode!r}; it must say whether the way back is 'reverse'")
        shape = (len(spec.channels), *spec.grid.shape)
        if getattr(model, "shape", shape) != shape:
            raise ValueError(f"the manifest's images are {shape}, channels first; the network reads {model.shape}")
        self.images = dc.Images(sim, spec)
        self.reverse = bool(decode["reverse"])
        self.calls = self.skipped = self.dropped = 0
        self._output: Any = None

    def write(self) -> None:
        """Write the start impulses of all worlds with contacts.

        Raises:
            ValueError: for an answer of another shape.
        """
        busy = np.flatnonzero(self.sim.contacts.numpy("contact_count"))
        self.skipped += self.images.worlds - len(busy)
        self.calls += len(busy)
        if not len(busy):
            return
        with self.clock.part("splat"):
            self.images.splat()
        with self.clock.part("network"):
            output = self._answer(busy)
        impulse = self.sim.contacts.numpy("impulse")
        slots, world = contact_slots(self.sim.contacts)
        cached = impulse[slots]
        with self.clock.part("gather"):
            self.images.start_from(output, reverse=self.reverse)
        lost = np.unique(world[~np.isfinite(impulse[slots]).all(axis=1)])
        if len(lost):
            self.dropped += len(lost)
            back = np.isin(world, lost)
            impulse[slots[back]] = cached[back]

    def _answer(self, busy: np.ndarray) -> Any:
        """Return the network's image of all worlds (worlds, 2 bins, rows, columns); it sees the ``busy`` ones alone."""
        pixels = self.images.tensor()
        with self.torch.inference_mode():
            if len(busy) == len(pixels):
                return self.model(pixels)
            answers = self.model(pixels[busy])
            if self._output is None:
                self._output = answers.new_zeros((len(pixels), *answers.shape[1:]))
            self._output[busy] = answers
            return self._output

    def report(self) -> Report:
        """Return how often the network answered, and what that took."""
        text = (
            f"network: {self.calls} answers for a world and step\n"
            f"  skipped: {self.skipped} without contacts; {self.dropped} answers were not finite and were dropped"
        )
        counts = {"calls": self.calls, "skipped": self.skipped, "dropped": self.dropped}
        return Report(seconds=dict(self.clock.seconds), is_network=True, counts=counts, text=text)
