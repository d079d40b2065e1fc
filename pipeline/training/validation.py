"""How well a network answers states that it was not trained on."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from dc_kernels.runtime.imports import require
from pipeline.data.splatter import Splatter
from pipeline.plots.training import NAMES, Prediction
from pipeline.training.losses import Decoder, Loss
from pipeline.training.processes import own_randomness

torch = require("torch", "pipeline")

SHOWN_CONTACTS = 50_000
"""Number of contacts in the picture of predicted against true impulses, about [1]."""
TINY = 1e-30


@dataclass(frozen=True, kw_only=True)
class Validation:
    """States of validation and how answers to them are measured."""

    batches: Iterable[Any]
    """Batches of states; they may be gone through again and again."""
    splatter: Splatter
    """Makes images of states."""
    decode: Decoder
    """Reads impulse images at the contacts."""
    loss: Loss
    """What is minimized."""

    def measure(self, model: Any) -> dict[str, float]:
        """Measure losses, and squared errors at the contacts over that of zero impulses.

        Returns:
            "loss", "normal" and "tangential" of the network; "..._zero" and "..._cache" of zero impulses and of those
            of the step before; "..._grid" of the truth sent to the grid and back, as a perfect network would answer.
        """
        kinds = ("", "_zero") if self.loss.on_grid else ("", "_zero", "_cache", "_grid")
        losses = np.zeros((len(kinds), 2))
        square, errors = np.zeros(2), np.zeros((3, 2))
        model.eval()
        with own_randomness(), torch.inference_mode():
            for batch in self.batches:
                images, target = self.splatter(batch)
                output = model(images)
                found = (self.decode(output, batch), batch.start, self.decode(target, batch))
                errors += [_squares(x - batch.label) for x in found]
                square += _squares(batch.label)
                if self.loss.on_grid:
                    parts = [self.loss(image, target, batch) for image in (output, torch.zeros_like(output))]
                else:
                    answers = (found[0], torch.zeros_like(batch.start), *found[1:])
                    parts = [self.loss.of_impulses(impulse, batch) for impulse in answers]
                losses += [[float(total), float(weight)] for total, weight in parts]
        measured = {f"loss{kind}": total / max(weight, TINY) for kind, (total, weight) in zip(kinds, losses.tolist())}
        relative = (errors / np.maximum(square, TINY)).tolist()
        for kind, values in zip(("", "_cache", "_grid"), relative):
            measured.update({name + kind: value for name, value in zip(NAMES.values(), values)})
        return measured

    def predict(self, model: Any) -> Prediction:
        """Return what a network answers to the states, and the grids of the state with the most contacts."""
        parts: list[tuple[Any, ...]] = []
        most, shown = -1, None
        with own_randomness(), torch.inference_mode():
            for batch in self.batches:
                images, target = self.splatter(batch)
                output = model(images)
                parts.append((self.decode(output, batch), batch.label, self.decode(target, batch)))
                counts = batch.contact_start.diff()
                i = int(counts.argmax())
                if int(counts[i]) > most:
                    most = int(counts[i])
                    points = batch.point[batch.contact_start[i] : batch.contact_start[i + 1]]
                    title = f"world {int(batch.seed[i])}, step {int(batch.step[i])}"
                    shown = [output[i].numpy(), target[i].numpy(), points.numpy(), title]
                if sum(len(part[0]) for part in parts) >= SHOWN_CONTACTS:
                    break
        assert shown is not None
        impulse, label, floor = (torch.cat(column).numpy() for column in zip(*parts))
        answer, target, points, title = shown
        grid = self.decode.images.grid
        answer, target = (image.reshape(-1, 2, *grid.shape).sum(axis=0) for image in (answer, target))
        return Prediction(impulse, label, floor, grid, answer, target, points, title)


def _squares(error: Any) -> np.ndarray:
    """Sum up the squares of each column, in float64."""
    return error.double().square().sum(dim=0).numpy()
