"""An HDF5 file that grows while a run goes on, and of which the disk always holds a whole state.

HDF5 changes a file in place, so that a kill leaves one that cannot be read, and it ends the process when a write fails.
Here it writes into memory, page by page. ``Stream.commit`` brings the pages to the disk: first those behind the end of
what is there, which is where a disk may turn out to be full, then, when they are safe, those that change. Where that
fails the file on the disk is still that of the commit before, and HDF5 notices nothing.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from dc_kernels.runtime.files import not_written, partial_name, put_in_place, target_of
from dc_kernels.runtime.imports import require

PAGE = 2**16
"""Size of a page [B]."""
MOST_WAITING = 2**24
"""Size of the pages after which a commit is due at once [B]."""
PAUSE = 1.0
"""Least time from one commit to the next [s]."""
SHARE = 0.05
"""Least time from one commit to the next, as a share of the time since the file was begun; commits take it at most."""


class Pages:
    """A file as HDF5 sees it: what is on the disk, under the pages that were written since the last commit."""

    def __init__(self, descriptor: int) -> None:
        """Begin with an empty file, open to read and write."""
        self.descriptor = descriptor
        self.pages: dict[int, bytearray] = {}
        self.size = self.safe = 0  # as HDF5 sees it, and on the disk
        self.valid = 0  # bytes at the beginning of the disk's file that have not been cut off since
        self.place = 0  # of the next read or write

    # ------------------------------------------------------------------ what h5py asks of a file

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Move to a place."""
        self.place = offset + (0, self.place, self.size)[whence]
        return self.place

    def tell(self) -> int:
        """Return the place."""
        return self.place

    def read(self, count: int = -1) -> bytes:
        """Read bytes from the place on, all that there are by default."""
        most = max(self.size - self.place, 0)
        found = bytearray(most if count < 0 else min(count, most))
        self.readinto(found)
        return bytes(found)

    def readinto(self, buffer: Any) -> int:
        """Read into a buffer from the place on; returns how many bytes there were."""
        view = memoryview(buffer).cast("B")
        count = max(min(len(view), self.size - self.place), 0)
        for page, first, last, at in self._parts(count):
            held = self.pages.get(page)
            view[at : at + last - first] = (self._from_disk(page) if held is None else held)[first:last]
        self.place += count
        return count

    def write(self, content: Any) -> int:
        """Write bytes at the place."""
        view = memoryview(content).cast("B")
        for page, first, last, at in self._parts(len(view)):
            if page not in self.pages:
                self.pages[page] = self._from_disk(page)
            self.pages[page][first:last] = view[at : at + last - first]
        self.place += len(view)
        self.size = max(self.size, self.place)
        return len(view)

    def truncate(self, size: int) -> int:
        """Set the size; what lies beyond is forgotten, what is added is zero."""
        if size < self.size:
            self.valid = min(self.valid, size)
            for page in [page for page in self.pages if page * PAGE >= size]:
                del self.pages[page]
            page, rest = divmod(size, PAGE)
            if rest:
                self.pages.setdefault(page, self._from_disk(page))[rest:] = bytes(PAGE - rest)
        self.size = size
        return size

    def flush(self) -> None:
        """Do nothing: ``commit`` brings the pages to the disk."""

    # ------------------------------------------------------------------ the disk

    @property
    def waiting(self) -> int:
        """Size of the pages that the disk has not got [B]."""
        return len(self.pages) * PAGE

    def commit(self) -> None:
        """Bring all pages to the disk.

        Raises:
            OSError: the disk does not take them; the file on it is that of the commit before.
        """
        try:
            for page in range(self.safe // PAGE, -(-self.size // PAGE)):
                content = self.pages.get(page) or bytes(PAGE)
                self._to_disk(page, content, max(page * PAGE, self.safe), min((page + 1) * PAGE, self.size))
            os.fsync(self.descriptor)
        except OSError:
            with contextlib.suppress(OSError):
                os.ftruncate(self.descriptor, self.safe)
            raise
        cut = range(self.valid // PAGE, -(-min(self.safe, self.size) // PAGE))
        for page in sorted({*self.pages, *cut}):
            content = self.pages.get(page) or self._from_disk(page)
            self._to_disk(page, content, page * PAGE, min((page + 1) * PAGE, self.safe, self.size))
        if self.size < self.safe:
            os.ftruncate(self.descriptor, self.size)
        os.fsync(self.descriptor)
        self.safe = self.valid = self.size
        self.pages.clear()

    def _to_disk(self, page: int, content: bytes | bytearray, first: int, last: int) -> None:
        """Write the bytes first, ..., last - 1 of the file, which lie in a page."""
        view = memoryview(content)[first - page * PAGE : max(last, first) - page * PAGE]
        while len(view):
            written = os.pwrite(self.descriptor, view, first)
            view, first = view[written:], first + written

    def _from_disk(self, page: int) -> bytearray:
        """Read a page, zero beyond the end."""
        found = bytearray(PAGE)
        count = self.valid - page * PAGE
        if count > 0:
            content = os.pread(self.descriptor, min(count, PAGE), page * PAGE)
            found[: len(content)] = content
        return found

    def _parts(self, count: int) -> Iterator[tuple[int, int, int, int]]:
        """Go through the pages of the next bytes: page, first and last byte in it, and how many bytes were before."""
        done = 0
        while done < count:
            page, first = divmod(self.place + done, PAGE)
            last = min(first + count - done, PAGE)
            yield page, first, last, done
            done += last - first


class Stream:
    """An HDF5 file that is written under a temporary name, commit by commit, and put in its place at the end.

    Attributes:
        path: of the file at the end.
        partial: its temporary name, which a kill leaves: a file that can be read, as of the last commit.
        file: the open ``h5py.File``.
        commits: how many there were.
    """

    def __init__(self, path: Path) -> None:
        """Open an empty file in the folder of ``path``, which is made if it is missing.

        Raises:
            OSError: naming the file, when it cannot be written.
        """
        self.path, self.commits = path, 0
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._target = target_of(path)
            self.partial = partial_name(self._target)
            self._descriptor = os.open(self.partial, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
        except OSError as error:
            raise not_written(path, error) from error
        self.pages = Pages(self._descriptor)
        self.file = require("h5py", "pipeline").File(self.pages, "w")
        self._began = self._next = time.monotonic()

    def due(self) -> bool:
        """Tell whether it is time for a commit."""
        return time.monotonic() >= self._next or self.pages.waiting > MOST_WAITING

    def commit(self) -> None:
        """Bring to the disk what has been written.

        Raises:
            OSError: the disk does not take it; what was committed before is whole.
        """
        began = time.monotonic()
        self.file.flush()
        self.pages.commit()
        self.commits += 1
        now = time.monotonic()
        self._next = now + max(PAUSE, (now - began) / SHARE, SHARE * (now - self._began))

    def finish(self) -> None:
        """Close the file, commit it, and put it in its place.

        Raises:
            OSError: the disk does not take it; what was committed before is whole.
        """
        self.file.close()
        self.pages.commit()
        self.commits += 1
        self.keep()

    def keep(self) -> None:
        """Close the file and put it in its place, as of the last commit."""
        self.file.close()  # what it writes now is not committed
        put_in_place(self.partial, self._target)

    def close(self) -> None:
        """Close the file; unless it is in its place it goes."""
        self.file.close()
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1
            self.partial.unlink(missing_ok=True)
