"""Data sets on disk: HDF5 shards of whole worlds, and an index that shows them as one.

A folder holds ``shard-00000.h5``, ``shard-00001.h5``, ... and, once all are there, ``index.h5``. The unit of data is a
*state*: one world at one step, its bodies before the step and the contacts of the step. Arrays are flat: worlds one
after the other, the steps of a world one after the other, the bodies or contacts of a step one after the other.

=============  ====================================================================================================
axis           rows
=============  ====================================================================================================
world          one for each world; its rows in ``body``, ``shape`` and ``step`` are ``world/body_start[w]`` up to
               ``world/body_start[w + 1]``, and so on
drawn          one for each world: what was drawn for it from its own seed
body, shape    what does not change; indices of bodies count from the world's first one
vertex         of shape k: ``shape/vertex_start[k]`` up to ``shape/vertex_start[k + 1]``
step           one for each state; its rows in ``motion`` and ``contact`` are ``step/motion_start[s]`` up to
               ``step/motion_start[s + 1]``, and ``step/contact_start[s]`` up to ``step/contact_start[s + 1]``
motion         one for each body at each step: where it is before the step
contact        one for each contact at each step, sorted by key
grid           one for each state, with ``grids``: what ``dc.Images`` shows of it
=============  ====================================================================================================

``contact/impulse`` is (3, contacts, 2): the start of the solve (the impulse of the step before, 0 where ``age`` is 0),
what it ended with at the run's tolerance, and the label, solved on from there to the label's tolerance. The three
stand in one dataset because a start repeats the solution of the step before: compression then stores it once.

Every dataset has ``unit`` and ``meaning``, gzip, shuffle and a Fletcher checksum. Attributes of a file: ``schema``
(``deep-contact.dataset``), ``version`` (1), ``kind`` (shard or index), ``config`` and ``versions`` (JSON), ``seed`` of
the first world, ``worlds``, ``steps``, ``flags`` (all ``step/flags`` or-ed), ``label_reached`` (share of the states).
In the index ``*_start`` count through all shards and the other datasets are virtual: they show those of the shards,
whose names are in ``shard/name``.

A file is built in memory and written in one go under a temporary name, then renamed: HDF5 itself would crash the
process on a full disk, and a kill leaves nothing but a temporary file. Chunks are compressed beside HDF5, which lets
one thread at a time in.
"""

from __future__ import annotations

import io
import json
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dc_kernels.model.arrays import numpy_spec
from dc_kernels.model.fields import CONTACTS, MODEL, STATE, Field
from dc_kernels.runtime.optional import require
from pipeline.files import versions, write_bytes

SCHEMA = "deep-contact.dataset"
VERSION = 1
INDEX = "index.h5"
ROWS = 8192
"""Rows of a chunk: within the 32 KB that gzip looks back, a step's contacts find those of the steps before [1]."""
LEVEL = 1
"""Of gzip: 4 would take 3 % less room and a quarter more time."""
STAGES = ("start", "impulse", "label")
_CHECKSUM = 4  # bytes
_FLOAT32 = np.dtype(np.float32)


class Column(NamedTuple):
    """One dataset: its axis comes after ``lead``."""

    dtype: np.dtype
    unit: str
    meaning: str
    shape: tuple[int, ...] = ()
    lead: tuple[int, ...] = ()


def _column(field: Field, dtype: Any = None) -> Column:
    found, shape = numpy_spec(field, _FLOAT32)
    return Column(np.dtype(dtype or found), field.unit, field.meaning, shape)


def _columns(table: Mapping[str, Field], *names: str) -> dict[str, Column]:
    return {name: _column(table[name]) for name in names}


def _new(dtype: Any, unit: str, meaning: str, shape: tuple[int, ...] = (), lead: tuple[int, ...] = ()) -> Column:
    return Column(np.dtype(dtype), unit, meaning, shape, lead)


