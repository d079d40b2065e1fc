"""Processes that train together, and their random numbers.

A step of a loop that shares its batches::

    loss = total / processes.mean(weight)      # the whole batch's, whatever this process's share of it
    loss.backward()
    processes.average_gradients(network.parameters())
    optimizer.step()
"""

from __future__ import annotations

import os
import random
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from dc_kernels.runtime.imports import require

torch = require("torch", "pipeline")


@dataclass(frozen=True)
class Processes:
    """The place of this process among those of ``torchrun``; without them it is the only one."""

    rank: int = 0
    """Number of this process [1]."""
    size: int = 1
    """Number of processes [1]."""

    @property
    def first(self) -> bool:
        """Whether this process prints, logs and writes."""
        return self.rank == 0

    def mean(self, value: Any) -> Any:
        """Return the mean of a tensor over the processes, without a gradient."""
        if self.size == 1:
            return value.detach()
        mean = value.detach().clone()
        torch.distributed.all_reduce(mean)
        return mean / self.size

    def any(self, value: bool) -> bool:
        """Tell whether a value is true in any process."""
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
        """Stack the tensors of all processes, (size, ...)."""
        if self.size == 1:
            return value[None]
        parts = [torch.empty_like(value) for _ in range(self.size)]
        torch.distributed.all_gather(parts, value)
        return torch.stack(parts)


ALONE = Processes()


@contextmanager
def processes() -> Iterator[Processes]:
    """Join the processes that ``torchrun`` started by gloo, while the block lasts.

    Raises:
        ValueError: some of torchrun's variables are missing.
    """
    size = os.environ.get("WORLD_SIZE", "1")
    if size == "1":
        yield ALONE
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
    """Put torch's generator back after the block to where it stood, whatever the block drew from it."""
    state = torch.get_rng_state()
    try:
        yield
    finally:
        torch.set_rng_state(state)
