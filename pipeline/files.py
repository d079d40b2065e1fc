"""Files that are whole or not there, and what is written into them."""

from __future__ import annotations

import json
import platform
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from dc_kernels.runtime.files import replacing, write_whole


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Give a temporary name (``runtime.files.replacing``) for a file whose folder is made if it is missing."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as partial:
        yield partial


def write_bytes(path: Path, content: bytes | memoryview) -> None:
    """Write a file in one go, into a folder that is made if it is missing, and wait until it is on the disk.

    Raises:
        OSError: naming the file, when the disk is full or does not take it, or it is no regular file.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, content)


def write_json(path: Path, content: Any) -> None:
    """Write JSON in one go (``write_bytes``)."""
    write_bytes(path, (json.dumps(content, indent=2) + "\n").encode())


def versions() -> dict[str, str]:
    """Return the versions of Python, of this project and of the libraries that compute, by name."""
    found = {"python": platform.python_version()}
    for name in ("deep-contact", "warp-lang", "numpy", "h5py"):
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "not installed"
    return found


def plain(value: Any) -> Any:
    """Return nested dicts and lists with Python's own numbers, for JSON."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [plain(item) for item in value]
    return value.item() if isinstance(value, np.generic) else value