# group = axis: datasets
LAYOUT: dict[str, dict[str, Column]] = {
    "world": {
        "seed": _new("int64", "1", "the world is the scene's world of this seed"),
        "dt": _new("float32", "s", "time step"),
        **_columns(MODEL, "gravity", "origin", "length_scale"),
        "body_start": _new("int64", "1", "first row of each world in body"),
        "shape_start": _new("int64", "1", "first row of each world in shape"),
        "step_start": _new("int64", "1", "first row of each world in step"),
    },
    "body": _columns(MODEL, "body_type", "mass", "inertia"),
    "shape": {
        "shape_body": _new("int32", "1", "body of the shape, from the world's first"),
        **_columns(MODEL, "shape_type", "shape_radius", "shape_friction", "shape_restitution"),
        "vertex_start": _new("int64", "1", "first row of each shape in vertex"),
    },
    "vertex": _columns(MODEL, "vertices"),
    "step": {
        "step": _new("int32", "1", "steps before this one"),
        "motion_start": _new("int64", "1", "first row of each state in motion"),
        "contact_start": _new("int64", "1", "first row of each state in contact"),
        "sweeps": _new("int32", "1", "sweeps of the solve to the run's tolerance"),
        "change": _new("float32", "N s", "largest impulse change of its last sweep"),
        "residual": _new("float32", "1", "relative natural map at its end"),
        "label_sweeps": _new("int32", "1", "further sweeps to the label"),
        "label_change": _new("float32", "N s", "largest impulse change of the last of them"),
        "label_residual": _new("float32", "1", "relative natural map of the label"),
        "label_reached": _new("uint8", "1", "1 where the label's tolerance was reached"),
        "flags": _new("int32", "1", "dc_kernels.Flag bits after the step: not 0, then the state is not valid"),
    },
    "motion": _columns(STATE, "position", "angle", "velocity", "angular_velocity"),
    "contact": {
        **_columns(CONTACTS, "key"),
        "body_a": _new("int32", "1", "body A, from the world's first"),
        "body_b": _new("int32", "1", "body B, from the world's first"),
        "point": _new("float32", "m", "place of the contact, relative to the world's origin", (2,)),
        **_columns(CONTACTS, "normal", "gap", "friction", "restitution", "age"),
        "color": _column(CONTACTS["color"], "uint8"),
        "impulse": _new(
            "float32",
            "N s",
            "start, solution at the run's tolerance, label; of each normal and tangential impulse",
            (2,),
            (len(STAGES),),
        ),
    },
}
# axes of length n + 1, and the group that their entries are rows of
STARTS = {
    "world/body_start": "body",
    "world/shape_start": "shape",
    "world/step_start": "step",
    "shape/vertex_start": "vertex",
    "step/motion_start": "motion",
    "step/contact_start": "contact",
}


def shard_path(folder: Path, number: int) -> Path:
    """Path of a shard."""
    return folder / f"shard-{number:05d}.h5"


# ---------------------------------------------------------------------- writing


def fletcher32(data: bytes) -> bytes:
    """The checksum that HDF5 appends to a chunk: sums modulo 65535 of 16-bit words and of their partial sums."""
    words = np.frombuffer(data if len(data) % 2 == 0 else data + b"\0", ">u2").astype(np.uint64)
    first = int(words.sum())
    second = int(np.dot(words, np.arange(len(words), 0, -1, dtype=np.uint64)))
    # the sums are folded, not divided: a multiple of 65535 is 65535, only 0 is 0
    first, second = ((total - 1) % 65535 + 1 if total else 0 for total in (first, second))
    return (second << 16 | first).to_bytes(_CHECKSUM, "little")


class Packed(NamedTuple):
    """A dataset as HDF5 stores it: shape, chunk, and each chunk's place and bytes."""

    dtype: np.dtype
    shape: tuple[int, ...]
    chunk: tuple[int, ...]
    chunks: list[tuple[tuple[int, ...], bytes]]


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
    packed: Mapping[str, Packed], describe: Mapping[str, Column], attributes: Mapping[str, Any]
) -> memoryview:
    """An HDF5 file of these datasets by path, as bytes."""
    h5py = require("h5py", "pipeline")
    buffer = io.BytesIO()
    with h5py.File(buffer, "w", libver=("v110", "v110")) as file:  # checksums of the structure, too
        file.attrs.update(attributes)
        for name, item in packed.items():
            _create(file, name, item, describe[name])
    return buffer.getbuffer()


def _create(file: Any, name: str, item: Packed, column: Column) -> None:
    filters: dict[str, Any] = {}
    if item.chunks:
        filters = {"chunks": item.chunk, "compression": "gzip", "compression_opts": LEVEL}
        filters.update(shuffle=True, fletcher32=True)
    data = file.create_dataset(name, item.shape, item.dtype, **filters)
    data.attrs.update(unit=column.unit, meaning=column.meaning)
    if column.lead == (len(STAGES),):
        data.attrs["stages"] = STAGES
    for place, block in item.chunks:
        data.id.write_direct_chunk(place, block)


