"""Broadphase: candidate pairs of shapes, kept while no shape leaves its box, else found anew by a sorted cell list."""

from __future__ import annotations

import numpy as np

from dc_kernels.model.arrays import ArrayGroup, Model
from dc_kernels.model.enums import Flag
from dc_kernels.model.fields import PAIRS
from dc_kernels.model.room import Room, starts


class Pairs(ArrayGroup):
    """Cells, boxes and candidate pairs (``model.fields.PAIRS``)."""

    table = PAIRS


class Broadphase:
    """The arrays of the broadphase and the room that they have; its kernel is ``update_pairs``.

    Attributes:
        pairs: the pairs, sorted by (A, B) in each world.
        room: pairs reserved for each world.
    """

    def __init__(self, model: Model, pairs_per_shape: float) -> None:
        """Reserve so many pairs for each shape."""
        shapes = np.diff(model.numpy("shape_start")).astype(np.int64)
        self.room = Room("pairs", Flag.PAIR_OVERFLOW, np.ceil(pairs_per_shape * shapes))
        # buckets of the cell list: a power of two that is not below a world's shapes, and one more
        buckets = 2 ** np.ceil(np.log2(np.maximum(shapes, 2))).astype(np.int64) + 1
        sizes = {**model.sizes, "pair": self.room.total, "bucket": int(buckets.sum())}
        self.pairs = Pairs(sizes, model.dtype, model.device, model.backend)
        self.pairs.assign("bucket_start", starts(buckets))
        self.pairs.assign("start", self.room.starts())

    @property
    def used(self) -> np.ndarray:
        """Pairs of each world at the last step, (W,)."""
        return self.pairs.numpy("count")

    @property
    def needed(self) -> np.ndarray:
        """Pairs found at the last rebuild, also those without room, (W,)."""
        return self.pairs.numpy("needed")

    def relayout(self) -> None:
        """Allocate the room anew; pairs are found in the next step."""
        pairs = self.pairs
        pairs.renew(pair=self.room.total)
        pairs.assign("valid", np.zeros(pairs.sizes["world"], np.int32))
        pairs.assign("start", self.room.starts())
