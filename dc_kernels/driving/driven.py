"""The calls by which a program drives a simulation between its steps."""

from __future__ import annotations

import copy
import os
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from dc_kernels import snapshot
from dc_kernels.driving.copies import Parts, from_parts, parts_of
from dc_kernels.model.arrays import Joints, Model, State
from dc_kernels.phases import Phases
from dc_kernels.runtime.capture import refuse_recording
from dc_kernels.runtime.threads import OneCaller

if TYPE_CHECKING:
    from typing_extensions import Self


class Driven(Phases):
    """The part of a simulation that is copied, saved, and brought into another state."""

    model: Model
    joints: Joints
    built: State
    calls: OneCaller

    @property
    def peak(self) -> np.ndarray:
        """The most that a world used of each kind of room, in the row of a shard, or of all."""
        return self._shards.peak

    def clone(self) -> Self:
        """A simulation of its own memory that goes on with the bits of this one, even from within a step.

        ``copy.copy``, ``copy.deepcopy`` and ``pickle`` do so too.

        Raises:
            RuntimeError: within ``wp.ScopedCapture``.
        """
        refuse_recording("a copy of a simulation", "it is made at once")
        with self.calls:
            return copy.deepcopy(self)

    def __copy__(self) -> Self:
        """See ``clone``: two simulations of one memory would disturb each other."""
        return self.clone()

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle all parts."""
        return from_parts, (type(self), parts_of(self))  # type: ignore[arg-type]

    def adopt(self, parts: Parts) -> None:
        """Consist of other parts than those that were made for it: of a simulation of the same scene and options."""
        self.storage.adopt(parts.groups, parts.slots)
        self.built = parts.built
        self._turn.ran = parts.phase
        self._shards.peak[...] = parts.peak
        self._bind_all()

    def save(self, path: str | os.PathLike[str] | BinaryIO) -> None:
        """Write a snapshot to continue from, bit for bit, to a path or a binary file (see ``snapshot.save``)."""
        with self.calls:
            snapshot.save(self, path)  # type: ignore[arg-type]

    @classmethod
    def load(cls, path: str | os.PathLike[str] | BinaryIO, **options: Any) -> Self:
        """A simulation from a snapshot; options as for the constructor (see ``snapshot.load``)."""
        return snapshot.load(cls, path, **options)  # type: ignore[type-var]
