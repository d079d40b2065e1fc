"""The index of a data set (``layout``): all shards as one file."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dc_kernels.runtime.imports import require
from pipeline.data.layout import INDEX, LAYOUT, STARTS, DatasetSpec, described, spec_of
from pipeline.data.packing import file_image, pack
from pipeline.data.shards import datasets, opened, row_count
from pipeline.files import write_bytes


class Source(NamedTuple):
    """A dataset that the shards hold and the index shows."""

    dtype: np.dtype
    """Type of the values."""
    attributes: dict[str, Any]
    """Unit and meaning."""
    parts: list[tuple[str, tuple[int, ...]]]
    """File and shape of the dataset in each shard."""


def check_index(folder: Path) -> None:
    """Look whether a folder's index, where there is one, may be replaced.

    Raises:
        ValueError: naming the file, which is no index of a data set.
    """
    path = folder / INDEX
    if not path.exists() and not path.is_symlink():
        return
    try:
        with opened(path) as file:
            kind = file.attrs.get("kind")
    except (OSError, ValueError) as error:
        raise ValueError(f"{path} is no index of a data set; take it out of the folder ({error})") from error
    if kind != "index":
        raise ValueError(f"{path} is {kind or 'a foreign file'}, no index of a data set; take it out of the folder")


def write_index(folder: Path, shards: Sequence[Path]) -> None:
    """Write the index over whole shards: offsets through all of them, the rest as virtual datasets.

    Where a shard is missing HDF5 shows NaN or -1 (in bytes 255), not zeros.

    Raises:
        ValueError: for a damaged or foreign shard.
        OSError: when the index cannot be written.
    """
    starts: dict[str, list[np.ndarray]] = {name: [] for name in STARTS}
    sources: dict[str, Source] = {}
    attributes: dict[str, Any] = {}
    flags, worlds, reached, states = 0, 0, 0.0, 0
    sizes = dict.fromkeys(LAYOUT, 0)
    first_world = [0]
    for path in shards:
        with opened(path) as file:
            for name, data in datasets(file):
                if name in STARTS:
                    starts[name].append(data[: None if path == shards[-1] else -1] + sizes[STARTS[name]])
                    continue
                if name not in sources:
                    sources[name] = Source(data.dtype, dict(data.attrs), [])
                sources[name].parts.append((path.name, data.shape))
            for axis in LAYOUT:
                sizes[axis] += row_count(file, axis)
            first_world.append(sizes["world"])
            attributes = attributes or dict(file.attrs)
            flags |= int(file.attrs["flags"])
            worlds += int(file.attrs["worlds"])
            reached += float(file.attrs["label_reached"]) * row_count(file, "step")
            states += row_count(file, "step")
    attributes.update(kind="index", worlds=worlds, flags=flags, label_reached=reached / max(states, 1))
    attributes["config"] = json.dumps({**json.loads(attributes["config"]), "worlds": worlds})
    specs = described()
    packed = {name: pack(np.concatenate(parts)) for name, parts in starts.items()}
    names = np.array([path.name for path in shards], "S")
    packed |= {"shard/name": pack(names), "shard/world_start": pack(np.array(first_world))}
    specs["shard/name"] = spec_of(names.dtype, "1", "file of the shard, in the index's folder")
    specs["shard/world_start"] = spec_of("int64", "1", "first world of each shard")

    def add_virtual(file: Any) -> None:
        for name, source in sources.items():
            _create_virtual(file, name, source, specs.get(name))

    write_bytes(folder / INDEX, file_image(packed, specs, attributes, add_virtual))


def _create_virtual(file: Any, name: str, source: Source, spec: DatasetSpec | None) -> None:
    """Show a dataset of all shards as one, along the axis of its rows."""
    h5py = require("h5py", "pipeline")
    along = len(spec.lead) if spec is not None else 0
    shape = list(source.parts[0][1])
    shape[along] = sum(part[along] for _, part in source.parts)
    layout, row = h5py.VirtualLayout(tuple(shape), source.dtype), 0
    layout.dcpl.set_obj_track_times(False)  # the index of the same data has the same bytes
    for path, part in source.parts:
        rows = slice(row, row + part[along])
        if part[along]:
            lead = (slice(None),) * along
            # rows by number, not all: a shard that is made again for a larger set has more of them than are shown yet
            whole = h5py.VirtualSource(path, name, part, source.dtype)
            layout[(*lead, rows)] = whole[(*lead, slice(0, part[along]))]
        row += part[along]
    fill = np.nan if source.dtype.kind == "f" else np.array(-1).astype(source.dtype)
    file.create_virtual_dataset(name, layout, fillvalue=fill).attrs.update(source.attributes)
