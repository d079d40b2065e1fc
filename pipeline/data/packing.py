"""HDF5 files built in memory, with chunks that are compressed beside HDF5.

HDF5 lets one thread at a time in, and would crash the process on a full disk: chunks are compressed outside it, by as
many threads as make shards and by those that have none to make, and a file is written in one go from all its bytes.
"""

from __future__ import annotations

import threading
import zlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from dc_kernels.model.settings import check_choice
from dc_kernels.runtime.hdf5 import ZSTD, image
from dc_kernels.runtime.imports import require
from pipeline.data.layout import DatasetSpec

Compression = Literal["zstd", "gzip"]
"""How chunks are compressed: zstd takes a sixth of the time of gzip and 7 % less room; gzip is what any HDF5 reads."""


class Codec(NamedTuple):
    """A way to compress chunks."""

    rows: int
    """Rows of a chunk: within what the codec looks back, a step's contacts find those of the steps before [1]."""
    filter: dict[str, Any]
    """Keywords of ``h5py``'s ``create_dataset``."""
    compressor: Callable[[], Callable[[Any], bytes]]
    """Makes the function that compresses bytes, for one thread."""


GZIP_LEVEL = 1
"""Level 4 would take 3 % less room and a quarter more time."""
ZSTD_LEVEL = 1
"""Level 3 would take 1 % less room and two thirds more time."""


def _gzip() -> Callable[[Any], bytes]:
    def compress(data: Any) -> bytes:
        stream = zlib.compressobj(GZIP_LEVEL, memLevel=9)
        return stream.compress(data) + stream.flush()

    return compress


def _zstd() -> Callable[[Any], bytes]:
    require("hdf5plugin", "pipeline")  # HDF5 writes the name of a filter that it knows: always, or bytes would differ
    return require("zstandard", "pipeline").ZstdCompressor(level=ZSTD_LEVEL).compress


CODECS = {
    "zstd": Codec(32768, {"compression": ZSTD, "compression_opts": (ZSTD_LEVEL,)}, _zstd),
    "gzip": Codec(8192, {"compression": "gzip", "compression_opts": GZIP_LEVEL}, _gzip),
}
CHUNK_BYTES = 2**20
"""Most bytes of a chunk before it is compressed, as far as a row has not more; readers keep so much of a dataset."""
Spread = Callable[[Callable[[Any], Any], Sequence[Any]], list[Any]]
"""Calls a function for each of some arguments, on whichever threads, and returns the results in their order."""


def one_by_one(work: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
    """Call a function for each of some arguments on this thread."""
    return [work(item) for item in items]


def check_compression(compression: str) -> Compression:
    """Return the name of a codec whose library is there.

    Raises:
        TypeError, ValueError: for an unknown one.
        ImportError: naming the extra that installs it.
    """
    CODECS[check_choice("compression", compression, get_args(Compression))].compressor()
    return compression  # type: ignore[return-value]


_CHECKSUM = 4  # bytes
_PIECE = 2**18  # words whose weighted sum float64 holds exactly
_WEIGHTS = np.arange(_PIECE, 0.0, -1.0)


def fletcher32(data: bytes) -> bytes:
    """Return the checksum that HDF5 appends to a chunk: sums modulo 65535 of 16-bit words and of their partial sums."""
    words = np.frombuffer(data if len(data) % 2 == 0 else data + b"\0", "<u2")
    first = second = 0
    for begin in range(0, len(words), _PIECE):
        piece = words[begin : begin + _PIECE].astype(np.float64)  # whose sums are exact
        second += len(piece) * first + int(np.einsum("i,i", piece, _WEIGHTS[_PIECE - len(piece) :]))  # no BLAS threads
        first += int(piece.sum())
    # the words are big-endian: to swap bytes is to multiply by 256 modulo 65535; the sums are folded, not divided: a
    # multiple of 65535 is 65535, only 0 is 0
    first, second = ((256 * total - 1) % 65535 + 1 if total else 0 for total in (first, second))
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
    filter: dict[str, Any]
    """Keywords of ``h5py``'s ``create_dataset`` for how they are compressed."""


_of_thread = threading.local()


def _compressor(compression: str) -> Callable[[Any], bytes]:
    """Return this thread's function that compresses; to make one takes a fifth of the time of compressing a chunk."""
    found: Callable[[Any], bytes] | None = getattr(_of_thread, compression, None)
    if found is None:
        found = CODECS[compression].compressor()
        setattr(_of_thread, compression, found)
    return found


def pack(
    values: np.ndarray, axis: int = 0, rows: int | None = None, compression: str = "gzip", spread: Spread = one_by_one
) -> Packed:
    """Compress an array as HDF5's filters shuffle, gzip or zstd, and fletcher32 would, chunk by chunk along an axis.

    Args:
        values: of the dataset.
        axis: along which it is cut into chunks.
        rows: of a chunk; None: what the codec takes best, of ``CHUNK_BYTES`` at most.
        compression: a key of ``CODECS``.
        spread: what shares the chunks among threads.
    """
    codec = CODECS[compression]
    if rows is None:
        size = values.nbytes // max(values.shape[axis], 1)
        rows = max(1, min(codec.rows, CHUNK_BYTES // max(size, 1)))
    rows = min(rows, values.shape[axis])
    chunk = (*values.shape[:axis], rows, *values.shape[axis + 1 :])

    def compressed(first: int) -> tuple[tuple[int, ...], bytes]:
        block = np.ascontiguousarray(values[(slice(None),) * axis + (slice(first, first + rows),)])
        if block.shape != chunk:
            whole = np.zeros(chunk, values.dtype)
            whole[tuple(map(slice, block.shape))] = block
            block = whole
        planes = np.ascontiguousarray(block.reshape(-1).view(np.uint8).reshape(-1, values.dtype.itemsize).T)
        data = _compressor(compression)(planes.data.cast("B"))
        return tuple(first if i == axis else 0 for i in range(values.ndim)), data + fletcher32(data)

    chunks = spread(compressed, range(0, values.shape[axis], max(rows, 1)))
    return Packed(values.dtype, values.shape, chunk, chunks, codec.filter)


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
        filters = {"chunks": item.chunk, "shuffle": True, "fletcher32": True, **item.filter}
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
