"""HDF5 files built in memory, with chunks that are compressed beside HDF5.

HDF5 lets one thread at a time in, and would crash the process on a full disk: chunks are compressed outside it, by as
many threads as make shards, and a file is written in one go from the bytes of all of it.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from dc_kernels.runtime.hdf5 import image
from pipeline.data.layout import DatasetSpec

ROWS = 8192
"""Rows of a chunk: within the 32 KB that gzip looks back, a step's contacts find those of the steps before [1]."""
LEVEL = 1
"""Level of gzip: 4 would take 3 % less room and a quarter more time."""
_CHECKSUM = 4  # bytes


def fletcher32(data: bytes) -> bytes:
    """Return the checksum that HDF5 appends to a chunk: sums modulo 65535 of 16-bit words and of their partial sums."""
    words = np.frombuffer(data if len(data) % 2 == 0 else data + b"\0", ">u2").astype(np.uint64)
    first = int(words.sum())
    second = int(np.dot(words, np.arange(len(words), 0, -1, dtype=np.uint64)))
    # the sums are folded, not divided: a multiple of 65535 is 65535, only 0 is 0
    first, second = ((total - 1) % 65535 + 1 if total else 0 for total in (first, second))
    return (second << 16 | first).to_bytes(_CHECKSUM, "little")


class Packed(NamedTuple):
    """A dataset as HDF5 stores it."""

    dtype: np.dtype
    """Type of the values."""
    shape: tuple[int, ...]
    """Shape of the dataset."""
    chunk: tuple[int, ...]
    """Shape of a chunk."""
    chunks: list[tuple[tuple[int, ...], bytes]]
    """Place of the first value, and compressed bytes, of each chunk."""


def pack(values: np.ndarray, axis: int = 0, rows: int = ROWS) -> Packed:
    """Compress an array as HDF5's filters shuffle, gzip and fletcher32 would, chunk by chunk along an axis."""
    rows = min(rows, values.shape[axis])
    chunk = (*values.shape[:axis], rows, *values.shape[axis + 1 :])
    chunks = []
    for first in range(0, values.shape[axis], max(rows, 1)):
        block = np.ascontiguousarray(values[(slice(None),) * axis + (slice(first, first + rows),)])
        if block.shape != chunk:
            whole = np.zeros(chunk, values.dtype)
            whole[tuple(map(slice, block.shape))] = block
            block = whole
        planes = np.ascontiguousarray(block.reshape(-1).view(np.uint8).reshape(-1, values.dtype.itemsize).T)
        compress = zlib.compressobj(LEVEL, memLevel=9)
        data = compress.compress(planes.data) + compress.flush()
        place = tuple(first if i == axis else 0 for i in range(values.ndim))
        chunks.append((place, data + fletcher32(data)))
    return Packed(values.dtype, values.shape, chunk, chunks)


def file_image(
    packed: Mapping[str, Packed],
    specs: Mapping[str, DatasetSpec],
    attributes: Mapping[str, Any],
    add: Callable[[Any], None] | None = None,
) -> memoryview:
    """Build an HDF5 file in memory.

    Args:
        packed: datasets by path.
        specs: what they hold, by path.
        attributes: of the file.
        add: is called with the open file, to which it adds what is not packed.

    Returns:
        The bytes of the file.
    """

    def build(file: Any) -> None:
        file.attrs.update(attributes)
        for name, item in packed.items():
            _create(file, name, item, specs[name])
        if add is not None:
            add(file)

    return image(build, libver=("v110", "v110"))  # checksums of the structure, too


def _create(file: Any, name: str, item: Packed, spec: DatasetSpec) -> None:
    """Write a packed dataset into an open file."""
    filters: dict[str, Any] = {}
    if item.chunks:
        filters = {"chunks": item.chunk, "compression": "gzip", "compression_opts": LEVEL}
        filters.update(shuffle=True, fletcher32=True)
    data = file.create_dataset(name, item.shape, item.dtype, **filters)
    data.attrs.update(unit=spec.unit, meaning=spec.meaning, **spec.notes)
    for place, block in item.chunks:
        data.id.write_direct_chunk(place, block)


def damaged_row(data: Any) -> int | None:
    """Return the first row of a chunk whose checksum is not that of its bytes; None where all are as they were."""
    if data.chunks is None:
        return None
    axis = next((i for i, (n, c) in enumerate(zip(data.shape, data.chunks)) if n != c), 0)
    for first in range(0, data.shape[axis], data.chunks[axis]):
        place = tuple(first if i == axis else 0 for i in range(data.ndim))
        block = bytes(data.id.read_direct_chunk(place)[1])
        if fletcher32(block[:-_CHECKSUM]) != block[-_CHECKSUM:]:
            return first
    return None
