"""HDF5 files: read with care, as they may come from strangers, and written so that no full disk ends the process.

HDF5 follows what a file says to other files, raw ones as well, and allocates the sizes that it declares. ``reading``
looks at all links and datasets of a file before any value is read, and refuses

- links to other files, user-defined links, datasets whose values stand in other files: raw ones (external storage) or
  HDF5 files (virtual datasets); an index of a data set may show files beside it, of plain names that its reader knows;
- filters other than those of ``FILTERS``: a plugin of HDF5's is code, which a file must not choose;
- values that are not stored, and sizes that the file cannot hold: more bytes of values for a byte that is stored than
  the compression can make of it, and more than ``MOST_RATIO`` for a byte of the whole file.

Values in zstd are read with the plugin of the package ``hdf5plugin``, which is imported when a file has some.

A file that was found fine is not looked at again by this process while it is as it was (``Identity``).

What is written is built in memory first (``image``): HDF5 itself crashes a process when a write fails.
"""

from __future__ import annotations

import contextlib
import io
import math
import os
import time
from collections import OrderedDict
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from dc_kernels.runtime.files import check_regular, file_name
from dc_kernels.runtime.imports import require

MOST_RATIO = 1032
"""Bytes of values that a byte of a file may stand for; gzip's format allows no more [1]."""
GZIP, SHUFFLE, FLETCHER, ZSTD = 1, 2, 3, 32015
"""Numbers of filters, as the HDF Group registers them."""
FILTERS = {
    (): 1,
    (FLETCHER,): 1,
    (SHUFFLE,): 1,
    (SHUFFLE, FLETCHER): 1,
    (GZIP,): MOST_RATIO,
    (GZIP, FLETCHER): MOST_RATIO,
    (SHUFFLE, GZIP): MOST_RATIO,
    (SHUFFLE, GZIP, FLETCHER): MOST_RATIO,
    (ZSTD,): 2**15,
    (ZSTD, FLETCHER): 2**15,
    (SHUFFLE, ZSTD): 2**15,
    (SHUFFLE, ZSTD, FLETCHER): 2**15,
}
"""Filters that a dataset may have, in their order, and the bytes of values that a stored byte may then stand for: a
block of zstd holds 128 KiB at most (RFC 8878) and takes 4 bytes at least [1]."""
KEPT = 1024
"""Files of which a process remembers that they were fine."""
SETTLE_NS = 2 * 10**9
"""Age at which a file is remembered: more than the tick of any file system's clock [ns]."""
_DAMAGED = (ArithmeticError, AttributeError, LookupError, OSError, RuntimeError, TypeError)


class Identity(NamedTuple):
    """Which file it is, and as of which change: another one's, or one of another content, differs."""

    device: int
    inode: int
    size: int
    mtime_ns: int
    ctime_ns: int

    @property
    def settled(self) -> bool:
        """Whether any later change shows: one within the same tick of the file system's clock would not."""
        return time.time_ns() - max(self.mtime_ns, self.ctime_ns) > SETTLE_NS


_fine: OrderedDict[tuple[Identity, bool], None] = OrderedDict()


def identity(file: Any) -> Identity:
    """Return the identity of an open ``h5py.File``: of what is open, whatever stands under its name by now."""
    found = os.fstat(file.id.get_vfd_handle())
    return Identity(found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns)


@contextlib.contextmanager
def reading(path: Any, *, virtual: bool = False, schema: str = "") -> Iterator[Any]:
    """Open a file to read it.

    Args:
        path: of the file, or a binary file that is open, which is read into memory from where it stands.
        virtual: let virtual datasets be, as long as they show files of plain names in the same folder.
        schema: what the file must be; one whose attribute ``schema`` names something else is refused before its
            datasets are looked at.

    Yields:
        The open ``h5py.File``. What goes wrong in the block while it is read is an error that names the file.

    Raises:
        ValueError: naming the file: not HDF5, truncated, damaged, or refused as the module says.
        OSError: there is no such file, it is a folder, FIFO or device, or it must not be read.
        ImportError: without h5py, naming the extra that installs it.
    """
    h5py = require("h5py", "pipeline")
    label, content, source = file_name(path), None, path
    if hasattr(path, "read"):
        content = path.read()
        if not isinstance(content, bytes):
            raise TypeError(f"{label}.read() gives a {type(content).__name__}; it must give bytes")
        if not content:
            raise ValueError(
                f"{label}.read() gives nothing: the file is empty, or stands at its end; rewind it by seek(0)"
            )
        source = io.BytesIO(content)
    else:
        check_regular(path)
        with open(path, "rb"):
            pass  # says what is wrong with the path itself
    try:
        file = h5py.File(source, "r")
    except OSError as error:
        raise ValueError(f"{label} is not an HDF5 file, or is truncated: {error}") from error
    with file:
        try:
            found = file.attrs.get("schema") if schema else None
            if isinstance(found, str) and found != schema:
                raise ValueError(f"{label} is a file of schema {found[:80]!r}, not a {schema}")
            if content is None:
                _check_once(file, virtual)
            else:
                _check(file, len(content), virtual)
            yield file
        except ValueError as error:
            if label in str(error):
                raise
            raise ValueError(f"{label}: {error}") from error
        except _DAMAGED as error:
            raise ValueError(f"{label} is damaged: {error}") from error


