"""Shards of a data set (``layout``), written and read, and checked before they are trusted.

A shard is built in memory and written in one go under a temporary name, then renamed: a kill leaves nothing but a
temporary file.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from dc_kernels.runtime.hdf5 import dataset, reading
from pipeline.data.layout import INDEX, LAYOUT, SCHEMA, STARTS, VERSION, DatasetSpec, described
from pipeline.data.packing import Spread, damaged_row, file_image, one_by_one, pack
from pipeline.files import versions

SPECS = described()
_COUNTED = {
    axis: next((name, len(spec.lead)) for name, spec in specs.items() if f"{axis}/{name}" not in STARTS)
    for axis, specs in LAYOUT.items()
}
"""Of each axis a dataset that is not one of offsets, and which of its axes that is."""


def shard_image(
    arrays: Iterable[tuple[str, np.ndarray]],
    extra: Mapping[str, DatasetSpec],
    attributes: Mapping[str, Any],
    compression: str = "zstd",
    spread: Spread = one_by_one,
) -> memoryview:
    """Build a shard in memory.

    Args:
        arrays: path and values of the datasets of ``LAYOUT`` and ``extra``; each is packed before the next is made.
        extra: what stands beside ``LAYOUT``: drawn parameters and grids.
        attributes: of the file, besides those of every file.
        compression: of the chunks, a key of ``packing.CODECS``.
        spread: what shares them among threads.

    Returns:
        The bytes of its file.
    """
    specs = {**SPECS, **extra}
    packed = {}
    for name, values in arrays:
        spec = specs[name]
        values = np.ascontiguousarray(values, spec.dtype)
        packed[name] = pack(values, len(spec.lead), None, compression, spread)
    common = {"schema": SCHEMA, "version": VERSION, "kind": "shard", "versions": json.dumps(versions())}
    return file_image(packed, specs, {**common, **attributes})


def remove_partial(folder: Path) -> int:
    """Remove the files that killed runs left under temporary names; returns how many there were.

    No other process must be writing into the folder (``files.sole_writer``): these may be its files.
    """
    left = [path for stem in ("shard-*", "index") for path in folder.glob(f".{stem}.*.partial.h5")]
    for path in left:
        path.unlink(missing_ok=True)
    return len(left)


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """Open a shard or index to read it.

    Raises:
        ValueError: naming it, when it is foreign or damaged, also when that shows while it is read.
        OSError: when there is none, or it must not be read.
    """
    with reading(path, virtual=path.name == INDEX) as file:
        check_schema(file, path)
        yield file


def check_schema(file: Any, path: Path) -> None:
    """Raise ``ValueError`` unless the file is of a data set that this version reads."""
    schema, version = file.attrs.get("schema"), file.attrs.get("version")
    if not isinstance(schema, str) or schema != SCHEMA:
        raise ValueError(f"{path} is not a file of a {SCHEMA}: its attribute 'schema' is {schema!r}")
    if version != VERSION:
        raise ValueError(f"{path} has version {version} of {SCHEMA}; this version reads {VERSION}")


def config_of(file: Any) -> dict[str, Any]:
    """Return the configuration that a file was made with."""
    return json.loads(file.attrs["config"])


def difference(found: Mapping[str, Any], wanted: Mapping[str, Any], prefix: str = "") -> str | None:
    """Name the first setting in which two configurations differ; None if there is none."""
    for name in dict.fromkeys([*wanted, *found]):
        one, other = found.get(name), wanted.get(name)
        if isinstance(one, Mapping) and isinstance(other, Mapping):
            text = difference(one, other, f"{prefix}{name}.")
            if text:
                return text
        elif one != other or (name in found) != (name in wanted):
            return f"{prefix}{name} = {one!r}, not {other!r}"
    return None


def check_shard(path: Path, config: Mapping[str, Any], seed: int, most: int) -> int:
    """Count the worlds of a shard, which must be whole and hold worlds of this configuration.

    Every chunk's checksum is computed anew, and every ``*_start`` looked at; nothing is decompressed but these.

    Args:
        path: of the shard.
        config: that of the recipe; of how many worlds there are in all a shard knows nothing.
        seed: of its first world.
        most: worlds that it may hold.

    Raises:
        ValueError: naming the file, for a damaged or foreign one, or one of another recipe.
    """
    with opened(path) as file:
        made, wanted = ({k: v for k, v in one.items() if k != "worlds"} for one in (config_of(file), config))
        text = difference(made, wanted)
        if text:
            raise ValueError(f"{path} was made with {text}; go on with the same configuration, or in another folder")
        kind, first, worlds = file.attrs["kind"], int(file.attrs["seed"]), int(file.attrs["worlds"])
        if (kind, first) != ("shard", seed) or not 0 < worlds <= most:
            raise ValueError(f"{path} is {kind} of {worlds} worlds from seed {first}, not {most} from {seed}")
        if not np.array_equal(file["world/seed"][...], np.arange(seed, seed + worlds)):
            raise ValueError(f"{path} is damaged: world/seed does not count from {seed} to {seed + worlds - 1}")
        check_shapes(file, path)
        for name, data in datasets(file):
            row = damaged_row(data)
            if row is not None:
                raise ValueError(f"{path} is damaged: {name} has another checksum from row {row} on")
        return worlds


def check_shapes(file: Any, path: Path) -> dict[str, int]:
    """Count the rows of each axis of a shard; all datasets must be there, of their shape and dtype, offsets in order.

    Raises:
        ValueError: naming the file and the dataset.
    """
    found = {name: dataset(file, name) for name in SPECS}
    shapes = {name: data.shape for name, data in found.items()}
    sizes = {axis: int(shapes[f"{axis}/{name}"][lead]) for axis, (name, lead) in _COUNTED.items()}
    for name, spec in SPECS.items():
        axis = name.split("/")[0]
        shape = (*spec.lead, sizes[axis] + (name in STARTS), *spec.shape)
        if (shapes[name], found[name].dtype) != (shape, spec.dtype):
            text = f"{shapes[name]}, {found[name].dtype}; not {shape}, {spec.dtype}"
            raise ValueError(f"{path} is damaged: {name} is {text}")
    for name, rows in STARTS.items():
        start = found[name][...]
        if start[0] != 0 or start[-1] != sizes[rows] or (np.diff(start) < 0).any():
            raise ValueError(f"{path} is damaged: {name} must ascend from 0 to {sizes[rows]}")
    return sizes


def datasets(file: Any) -> Iterator[tuple[str, Any]]:
    """Go through all datasets of a file, path and dataset, in its order."""
    for axis, group in file.items():
        for name, data in group.items():
            yield f"{axis}/{name}", data


def row_count(file: Any, axis: str) -> int:
    """Count the rows of an axis, by a dataset that is not one of offsets."""
    name, lead = _COUNTED[axis]
    return int(dataset(file, f"{axis}/{name}").shape[lead])
