"""Kernels over all worlds as one call: shards of worlds on threads, a shard's launches run as one."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol

from dc_kernels.model.arrays import kernel_array
from dc_kernels.runtime.backends import BACKENDS, Launch, bind, host_threads
from dc_kernels.runtime.capture import HOST, recording, refuse_recording
from dc_kernels.runtime.interop import host_view
from dc_kernels.runtime.sequences import as_one
from dc_kernels.runtime.threads import run_shards, shard_worlds


class Kernel(NamedTuple):
    """A launch over the worlds of a shard: kernel, arguments but ``world_offset``, threads a world."""

    kernel: Any
    values: Mapping[str, Any]
    chunks: int = 1


def bind_part(kernel: Kernel, first: int, worlds: int, threads: int) -> Launch:
    """A launch over so many worlds from a first one, by so many threads where its backend has them."""
    values = {**kernel.values, "world_offset": first, "threads": threads}
    return bind(kernel.kernel, worlds * kernel.chunks, values, "cpu")


class WorldCall(Protocol):
    """A call that may also be had as a kernel with a thread a world, as a splat onto small images."""

    @property
    def per_world(self) -> Kernel | None:
        """The kernel that does all of the call; None: there is none."""

    def __call__(self) -> None:
        """Run."""


Stage = Kernel | WorldCall | Launch


class Program:
    """A call that runs stages in turn, bound when it is made; the arrays they name live as long as it does.

    Successive kernels go world by world, so each shard runs through them without waiting for the others; any other call
    waits for all shards.
    """

    def __init__(
        self,
        stages: Sequence[Stage],
        worlds: int,
        *,
        backend: str,
        threads: int = 1,
        apart: bool = False,
    ) -> None:
        """Bind the stages.

        Args:
            stages: kernels, and calls without arguments.
            worlds: how many there are.
            backend: of the kernels.
            threads: shards of worlds, and what runs them.
            apart: whether an interrupt may arrive between any two stages, which then wait for all shards.
        """
        self.stages = list(stages)
        host = host_threads(backend, threads)
        self._steps: list[Launch] = []
        self._host = False  # whether a stage does more than launch
        number = itertools.count()
        for (kind, _), group in itertools.groupby(
            map(_as_kernel, stages), lambda stage: (type(stage), next(number) if apart else 0)
        ):
            if kind is not Kernel:
                self._host = True
                self._steps += [stage for stage in group if not isinstance(stage, Kernel)]
                continue
            run = [stage for stage in group if isinstance(stage, Kernel)]
            shards = [as_one([bind_part(k, w, n, threads) for k in run]) for w, n in shard_worlds(worlds, host)]
            self._steps.append(shards[0] if len(shards) == 1 else functools.partial(run_shards, shards, threads))

    def __call__(self) -> None:
        """Run all stages.

        Raises:
            RuntimeError: in a recording, where a stage is more than kernels.
        """
        if self._host:
            refuse_recording("a splat by tiles, or a reverse gather,", HOST)
        for step in self._steps:
            step()


class Fed:
    """A kernel over all worlds with one array that is given with each call, wherever it lies."""

    def __init__(self, kernel: Kernel, name: str, worlds: int, *, backend: str, threads: int = 1) -> None:
        """Bind all other arguments.

        Args:
            kernel: with any array for the argument ``name``, of the type that will be given.
            name: of the argument.
            worlds: how many there are.
            backend: of the kernel.
            threads: shards of worlds, and what runs them.
        """
        self.kernel, self.name, self.backend, self.threads = kernel, name, backend, threads
        self.shards = shard_worlds(worlds, host_threads(backend, threads))
        if BACKENDS[backend].compiled:
            self._launches = self._bind(kernel.values)

    def __call__(self, array: Any, pointer: int) -> None:
        """Run on an array that ``interop.address`` has checked; only the caller keeps it alive, or a recorded graph."""
        if self.backend == "warp" and not recording():
            for launch in self._launches:
                launch.point(self.name, pointer, array.shape)
            run_shards(self._launches, self.threads)
            return
        given = kernel_array(host_view(self.name, array), self.backend)
        if BACKENDS[self.backend].compiled and not recording():
            for launch in self._launches:
                launch.give(self.name, given)
                launch()
            return
        for launch in self._bind({**self.kernel.values, self.name: given}):
            launch()

    def _bind(self, values: Mapping[str, Any]) -> list[Any]:
        """A launch for each shard."""
        kernel = self.kernel._replace(values=values)
        return [bind_part(kernel, w, n, self.threads) for w, n in self.shards]


def _as_kernel(stage: Stage) -> Stage:
    """The kernel of a call that is one thread a world."""
    return getattr(stage, "per_world", None) or stage
