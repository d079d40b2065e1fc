"""Files that are whole or not there: written under another name in the same folder, synced, then renamed.

A full disk, a kill or an error never damages the file that was there before. The temporary name,
``.NAME.PROCESS.RANDOM.partial.SUFFIX``, is no other writer's, in whatever process or on whatever machine it runs.
"""

from __future__ import annotations

import contextlib
import errno
import os
import stat
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a FIFO"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)
_NO_SYNC = (errno.EINVAL, errno.ENOTSUP, errno.EACCES, errno.EPERM, errno.EBADF)  # of folders, on some file systems


def check_regular(path: str | os.PathLike[str]) -> None:
    """Raise ``OSError`` unless a path leads to a regular file; others are never opened: a FIFO would block.

    Raises:
        FileNotFoundError: there is nothing.
        OSError: there is a folder, a FIFO, a device or a socket, which the error names.
    """
    mode = os.stat(path).st_mode
    if stat.S_ISREG(mode):
        return
    kind = next((text for test, text in _KINDS if test(mode)), "no regular file")
    raise OSError(errno.EISDIR if stat.S_ISDIR(mode) else errno.EINVAL, f"{os.fspath(path)} is {kind}, not a file")


def target_of(path: str | os.PathLike[str]) -> Path:
    """Return the file that a path leads to, links followed, whether it is there or will be made.

    Raises:
        OSError: there is something that a file must not take the place of: a folder, a device, a FIFO, a socket; or a
            part of the path is no folder.
    """
    target = Path(os.path.realpath(path))
    with contextlib.suppress(FileNotFoundError):
        check_regular(target)
    return target


def partial_name(target: Path) -> Path:
    """Return a temporary name in the folder of a file, with its suffix."""
    return target.with_name(f".{target.stem[:100]}.{os.getpid()}.{uuid.uuid4().hex[:12]}.partial{target.suffix}")


@contextlib.contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a temporary name, whose file takes the place of ``path`` when the block ends, and goes when it raises.

    Links are followed: the file that they lead to is replaced.

    Raises:
        OSError: naming ``path``: it is no regular file, its folder is missing, or the disk does not take it.
    """
    try:
        target = target_of(path)
        partial = partial_name(target)
        try:
            yield partial
            put_in_place(partial, target)
        finally:
            partial.unlink(missing_ok=True)
    except OSError as error:
        raise not_written(path, error) from error


def put_in_place(partial: Path, target: Path) -> None:
    """Wait until a file is on the disk, and rename it to its name."""
    descriptor = os.open(partial, os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
    os.replace(partial, target)
    if os.name != "posix":
        return
    try:
        folder = os.open(target.parent, os.O_RDONLY)
        try:
            os.fsync(folder)  # so that the new name outlives a power cut, too
        finally:
            os.close(folder)
    except OSError as error:
        if error.errno not in _NO_SYNC:
            raise


def write_whole(path: str | os.PathLike[str], content: bytes | memoryview) -> None:
    """Write a file in one go, and wait until it is on the disk.

    Raises:
        OSError: see ``replacing``; what was there before is whole.
    """
    with replacing(path) as partial, open(partial, "xb") as file:
        file.write(content)


def file_name(file: Any) -> str:
    """Return what errors call a path, or a file that is open."""
    return f"<{type(file).__name__}>" if hasattr(file, "read") else os.fspath(file)


def write_file(file: Any, content: memoryview) -> None:
    """Write to a path, whole or not at all (``write_whole``), or to a binary file that is open, where it stands."""
    if not hasattr(file, "write"):
        write_whole(file, content)
        return
    while len(content):
        written = file.write(content)  # a raw file may take a part at a time
        content = content[len(content) if written is None else written :]


def not_written(path: str | os.PathLike[str], error: OSError) -> OSError:
    """Return an error of the same kind that names the file and says that the one before is whole."""
    text = f"{os.fspath(path)} was not written: {error.strerror or error}; what was there before is whole"
    return type(error)(text) if error.errno is None else OSError(error.errno, text)
