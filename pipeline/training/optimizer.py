"""Optimisers, schedules of their rates, and checks of their steps."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, get_args

from dc_kernels.runtime.imports import require
from pipeline.training.options import OptimizerName, ScheduleName

torch = require("torch", "pipeline")

MOMENTUM = 0.9
"""Momentum of SGD (Wu 2018) [1]."""
DECAY = 1e-6
"""Rate at which the schedule "decay" falls (Wu 2018) [1/step]."""


def make_optimizer(
    parameters: Iterable[Any],
    name: OptimizerName,
    rate: float,
    *,
    momentum: float = MOMENTUM,
    weight_decay: float = 0.0,
) -> Any:
    """Make an optimiser: SGD with Nesterov's momentum (Wu 2018), or AdamW.

    Raises:
        ValueError: for an unknown name, or a rate that is not finite and positive.
    """
    if not 0.0 < rate < math.inf:
        raise ValueError(f"rate is {rate!r}; it must be finite and > 0")
    if name == "sgd":
        return torch.optim.SGD(
            parameters, lr=rate, momentum=momentum, nesterov=momentum > 0.0, weight_decay=weight_decay
        )
    if name == "adamw":
        return torch.optim.AdamW(parameters, lr=rate, weight_decay=weight_decay)
    raise ValueError(f"optimizer is {name!r}; it must be one of {get_args(OptimizerName)}")


def make_schedule(optimizer: Any, name: ScheduleName, steps: int, *, decay: float = DECAY, warm: float = 0.3) -> Any:
    """Make the schedule of an optimiser's rate, whose ``step()`` is called after each of the optimiser's.

    Args:
        optimizer: whose rate is the first one, or the highest of "onecycle".
        name: "constant"; "decay": rate / (1 + decay steps), as Keras does it (Wu 2018); "onecycle": up from 1/25 of the
            rate and down to nothing, the momentum the other way round (Smith 2018; Tirca 2018).
        steps: of the whole training, >= 1.
        decay: of "decay" [1/step].
        warm: share of the steps in which "onecycle" goes up.

    Raises:
        ValueError: for an unknown name, or no steps.
    """
    if steps < 1:
        raise ValueError(f"steps is {steps}; it must be >= 1")
    schedules = torch.optim.lr_scheduler
    if name == "onecycle":
        highest = [group["lr"] for group in optimizer.param_groups]
        return schedules.OneCycleLR(optimizer, highest, total_steps=max(steps, 2), pct_start=warm)
    if name == "decay":
        return schedules.LambdaLR(optimizer, lambda step: 1.0 / (1.0 + decay * step))
    if name == "constant":
        return schedules.LambdaLR(optimizer, lambda step: 1.0)
    raise ValueError(f"schedule is {name!r}; it must be one of {get_args(ScheduleName)}")


def continued_schedule(
    schedule: Any,
    optimizer: Any,
    rate: float,
    *,
    unit: str,
    wanted: int,
    planned: int,
    done: int,
    each: int = 1,
    warm: float = 0.3,
    folder: Any,
) -> Any:
    """Return the schedule of a training that is resumed: its own, or after one cycle another, if it is to be longer.

    Args:
        schedule: as it was restored.
        optimizer: whose rate it is.
        rate: the first one, or the highest of "onecycle".
        unit: what the training is counted in, "epochs" or "steps".
        wanted: of these in all.
        planned: of these when it was saved.
        done: of these.
        each: steps of one.
        warm: see ``make_schedule``.
        folder: of the training, for errors.

    Raises:
        ValueError: fewer than are done, or another number in the middle of a cycle.
    """
    cycle = isinstance(schedule, torch.optim.lr_scheduler.OneCycleLR)
    if wanted < done or (cycle and wanted < planned):
        raise ValueError(
            f"{unit} is {wanted}; the training in {folder} has done {done} of {planned}: go on with as many or more"
        )
    if not cycle or wanted == planned:
        return schedule
    if done < planned:
        raise ValueError(
            f"{unit} is {wanted}; the training in {folder} is within one cycle of {planned}: finish that first, a "
            "longer one then adds another cycle"
        )
    for parameters in optimizer.param_groups:
        parameters["lr"] = rate
    return make_schedule(optimizer, "onecycle", (wanted - planned) * each, warm=warm)


def check_loss(loss: Any, step: int) -> None:
    """Stop a training that has diverged.

    Raises:
        ValueError: the loss is NaN or inf, naming the step.
    """
    if not math.isfinite(float(loss)):
        raise ValueError(f"the loss of step {step} is {float(loss)}; a lower rate, or clipped gradients, may help")


def clip_gradients(parameters: Iterable[Any], most: float | None, step: int) -> float:
    """Cut the gradient to a norm of at most ``most``, if given, and return the norm that it had.

    Raises:
        ValueError: it is NaN or inf, naming the step: the weights are still those of the step before.
    """
    norm = float(torch.nn.utils.clip_grad_norm_(parameters, math.inf if most is None else most))
    if not math.isfinite(norm):
        raise ValueError(f"the gradient of step {step} is {norm}; a lower rate, or clipped gradients, may help")
    return norm
