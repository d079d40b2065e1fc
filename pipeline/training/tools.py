"""The parts of a training loop, of any network: processes, seeds, optimiser, schedule, rate finder, log.

A step of a loop with them::

    loss = total / processes.mean(weight)      # the whole batch's, whatever this process's share of it
    loss.backward()
    processes.average_gradients(network.parameters())
    optimizer.step()
    schedule.step()
"""

from __future__ import annotations

import json
import math
import os
import random
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import numpy as np

from dc_kernels.runtime.optional import require
from pipeline.files import atomic_path
from pipeline.training.train import OptimizerName, ScheduleName

torch = require("torch", "pipeline")

MOMENTUM = 0.9  # of SGD (Wu)
DECAY = 1e-6  # of the rate, a step (Wu)
SMOOTHING = 0.9  # of the losses that the rate finder looks at, a step
DIVERGED = 2.0  # times the least smoothed loss, at which the rate finder stops
SAFETY = 10.0  # the rate with the least loss is already about to diverge; this many times less is taken


@dataclass(frozen=True)
class Processes:
    """This process among those of ``torchrun``; one alone where there are no others."""

    rank: int = 0
    size: int = 1

    @property
    def first(self) -> bool:
        """Whether this process prints, logs and writes."""
        return self.rank == 0

    def mean(self, value: Any) -> Any:
        """Mean of a tensor over the processes, without a gradient."""
        if self.size == 1:
            return value.detach()
        mean = value.detach().clone()
        torch.distributed.all_reduce(mean)
        return mean / self.size

    def any(self, value: bool) -> bool:
        """Whether it is true in any process."""
        return value if self.size == 1 else bool(self.mean(torch.tensor(float(value))) > 0)

    def average_gradients(self, parameters: Iterable[Any]) -> None:
        """Replace gradients by their means over the processes, in one message; one that is missing counts as 0."""
        if self.size == 1:
            return
        parameters = [p for p in parameters if p.requires_grad]
        if not parameters:
            return
        flat = torch.cat([(torch.zeros_like(p) if p.grad is None else p.grad).flatten() for p in parameters])
        torch.distributed.all_reduce(flat)
        for p, mean in zip(parameters, (flat / self.size).split([p.numel() for p in parameters])):
            p.grad = mean.view(p.shape) if p.grad is None else p.grad.copy_(mean.view(p.shape))

    def broadcast(self, module: Any) -> None:
        """Give all processes the weights and buffers of the first one."""
        if self.size > 1:
            for tensor in module.state_dict().values():
                torch.distributed.broadcast(tensor, 0)

    def gather(self, value: Any) -> Any:
        """The tensors of all processes, stacked (size, ...)."""
        if self.size == 1:
            return value[None]
        parts = [torch.empty_like(value) for _ in range(self.size)]
        torch.distributed.all_gather(parts, value)
        return torch.stack(parts)


@contextmanager
def processes() -> Iterator[Processes]:
    """The processes that ``torchrun`` started, joined by gloo while the block lasts.

    Raises:
        ValueError: some of torchrun's variables are missing.
    """
    size = os.environ.get("WORLD_SIZE", "1")
    if size == "1":
        yield Processes()
        return
    for name in ("RANK", "MASTER_ADDR", "MASTER_PORT"):
        if name not in os.environ:
            raise ValueError(f"WORLD_SIZE is {size}, but {name} is not set: start several processes with torchrun")
    torch.distributed.init_process_group("gloo")
    try:
        yield Processes(torch.distributed.get_rank(), torch.distributed.get_world_size())
    finally:
        torch.distributed.destroy_process_group()


def seed_everything(seed: int, rank: int = 0) -> None:
    """Seed the global generators of torch, NumPy and Python; each process has streams of its own.

    Raises:
        ValueError: for a negative seed.
    """
    if seed < 0:
        raise ValueError(f"seed is {seed}; it must be >= 0")
    mixed = int(np.random.SeedSequence([seed, rank]).generate_state(1)[0])
    torch.manual_seed(mixed)
    np.random.seed(mixed)  # noqa: NPY002, what other libraries draw from
    random.seed(mixed)


@contextmanager
def own_randomness() -> Iterator[None]:
    """What the block draws from torch's generator is not missed outside it."""
    state = torch.get_rng_state()
    try:
        yield
    finally:
        torch.set_rng_state(state)


def make_optimizer(
    parameters: Iterable[Any],
    name: OptimizerName,
    rate: float,
    *,
    momentum: float = MOMENTUM,
    weight_decay: float = 0.0,
) -> Any:
    """SGD with Nesterov's momentum (Wu), or AdamW.

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
    """How the rate goes on from that of the optimiser; one ``step()`` after each of the optimiser's.

    Args:
        optimizer: whose rate is the first one, or the highest of "onecycle".
        name: "constant"; "decay": rate / (1 + decay steps), as Keras does it (Wu); "onecycle": up from 1/25 of the rate
            and down to nothing, the momentum the other way round (Smith 2018; Tirca).
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


@dataclass(frozen=True)
class RateSearch:
    """What the rate finder saw, and what it advises."""

    rates: list[float]
    losses: list[float]
    rate: float

    def plain(self) -> dict[str, Any]:
        """For JSON."""
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
    group: Processes = Processes(),
) -> RateSearch:
    """The rate at which to train, by a short training in which it grows (Smith 2017).

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


class Log:
    """Scalars of a training by step: for TensorBoard, and one JSON object a line in ``metrics.jsonl``.

    A training that goes on from a step drops what an earlier run logged after it.
    """

    def __init__(self, folder: Path, step: int = 0, *, enabled: bool = True) -> None:
        """Continue after ``step``; does nothing unless ``enabled``."""
        self.path = folder / "metrics.jsonl"
        self.rows: list[dict[str, Any]] = []
        self.writer = None
        if not enabled:
            return
        folder.mkdir(parents=True, exist_ok=True)
        if step and self.path.exists():
            self.rows = [row for row in _rows(self.path) if row["step"] <= step]
        with atomic_path(self.path) as partial:
            partial.write_text("".join(json.dumps(row) + "\n" for row in self.rows))
        summaries = require("torch.utils.tensorboard", "pipeline")
        self.writer = summaries.SummaryWriter(str(folder / "tensorboard"), purge_step=step + 1 if step else None)

    def add(self, step: int, values: Mapping[str, float]) -> None:
        """Log values of a step; a name such as "validation/loss" has its group first."""
        if self.writer is None:
            return
        row = {"step": step, **{name: float(value) for name, value in values.items()}}
        self.rows.append(row)
        with self.path.open("a") as file:
            file.write(json.dumps(row) + "\n")
        for name, value in values.items():
            self.writer.add_scalar(name, float(value), step)

    def series(self, name: str) -> tuple[list[int], list[float]]:
        """Steps and values of a name."""
        rows = [row for row in self.rows if name in row]
        return [row["step"] for row in rows], [row[name] for row in rows]

    def close(self) -> None:
        """Write what is waiting."""
        if self.writer is not None:
            self.writer.close()


def _rows(path: Path) -> Iterator[dict[str, Any]]:
    """Whole lines: a killed run may leave half of one."""
    for line in path.read_text().splitlines():
        try:
            yield json.loads(line)
        except json.JSONDecodeError:
            return
