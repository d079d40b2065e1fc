"""The folders of a data set, read as one: their shards, checked against their indexes.

What an index shows of its shards is never read through HDF5, which gives fill values where a shard is missing and looks
for it in other folders: shards are opened one by one.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dc_kernels.runtime.hdf5 import Identity, identity, plain_name
from pipeline.data.layout import INDEX, STARTS
from pipeline.data.shards import check_shapes, config_of, difference, opened

OWN = ("worlds", "seed", "shard_worlds")
"""Settings in which the folders of a data set may differ."""

Paths = str | Path | Sequence[str | Path]


@dataclass(frozen=True)
class Part:
    """A shard, as an index knows it."""

    path: Path
    """Its file."""
    worlds: int
    """Worlds of it that the index shows: the first ones, as a data set that grows may put more into its last shard."""
    config: Mapping[str, Any]
    """Configuration of its folder."""


class Folders:
    """The shards of one folder or several.

    Attributes:
        folder: the first of them.
        config: configuration of the first one.
        parts: all shards in order.
        first_world: first world of each shard, counted through all, and how many there are, (parts + 1,) int64.
    """

    def __init__(self, paths: Paths) -> None:
        """Read the indexes.

        Args:
            paths: a folder or its index, or several.

        Raises:
            ValueError: a folder has no index, a foreign or damaged one, or lacks a shard; or two of them do not belong
                together, as they differ in more than ``OWN``.
        """
        given = [paths] if isinstance(paths, str | Path) else list(paths)
        if not given:
            raise ValueError("there is no folder to read")
        self.parts: list[Part] = []
        self._whole: dict[int, Identity] = {}  # shards that were checked, as they were then
        configs = []
        for path in given:
            index = index_of(path)
            configs.append(self._read_index(index))
            text = difference(_shared(configs[-1]), _shared(configs[0]))
            if text:
                raise ValueError(f"{index.parent} was made with {text} as in {index_of(given[0]).parent}")
        self.config, self.folder = configs[0], index_of(given[0]).parent
        self.first_world = np.cumsum([0, *(part.worlds for part in self.parts)])

    def _read_index(self, index: Path) -> dict[str, Any]:
        """Add the shards of an index; returns its configuration."""
        with opened(index) as file:
            if file.attrs.get("kind") != "index":
                raise ValueError(f"{index} is no index: its attribute 'kind' is {file.attrs.get('kind')!r}")
            config = config_of(file)
            names, start = file["shard/name"][...], file["shard/world_start"][...]
        if names.dtype.kind != "S" or start.dtype.kind != "i" or names.ndim != 1 or start.shape != (len(names) + 1,):
            raise ValueError(f"{index} is damaged: shard/name or shard/world_start has a wrong shape or dtype")
        if not len(names) or start[0] != 0 or (np.diff(start) < 1).any():
            raise ValueError(f"{index} is damaged: shard/world_start must ascend from 0")
        texts = [name.decode(errors="replace") for name in names]
        for name in texts:
            if not plain_name(name):
                raise ValueError(f"{index}: shard/name has {name!r}, which is no file beside the index")
        missing = [name for name in texts if not (index.parent / name).is_file()]
        if missing:
            raise ValueError(
                f"{index.parent} lacks {missing[0]}, one of {len(missing)} missing among the {len(texts)} shards of "
                f"{index.name}; generate with the same options makes them again"
            )
        self.parts += [Part(index.parent / name, int(n), config) for name, n in zip(texts, np.diff(start))]
        return config

    def files(self) -> Iterator[tuple[Any, Part]]:
        """Go through all shards, each open and checked."""
        for number, part in enumerate(self.parts):
            with self.shard(number) as file:
                yield file, part

    @contextmanager
    def shard(self, number: int) -> Iterator[Any]:
        """Open a shard; it is checked unless it is as it was when it was last.

        Raises:
            ValueError: it is foreign or damaged, or holds less than the index shows.
            OSError: it cannot be opened.
        """
        part = self.parts[number]
        with opened(part.path) as file:
            now = identity(file)
            if self._whole.get(number) != now:  # worlds are read one by one, and a shard is opened for each
                _check_part(file, part)
                if now.settled:
                    self._whole[number] = now
            yield file

    def gather(self, *names: str) -> tuple[dict[str, np.ndarray], dict[str, int]]:
        """Read datasets of all shards, put together; offsets count through all.

        Args:
            names: paths of datasets without axes before that of the rows.

        Returns:
            The values by name, and the number of rows of each axis.
        """
        found: dict[str, list[np.ndarray]] = {name: [] for name in names}
        total: dict[str, int] = {}
        for file, part in self.files():
            rows = row_counts(file, part.worlds)
            for name in names:
                count = rows[name.split("/")[0]]
                if name in STARTS:
                    found[name].append(file[name][:count] + total.get(STARTS[name], 0))
                else:
                    found[name].append(file[name][:count])
            total = {axis: total.get(axis, 0) + count for axis, count in rows.items()}
        for name in set(names) & STARTS.keys():
            found[name].append(np.array([total[STARTS[name]]]))
        return {name: np.concatenate(parts) for name, parts in found.items()}, total


def _check_part(file: Any, part: Part) -> None:
    """Raise ``ValueError`` unless a shard is whole, of its folder's configuration, and as long as the index says."""
    check_shapes(file, part.path)
    text = difference(_shared(config_of(file)), _shared(part.config))
    if text:
        raise ValueError(f"{part.path} was made with {text} as in {INDEX}; make the index anew")
    found = file["world/seed"].shape[0]
    if found < part.worlds:
        raise ValueError(f"{part.path} holds {found} worlds, of which {INDEX} shows {part.worlds}")


def row_counts(file: Any, worlds: int) -> dict[str, int]:
    """Return how many rows of each axis belong to the first worlds of a shard."""
    rows = {"world": worlds}
    for name, axis in STARTS.items():  # the axes in their order
        rows[axis] = int(file[name][rows[name.split("/")[0]]])
    return rows


def index_of(path: str | Path) -> Path:
    """Return the path of an index, given it or its folder.

    Raises:
        ValueError: there is none.
    """
    index = Path(path) if Path(path).name == INDEX else Path(path) / INDEX
    if not index.exists():
        raise ValueError(f"{index.parent} has no {index.name}: it is no data set, or one that is not finished")
    return index


def _shared(config: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings that folders of one data set have in common."""
    return {name: value for name, value in config.items() if name not in OWN}
