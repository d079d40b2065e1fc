"""Calls in the middle of solves, world by world: when they are made, who answers, and what becomes of their answers."""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels.learn.groups import RULES, Calls
from dc_kernels.learn.in_flight import SolveReader
from dc_kernels.learn.network import NetworkInLanes
from dc_kernels.runtime.backends import kernel_file, make_kernels
from dc_kernels.runtime.program import Kernel, Program

COUNTS = ("calls", "asked", "refused", "failed", "undone")


class CallsInFlight:
    """Where the calls of each world stand, in the solve under way and summed over solves.

    Attributes:
        asking: 1 while calls are made for a world, (W,).
        waiting: 1 where a correction is still to be judged, (W,).
        answer: how each world is to be answered (``channels.Answer``), after ``decide``, (W,).
    """

    def __init__(self, reader: SolveReader, **rules: Any) -> None:
        """Allocate the counts.

        Args:
            reader: of the solves.
            rules: the fields of ``groups.RULES`` but ``tolerance``.
        """
        self.reader, self.rules = reader, rules
        sim = reader.sim
        self.calls = Calls({"world": reader.worlds}, sim.dtype, backend=sim.backend)
        self.asking, self.waiting = map(self.calls.numpy, ("asking", "waiting"))
        self._of_solve = [self.calls.numpy(name) for name in ("waiting", "pause", "made", "failures")]
        self._version = -1
        self._networks: dict[int, tuple[NetworkInLanes, Program]] = {}

    @property
    def answer(self) -> np.ndarray:
        """Copy how each world is to be answered, after ``decide``, (W,)."""
        return self.reader.answer.copy()

    def begin(self, running: np.ndarray) -> None:
        """Begin the solves of the worlds that run, bool (W,)."""
        self.asking[:] = running
        for values in self._of_solve:
            values.fill(0)

    def decide(self) -> None:
        """Judge the last corrections and say how each world is to be answered."""
        with self.reader.sim.calls:
            self._keep_bound()
            self._decide()

    def settle(self, *, begin: bool) -> None:
        """Count what was just answered, of the worlds that were read."""
        with self.reader.sim.calls:
            self._keep_bound()
            self._settle[begin]()

    def round(self, network: NetworkInLanes) -> None:
        """Decide, read, answer and settle the calls of all worlds in one launch; ``reader.take_all`` comes before."""
        with self.reader.sim.calls:
            self._keep_bound()
            if id(network) not in self._networks:
                stages = [self._kernels[0], self.reader.features_kernel(False), *network.kernels(False)]
                self._networks[id(network)] = network, self._program(*stages, self._kernels[1])
            self._networks[id(network)][1]()

    def _keep_bound(self) -> None:
        """Bind to the reader's present arrays."""
        reader = self.reader
        if self._version == reader.version:
            return
        self._version = reader.version
        self._networks.clear()
        sim = reader.sim
        groups, table = kernel_file(sim.backend, "groups"), make_kernels(sim.backend, "learn.calls", sim.dtype.name)
        rules = groups.group("rules", sim.dtype.name, RULES, {**self.rules, "tolerance": sim.config.ends_at[1]})
        values = {
            **sim.values,
            "rules": rules,
            "reading": groups.array_group(reader.reading, "reading"),
            "calls": groups.array_group(self.calls, "calls"),
        }
        decide = Kernel(table["decide_calls"], values)
        settle = [Kernel(table["settle_calls"], {**values, "begin": begin}) for begin in (0, 1)]
        self._kernels = decide, settle[0]
        self._decide, self._settle = self._program(decide), [self._program(kernel) for kernel in settle]

    def _program(self, *stages: Kernel) -> Program:
        reader = self.reader
        return Program(stages, reader.worlds, backend=reader.sim.backend, threads=reader.threads)
