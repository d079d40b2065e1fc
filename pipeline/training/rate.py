"""The rate finder: a short training in which the rate grows."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from dc_kernels.runtime.imports import require
from pipeline.training.processes import ALONE, Processes, own_randomness

torch = require("torch", "pipeline")

SMOOTHING = 0.9
"""Share of the smoothed loss that a step keeps [1]."""
DIVERGED = 2.0
"""Ratio of the smoothed loss to its least at which the search stops [1]."""
SAFETY = 10.0
"""Ratio of the rate of the least loss, which is about to diverge, to the rate that is advised [1]."""


@dataclass(frozen=True)
class RateSearch:
    """What the rate finder saw, and what it advises."""

    rates: list[float]
    """Rates that were tried."""
    losses: list[float]
    """Smoothed loss at each, in units of the loss before [1]."""
    rate: float
    """Rate that is advised."""

    def plain(self) -> dict[str, Any]:
        """Return plain values, for JSON."""
        return {"rates": self.rates, "losses": self.losses, "rate": self.rate}


def find_rate(
    model: Any,
    optimizer: Any,
    loss: Callable[[int], Any],
    *,
    batches: int = 8,
    lowest: float = 1e-6,
    highest: float = 1.0,
    steps: int = 80,
    group: Processes = ALONE,
) -> RateSearch:
    """Find the rate at which to train, by a short training in which it grows (Smith 2017).

    It goes over a few batches in turn, each loss measured in units of what it was before, so that the differences of
    batches do not hide what the rate does. The mean is smoothed; the search ends where it is twice its least. The rate
    of the least loss is too close to where training diverges: a tenth of it is advised. The model and torch's generator
    are left as they were.

    Args:
        model: to train.
        optimizer: a fresh one over its parameters, which is spent.
        loss: the loss of batch i, with its gradient.
        batches: how many there are, >= 1.
        lowest: rate of the first step.
        highest: rate of the last step.
        steps: at most, >= 2.
        group: the processes that share the batches.

    Raises:
        ValueError: for rates or steps out of range, or a loss that is not finite and positive at the beginning.
    """
    if not 0.0 < lowest < highest < math.inf:
        raise ValueError(f"rates are {lowest!r} to {highest!r}; they must be positive, finite and grow")
    for name, value, low in (("batches", batches, 1), ("steps", steps, 2)):
        if value < low:
            raise ValueError(f"{name} is {value}; it must be >= {low}")
    before = {name: tensor.clone() for name, tensor in model.state_dict().items()}
    rates: list[float] = []
    losses: list[float] = []
    mean = 0.0
    with own_randomness():
        with torch.no_grad():
            first = [float(group.mean(loss(i))) for i in range(batches)]
        for i, known in enumerate(first):
            if not 0.0 < known < math.inf:
                raise ValueError(f"the loss of batch {i} is {known} before any step; there is no rate to find")
        for step in range(steps):
            rate = lowest * (highest / lowest) ** (step / (steps - 1))
            for parameters in optimizer.param_groups:
                parameters["lr"] = rate
            optimizer.zero_grad()
            value = loss(step % batches)
            value.backward()
            group.average_gradients(model.parameters())
            optimizer.step()
            mean = SMOOTHING * mean + (1.0 - SMOOTHING) * float(group.mean(value)) / first[step % batches]
            smoothed = mean / (1.0 - SMOOTHING ** (step + 1))
            if not smoothed < DIVERGED * min(losses, default=math.inf):  # NaN too
                break
            rates.append(rate)
            losses.append(smoothed)
    model.load_state_dict(before)
    best = rates[int(np.argmin(losses))] if rates else lowest
    return RateSearch(rates, losses, max(best / SAFETY, lowest))
