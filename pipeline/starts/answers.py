"""How a network answers what is read of a solve in flight: in lanes of this project's kernels, or by torch.

A module with ``trunk`` and ``head`` runs by torch. One that also has ``in_lanes`` gives kernels the weights of a
ContactNet; one that ``is_even`` is no network at all: all contacts move by one share of Aitken's step.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from dc_kernels.learn.channels import Answer as How
from dc_kernels.learn.in_flight import SolveReader, What
from dc_kernels.learn.layers import MOST_SCALES
from dc_kernels.learn.network import NetworkInLanes
from dc_kernels.runtime.imports import require
from pipeline.networks.weights import Watch
from pipeline.starts.start import Clock


class Answer(Protocol):
    """Corrects the impulses of the worlds that a reader has read."""

    reads: What
    """What the reader has to read."""

    def __call__(self, *, begin: bool) -> np.ndarray:
        """Correct them; returns whether each world took its correction, bool (asked,)."""


class InTorch:
    """Any module with ``trunk`` and ``head``, on images that a reader splats."""

    reads: What = "images"

    def __init__(
        self, reader: SolveReader, model: Any, clock: Clock, *, compile: bool = False, bfloat16: bool = False
    ) -> None:
        """Wrap the model; see ``LearnedSolve``."""
        self._torch = torch = require("torch", "pipeline")
        self.reader, self.clock = reader, clock
        trunk = torch.compile(model.trunk) if compile else model.trunk
        self._trunk = _in_bfloat16(torch, trunk) if bfloat16 else trunk
        self._head = torch.compile(model.head) if compile else model.head

    def __call__(self, *, begin: bool) -> np.ndarray:
        """Correct the impulses of the worlds read; gathers count as a part of their own."""
        reader, clock = self.reader, self.clock
        with self._torch.inference_mode():
            trunk = self._trunk(reader.images())
            with clock.part("gather"):
                near = reader.gather(trunk.contiguous())
            output = self._head(reader.features(), near)
        with clock.part("gather"):
            return reader.correct(output)


class InLanes:
    """A ContactNet, or an even share of Aitken's step, in lanes."""

    def __init__(self, reader: SolveReader, model: Any = None) -> None:
        """Take the weights of a model with ``in_lanes``, which are taken anew when they have changed.

        Args:
            reader: of the solves.
            model: None: all contacts move by an even share.
        """
        self.model = model
        self.reads: What = "steps" if model is None else "features"
        self._accelerated = reader.sim.config.acceleration != "none"
        self._watch = Watch(model)
        self.lanes = NetworkInLanes(reader, None if model is None else model.in_lanes(self._accelerated))

    def refresh(self) -> None:
        """Take the weights anew where they have changed."""
        if self._watch.changed():
            self.lanes.load(self.model.in_lanes(self._accelerated))

    def __call__(self, *, begin: bool) -> np.ndarray:
        """Correct the impulses of the worlds read; an even share whatever was read of them."""
        if self.model is None:
            self.lanes.reader.answer[: self.lanes.reader.asked] = How.EVEN
        return self.lanes(begin=begin)


def answer_of(reader: SolveReader, model: Any, clock: Clock, *, compile: bool, bfloat16: bool) -> Answer:
    """Return how a module answers: in lanes where it can, unless ``compile`` or ``bfloat16`` asks for torch."""
    if getattr(model, "is_even", False):
        return InLanes(reader)
    found = model.in_lanes(accelerated=False) if hasattr(model, "in_lanes") else None
    if found is None or len(found.widths) > MOST_SCALES or compile or bfloat16:
        return InTorch(reader, model, clock, compile=compile, bfloat16=bfloat16)
    return InLanes(reader, model)


def _in_bfloat16(torch: Any, trunk: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Let the convolutions of a trunk run in bfloat16; its answer is float32."""

    def run(images: Any) -> Any:
        with torch.autocast("cpu", torch.bfloat16):
            answer = trunk(images)
        return answer.float()

    return run