def dataset(file: Any, name: str) -> Any:
    """Return the ``h5py.Dataset`` of a path in an open file, in half the time that ``file[name]`` takes.

    Raises:
        KeyError: there is none.
        TypeError, ValueError: there is something else.
    """
    h5py = require("h5py", "pipeline")
    return h5py.Dataset(h5py.h5d.open(file.id, name.encode()))


def image(build: Callable[[Any], None], **options: Any) -> memoryview:
    """Return the bytes of an HDF5 file that ``build`` fills, given it open; ``options`` are those of ``h5py.File``."""
    buffer = io.BytesIO()
    with require("h5py", "pipeline").File(buffer, "w", **options) as file:
        build(file)
    return buffer.getbuffer()


def plain_name(name: str) -> bool:
    """Tell whether a name is that of a file beside another one: no folder, no drive, no pattern of HDF5's."""
    return bool(name) and name not in (".", "..") and not set(name) & set("/\\:%\0")


def _check_once(file: Any, virtual: bool) -> None:
    """Look at a file unless it was found fine before."""
    known = identity(file)
    if (known, virtual) in _fine:
        return
    _check(file, known.size, virtual)
    if known.settled:
        _fine[known, virtual] = None
    while len(_fine) > KEPT:
        _fine.popitem(last=False)


def _check(file: Any, size: int, virtual: bool) -> None:
    """Raise ``ValueError`` for the first link or dataset that is refused."""
    h5py = require("h5py", "pipeline")
    links: list[tuple[bytes, int]] = []
    file.id.links.visit(lambda name, link: links.append((name, link.type)), info=True)  # an error must not pass HDF5
    seen: set[int] = set()
    stored = values = 0
    for name, kind in links:
        if kind == h5py.h5l.TYPE_SOFT:
            continue  # within the file: what it leads to is looked at where it stands
        if kind != h5py.h5l.TYPE_HARD:
            what = "to another file" if kind == h5py.h5l.TYPE_EXTERNAL else f"of the user's type {kind}"
            raise ValueError(f"{name.decode(errors='replace')} is a link {what}, which is not followed")
        found = h5py.h5o.open(file.id, name)
        if not isinstance(found, h5py.h5d.DatasetID):
            continue
        address = h5py.h5o.get_info(found).addr
        if address in seen:
            continue
        seen.add(address)
        text = name.decode(errors="replace")
        taken, held = _stored(h5py.h5d, found, text, virtual)
        stored, values = stored + taken, values + held
        if stored > size:
            raise ValueError(f"{text}: the datasets up to this one take {stored} bytes; the file has {size}")
        if values > MOST_RATIO * size:
            raise ValueError(f"{text}: the datasets up to this one hold {values} bytes of values; the file has {size}")


def _ratio(properties: Any, name: str) -> int:
    """Return the bytes of values that a stored byte of a dataset may stand for; its filters can be used then.

    Raises:
        ValueError: for other filters than those of ``FILTERS``.
        ImportError: naming the package that reads them.
    """
    filters = tuple(properties.get_filter(i)[0] for i in range(properties.get_nfilters()))
    if filters not in FILTERS:
        raise ValueError(
            f"{name} has the filters {filters}; they must be shuffle ({SHUFFLE}), then gzip ({GZIP}) or zstd ({ZSTD}), "
            f"then fletcher32 ({FLETCHER}), each of which may be left out"
        )
    if ZSTD in filters:
        require("hdf5plugin", "pipeline")  # whose import is all that h5py needs
    return FILTERS[filters]


def _stored(h5d: Any, data: Any, name: str, virtual: bool) -> tuple[int, int]:
    """Return the bytes that a dataset takes in the file, and those of its values, checked against each other."""
    properties = data.get_create_plist()
    if properties.get_external_count():
        raise ValueError(f"{name} has its values in another file (external storage), which are not read")
    layout = properties.get_layout()
    if layout == h5d.VIRTUAL:
        shown = {properties.get_virtual_filename(i) for i in range(properties.get_virtual_count())}
        bad = sorted(source for source in shown if not (virtual and plain_name(source)))
        if bad or not virtual:
            raise ValueError(f"{name} is virtual: it shows values of {bad[:3]}, which are not read")
        return 0, 0
    shape = data.shape  # each look at these makes an object of HDF5 anew
    width = data.get_type().get_size()
    declared = math.prod(shape or (0,)) * width
    stored = data.get_storage_size()
    held = declared
    if layout == h5d.CHUNKED and declared:
        chunk, chunks = properties.get_chunk(), data.get_num_chunks()
        held = math.prod(chunk) * width * chunks
        places = math.prod(-(-n // c) for n, c in zip(shape, chunk))
        if places != chunks:
            raise ValueError(f"{name} of shape {shape} has {chunks} of its {places} chunks stored")
    most = stored * _ratio(properties, name)
    if max(held, declared) > most:
        raise ValueError(
            f"{name} declares {max(held, declared)} bytes of values, for which {stored} are stored; "
            f"these can hold {most}"
        )
    return int(stored), int(max(held, declared))
