"""A ContactNet in lanes, which answers what a ``SolveReader`` has read without torch.

reader.read(worlds, begin=False, what="features")
taken = NetworkInLanes(reader, layers)(begin=False)
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels.learn.channels import OUTPUT
from dc_kernels.learn.groups import NETWORK
from dc_kernels.learn.in_flight import SolveReader
from dc_kernels.learn.layers import Layers, pack, scratch_size
from dc_kernels.model.arrays import kernel_array
from dc_kernels.model.dtypes import aligned_zeros
from dc_kernels.runtime.backends import kernel_file, make_kernels
from dc_kernels.runtime.program import Kernel, Program


class NetworkInLanes:
    """Answers the worlds that were read, one by one on the reader's threads, each as ``reader.answer`` says.

    Attributes:
        output: the last answer, (room, len(OUTPUT)); its first ``reader.count`` rows are the contacts read.
    """

    def __init__(self, reader: SolveReader, layers: Layers | None) -> None:
        """Allocate what the kernels need.

        Args:
            reader: of the solves.
            layers: the network; None: there is none, and all answers are even ones.

        Raises:
            ValueError: for a trunk of too many scales.
        """
        self.reader, self.layers = reader, layers
        self._version = self._made = -1
        if layers is None:
            return
        dtype = reader.sim.dtype
        self._weight = pack(layers).astype(dtype)
        self._scratch = aligned_zeros((reader.worlds, scratch_size(layers, *reader.grid.shape)), dtype)
        self._widths, self._hidden = (np.array(n, np.int32) for n in (layers.widths, layers.hidden_widths))

    def load(self, layers: Layers) -> None:
        """Take other weights of the same shapes."""
        self._weight[...] = pack(layers)

    def __call__(self, *, begin: bool) -> np.ndarray:
        """Correct ``contacts.impulse`` of the worlds read, as ``SolveReader.correct`` does; they run as they were read.

        Args:
            begin: whether no sweep has been done.

        Returns:
            Whether each world took its correction, bool (asked,).
        """
        reader = self.reader
        with reader.sim.calls:
            if self._version != reader.version:
                self._version = reader.version
                stages = (self.kernels(each) for each in (False, True))
                backend, threads = reader.sim.backend, reader.threads
                self._run = [Program(each, reader.worlds, backend=backend, threads=threads) for each in stages]
            self._run[begin]()
            return reader.taken()

    def kernels(self, begin: bool) -> list[Kernel]:
        """Return what answers and corrects, bound to the reader's present arrays."""
        reader = self.reader
        backend, dtype = reader.sim.backend, reader.sim.dtype.name
        if self._made != reader.version:
            self._made = reader.version
            self.output = np.zeros((len(reader.local), len(OUTPUT)), reader.sim.dtype)
        output = kernel_array(self.output, backend)
        correct = reader.correction_kernel(output, begin)
        if self.layers is None:
            return [correct]
        groups = kernel_file(backend, "groups")
        given = {
            "weight": self._weight,
            "width": self._widths,
            "hidden": self._hidden,
            "scratch": self._scratch,
            "share": 0.0 if begin else self.layers.share,
            "spacing": reader.grid.spacing,
            "rows": reader.grid.rows,
            "columns": reader.grid.columns,
        }
        values: dict[str, Any] = {
            "network": groups.group("network", dtype, NETWORK, given),
            "reading": groups.array_group(reader.reading, "reading"),
            "output": output,
        }
        return [Kernel(make_kernels(backend, "learn.network", dtype)["answer_contacts"], values), correct]