def shard_image(
    arrays: Iterable[tuple[str, np.ndarray]], extra: Mapping[str, Column], attributes: Mapping[str, Any]
) -> memoryview:
    """A shard as bytes.

    Args:
        arrays: path and values of the datasets of ``LAYOUT`` and ``extra``; each is packed before the next is made.
        extra: what stands beside ``LAYOUT``: drawn parameters and grids.
        attributes: of the file, besides those of every file.
    """
    describe = {**_described(), **extra}
    packed = {}
    for name, values in arrays:
        column = describe[name]
        values = np.ascontiguousarray(values, column.dtype)
        size = values[..., :1, :].nbytes if column.lead else values[:1].nbytes
        packed[name] = pack(values, len(column.lead), max(1, min(ROWS, 2**20 // max(size, 1))))
    common = {"schema": SCHEMA, "version": VERSION, "kind": "shard", "versions": json.dumps(versions())}
    return file_image(packed, describe, {**common, **attributes})


def _described() -> dict[str, Column]:
    return {f"{axis}/{name}": column for axis, columns in LAYOUT.items() for name, column in columns.items()}


def remove_partial(folder: Path) -> int:
    """Remove what killed runs left under temporary names; returns how many."""
    left = [path for stem in ("shard-*", "index") for path in folder.glob(f".{stem}.*.partial.h5")]
    for path in left:
        path.unlink(missing_ok=True)
    return len(left)


# ---------------------------------------------------------------------- reading


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """A shard or index, open to read.

    Raises:
        ValueError: naming it, when it is foreign or damaged, also when that shows while it is read.
        OSError: when there is none, or it must not be read.
    """
    h5py = require("h5py", "pipeline")
    try:
        file = h5py.File(path, "r")
    except (FileNotFoundError, PermissionError):
        raise
    except OSError as error:
        raise ValueError(f"{path} is not an HDF5 file, or is truncated: {error}") from error
    with file:
        try:
            check_schema(file, path)
            yield file
        except (KeyError, OSError, RuntimeError) as error:
            raise ValueError(f"{path} is damaged: {error}") from error


def check_schema(file: Any, path: Path) -> None:
    """Raise ``ValueError`` unless the file is of a data set that this version reads."""
    schema, version = file.attrs.get("schema"), file.attrs.get("version")
    if not isinstance(schema, str) or schema != SCHEMA:
        raise ValueError(f"{path} is not a file of a {SCHEMA}: its attribute 'schema' is {schema!r}")
    if version != VERSION:
        raise ValueError(f"{path} has version {version} of {SCHEMA}; this version reads {VERSION}")


def config_of(file: Any) -> dict[str, Any]:
    """The configuration that a file was made with."""
    return json.loads(file.attrs["config"])


def difference(found: Mapping[str, Any], wanted: Mapping[str, Any], prefix: str = "") -> str | None:
    """The first setting in which two configurations differ, as text; None if in none."""
    for name in dict.fromkeys([*wanted, *found]):
        one, other = found.get(name), wanted.get(name)
        if isinstance(one, Mapping) and isinstance(other, Mapping):
            text = difference(one, other, f"{prefix}{name}.")
            if text:
                return text
        elif one != other or (name in found) != (name in wanted):
            return f"{prefix}{name} = {one!r}, not {other!r}"
    return None


def check_shard(path: Path, config: Mapping[str, Any], seed: int, worlds: int) -> None:
    """Raise ``ValueError`` unless a shard is whole and holds these worlds of this configuration.

    Every chunk's checksum is computed anew, and every ``*_start`` looked at; nothing is decompressed but these.
    """
    with opened(path) as file:
        text = difference(config_of(file), config)
        if text:
            raise ValueError(f"{path} was made with {text}; go on with the same configuration, or in another folder")
        found = file.attrs["kind"], int(file.attrs["seed"]), int(file.attrs["worlds"])
        if found != ("shard", seed, worlds):
            raise ValueError(
                f"{path} is {found[0]} of {found[2]} worlds from seed {found[1]}, not {worlds} from {seed}"
            )
        if not np.array_equal(file["world/seed"][...], np.arange(seed, seed + worlds)):
            raise ValueError(f"{path} is damaged: world/seed does not count from {seed} to {seed + worlds - 1}")
        sizes = {axis: _rows(file, axis) for axis in LAYOUT}
        for name, column in _described().items():
            axis = name.split("/")[0]
            shape = (*column.lead, sizes[axis] + (name in STARTS), *column.shape)
            data = file[name]
            if (data.shape, data.dtype) != (shape, column.dtype):
                raise ValueError(
                    f"{path} is damaged: {name} is {data.shape}, {data.dtype}; not {shape}, {column.dtype}"
                )
        for name, rows in STARTS.items():
            start = file[name][...]
            if start[0] != 0 or start[-1] != sizes[rows] or (np.diff(start) < 0).any():
                raise ValueError(f"{path} is damaged: {name} must ascend from 0 to {sizes[rows]}")
        for name, data in datasets(file):
            _check_chunks(path, name, data)


def datasets(file: Any) -> Iterator[tuple[str, Any]]:
    """All datasets of a file by path, in its order."""
    for axis, group in file.items():
        for name, data in group.items():
            yield f"{axis}/{name}", data


def _rows(file: Any, axis: str) -> int:
    """Length of an axis, by a dataset that is not one of offsets."""
    name, column = next((n, c) for n, c in LAYOUT[axis].items() if f"{axis}/{n}" not in STARTS)
    return int(file[f"{axis}/{name}"].shape[len(column.lead)])


def _check_chunks(path: Path, name: str, data: Any) -> None:
    if data.chunks is None:
        return
    axis = next((i for i, (n, c) in enumerate(zip(data.shape, data.chunks)) if n != c), 0)
    for first in range(0, data.shape[axis], data.chunks[axis]):
        place = tuple(first if i == axis else 0 for i in range(data.ndim))
        block = bytes(data.id.read_direct_chunk(place)[1])
        if fletcher32(block[:-_CHECKSUM]) != block[-_CHECKSUM:]:
            raise ValueError(f"{path} is damaged: {name} has another checksum from row {first} on")


# ---------------------------------------------------------------------- the index


def write_index(folder: Path, shards: Sequence[Path]) -> None:
    """Write the index over whole shards: offsets through all of them, the rest as virtual datasets.

    Raises:
        ValueError: for a damaged or foreign shard.
        OSError: when the index cannot be written.
    """
    h5py = require("h5py", "pipeline")
    starts: dict[str, list[np.ndarray]] = {name: [] for name in STARTS}
    sources: dict[str, list[tuple[str, tuple[int, ...]]]] = {}
    described: dict[str, tuple[np.dtype, dict[str, Any]]] = {}
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
                sources.setdefault(name, []).append((path.name, data.shape))
                described.setdefault(name, (data.dtype, dict(data.attrs)))
            for axis in LAYOUT:
                sizes[axis] += _rows(file, axis)
            first_world.append(sizes["world"])
            attributes = attributes or dict(file.attrs)
            flags |= int(file.attrs["flags"])
            worlds += int(file.attrs["worlds"])
            reached += float(file.attrs["label_reached"]) * _rows(file, "step")
            states += _rows(file, "step")
    attributes.update(kind="index", worlds=worlds, flags=flags, label_reached=reached / max(states, 1))
    describe = _described()
    packed = {name: pack(np.concatenate(parts)) for name, parts in starts.items()}
    names = np.array([path.name for path in shards], "S")
    packed |= {"shard/name": pack(names), "shard/world_start": pack(np.array(first_world))}
    describe["shard/name"] = _new(names.dtype, "1", "file of the shard, in the index's folder")
    describe["shard/world_start"] = _new("int64", "1", "first world of each shard")
    buffer = io.BytesIO()
    with h5py.File(buffer, "w", libver=("v110", "v110")) as file:
        file.attrs.update(attributes)
        for name, item in packed.items():
            _create(file, name, item, describe[name])
        for name, parts in sources.items():
            dtype, attrs = described[name]
            along = len(describe[name].lead) if name in describe else 0
            shape = list(parts[0][1])
            shape[along] = sum(part[along] for _, part in parts)
            layout, row = h5py.VirtualLayout(tuple(shape), dtype), 0
            for source, part in parts:
                rows = slice(row, row + part[along])
                if part[along]:
                    layout[(slice(None),) * along + (rows,)] = h5py.VirtualSource(source, name, part, dtype)
                row += part[along]
            file.create_virtual_dataset(name, layout).attrs.update(attrs)
    write_bytes(folder / INDEX, buffer.getbuffer())
