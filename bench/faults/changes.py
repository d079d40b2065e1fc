"""What is done to a file: cut, flipped, every dataset, attribute and value missing, of another type, out of range."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bench.faults.originals import FOLDERS, NAMES


class Hostile(NamedTuple):
    """A changed file."""

    kind: str
    """What it was: a key of ``LOADERS``."""
    name: str
    """What was done to it."""
    write: Callable[[Path, Path], Any]
    """Writes it: from the original, to a path."""
    refused: bool = False
    """Whether it must be refused even if it loads as the original does."""


def bytes_changed(kind: str, size: int, rng: np.random.Generator) -> Iterator[Hostile]:
    """Cut short, overwritten, flipped, and something else entirely."""

    def changed(change: Callable[[bytearray], bytes | bytearray]) -> Callable[[Path, Path], Any]:
        return lambda source, target: target.write_bytes(change(bytearray(source.read_bytes())))

    for part in (0, 1, 7, 8, 100, 512, *np.linspace(600, size - 1, 16).astype(int).tolist()):
        if part < size:
            yield Hostile(kind, f"cut after {part} B", changed(lambda data, n=part: data[:n]))  # type: ignore[misc]
    for _ in range(24):
        place, bit = int(rng.integers(size)), int(rng.integers(8))

        def flip(data: bytearray, place: int = place, bit: int = bit) -> bytearray:
            data[place] ^= 1 << bit
            return data

        yield Hostile(kind, f"bit {bit} of byte {place} flipped", changed(flip))
    for _ in range(12):
        place, new = int(rng.integers(size)), rng.bytes(64)

        def overwrite(data: bytearray, place: int = place, new: bytes = new) -> bytearray:
            data[place : place + len(new)] = new
            return data[:size]

        yield Hostile(kind, f"64 B from {place} overwritten", changed(overwrite))
    yield Hostile(kind, "doubled", changed(lambda data: data + data))
    yield Hostile(kind, "text", changed(lambda data: b"not what it says it is\n" * 40))
    yield Hostile(kind, "zeros", changed(lambda data: bytes(size)))
    yield Hostile(kind, "noise", changed(lambda data: np.random.default_rng(1).bytes(size)))
    yield Hostile(kind, "a folder", lambda source, target: target.mkdir())


def hdf5_changed(kind: str, original: Path) -> Iterator[Hostile]:
    """Every dataset, group and attribute: missing, of another type or shape, of other values, from elsewhere."""
    import h5py

    names: list[tuple[str, Any]] = []
    with h5py.File(original, "r") as file:
        file.visititems(lambda name, node: names.append((name, None if isinstance(node, h5py.Group) else node.dtype)))
        attributes = [("/", name) for name in file.attrs]
        attributes += [(group, name) for group, dtype in names if dtype is None for name in file[group].attrs]

    def edit(change: Callable[[Any], None]) -> Callable[[Path, Path], Any]:
        def write(source: Path, target: Path) -> None:
            target.write_bytes(source.read_bytes())
            with h5py.File(target, "r+") as file:
                change(file)

        return write

    for name, dtype in names:
        if dtype is None:
            yield Hostile(kind, f"group {name} missing", edit(lambda f, n=name: f.__delitem__(n)))  # type: ignore[misc]
            yield Hostile(kind, f"group {name} a number", edit(lambda f, n=name: put(f, n, np.float64(3.0))))  # type: ignore[misc]
            continue
        for what, change in dataset_changes(dtype).items():
            must = what in FROM_OUTSIDE
            yield Hostile(kind, f"{name} {what}", edit(lambda f, n=name, c=change: c(f, n)), must)  # type: ignore[misc]
    for group, name in attributes:
        for what, value in ATTRIBUTES.items():

            def change(file: Any, group: str = group, name: str = name, value: Any = value) -> None:
                del file[group].attrs[name]
                if value is not None:
                    file[group].attrs[name] = value

            yield Hostile(kind, f"attribute {group} {name} {what}", edit(change))


FROM_OUTSIDE = ("an external link", "in an external file", "a virtual one of another file")
ATTRIBUTES: dict[str, Any] = {
    "missing": None,
    "text": "none of this",
    "not a number": np.nan,
    "negative": -3,
    "huge": 2**62,
    "fractional": 1.5,
    "an array": np.arange(3.0),
    "empty text": "",
}


def put(file: Any, name: str, values: Any) -> None:
    """Replace a dataset, with its attributes."""
    kept = dict(file[name].attrs)
    del file[name]
    file[name] = values
    file[name].attrs.update(kept)


def dataset_changes(dtype: np.dtype) -> dict[str, Callable[[Any, str], None]]:
    """What is done to a dataset of a type, by name."""
    import h5py

    def values(change: Callable[[np.ndarray], Any]) -> Callable[[Any, str], None]:
        return lambda file, name: put(file, name, change(np.array(file[name][...])))

    def element(value: Any, where: int) -> Callable[[np.ndarray], np.ndarray]:
        def change(array: np.ndarray) -> np.ndarray:
            if array.size:
                array.reshape(-1)[(0, array.size // 2, array.size - 1)[where]] = value
            return array

        return change

    def element_text(text: bytes) -> Callable[[np.ndarray], np.ndarray]:
        return lambda array: np.array([text, *array.reshape(-1)[1:].tolist()])

    def link(file: Any, name: str, made: Any) -> None:
        del file[name]
        file[name] = made

    def external(file: Any, name: str) -> None:
        array, outside = np.array(file[name][...]), Path(file.filename).with_name("outside.raw")
        outside.write_bytes(array.tobytes() + b"\0")
        del file[name]
        file.create_dataset(name, array.shape, array.dtype, external=[(str(outside), 0, max(array.nbytes, 1))])

    def other_file(file: Any, name: str) -> Path:
        outside = Path(file.filename).with_name("outside.h5")
        with h5py.File(outside, "w") as target:
            target["data"] = np.array(file[name][...])
        return outside

    def external_link(file: Any, name: str) -> None:
        link(file, name, h5py.ExternalLink(str(other_file(file, name)), "data"))

    def virtual(file: Any, name: str) -> None:
        array, outside = np.array(file[name][...]), other_file(file, name)
        layout = h5py.VirtualLayout(array.shape, array.dtype)
        if array.size:
            layout[...] = h5py.VirtualSource(str(outside), "data", array.shape, array.dtype)
        del file[name]
        file.create_virtual_dataset(name, layout)

    def claimed(file: Any, name: str) -> None:
        shape = file[name].shape
        del file[name]
        shape = (2**33, *shape[1:]) if shape else (2**33,)
        file.create_dataset(name, shape, dtype, chunks=(1024, *(max(n, 1) for n in shape[1:])))

    changes: dict[str, Callable[[Any, str], None]] = {
        "missing": lambda file, name: file.__delitem__(name),
        "a group": lambda file, name: (file.__delitem__(name), file.create_group(name))[0],
        "of text": values(lambda array: np.full(array.shape, b"text")),
        "of complex numbers": values(lambda array: np.ones(array.shape, np.complex128)),
        "a row short": values(lambda array: np.atleast_1d(array)[:-1]),
        "a row longer": values(
            lambda array: np.concatenate([array, array[-1:]]) if array.ndim else np.stack([array] * 2)
        ),
        "of no row": values(lambda array: array[:0] if array.ndim else np.zeros(0, array.dtype)),
        "of another rank": values(lambda array: array[None]),
        "an endless link": lambda file, name: link(file, name, h5py.SoftLink("/" + name)),
        "a link to nothing": lambda file, name: link(file, name, h5py.SoftLink("/nowhere")),
        "an external link": external_link,
        "a virtual one of another file": virtual,
        "of a size that is not there": claimed,
        "reversed": values(lambda array: np.atleast_1d(array)[::-1]),
        "rolled": values(lambda array: np.roll(array, 1, axis=0) if array.ndim else array),
    }
    if dtype.kind in "fiu":
        changes |= {
            "in an external file": external,
            "negated": values(lambda array: array * np.array(-1).astype(array.dtype)),
        }
    if dtype.kind in "fiu":
        changes["of wider numbers"] = values(lambda a: a.astype(np.longdouble if a.dtype.kind == "f" else np.float64))
    if dtype.kind == "S":
        for text in (
            b"",
            b"..",
            b"../shard/shard-00000.h5",
            b"/dev/zero",
            b"/etc/passwd",
            b"shard-00000.h5/..",
            b"\xff",
        ):
            changes[f"first {text!r}"] = values(element_text(text))
        changes["all alike"] = values(lambda array: np.full(array.shape, array.reshape(-1)[0]))
    for where, place in enumerate(("first", "middle", "last")):
        if dtype.kind == "f":
            for label, number in (("NaN", np.nan), ("inf", np.inf), ("-1", -1.0), ("1e30", 1e30)):
                changes[f"{place} {label}"] = values(element(number, where))
        elif dtype.kind in "iu":
            top = np.iinfo(dtype).max
            for label, number in (("all bits", -1), ("most", top), ("7", 7), ("200", 200)):
                changes[f"{place} {label}"] = values(element(np.array(number).astype(dtype), where))
    return changes


def tensors_changed(kind: str, original: Path) -> Iterator[Hostile]:
    """Every entry of the header of a safetensors file, and the values of every tensor."""
    data = original.read_bytes()
    (length,) = struct.unpack("<Q", data[:8])
    header, body = json.loads(data[8 : 8 + length]), data[8 + length :]

    def file(header: Any, body: bytes = body) -> Callable[[Path, Path], Any]:
        text = json.dumps(header).encode()
        return lambda source, target: target.write_bytes(struct.pack("<Q", len(text)) + text + body)

    for size in (0, 1, length - 1, length + 1, len(data), 2**31, 2**63, 2**64 - 1):
        whole = struct.pack("<Q", size) + data[8:]
        yield Hostile(kind, f"header of {size} B", lambda source, target, w=whole: target.write_bytes(w))  # type: ignore[misc]
    for name, value in header.items():
        rest = {key: item for key, item in header.items() if key != name}
        yield Hostile(kind, f"{name} missing", file(rest))
        yield Hostile(kind, f"{name} of another name", file({**rest, f"{name}x": value}))
        yield Hostile(kind, f"{name} null", file({**rest, name: None}))
        if name == "__metadata__":
            for key, text in value.items():
                for what, new in metadata_changes(text):
                    yield Hostile(kind, f"metadata {key} {what}", file({**rest, name: {**value, key: new}}))
                less = {k: v for k, v in value.items() if k != key}
                yield Hostile(kind, f"metadata {key} missing", file({**rest, name: less}))
            continue
        first, last = value["data_offsets"]
        changes: dict[str, dict[str, Any]] = {
            "dtype I64": {"dtype": "I64"},
            "dtype F16": {"dtype": "F16"},
            "dtype X": {"dtype": "X"},
            "shape of a row more": {"shape": [*value["shape"][:-1], (value["shape"] or [0])[-1] + 1]},
            "shape negative": {"shape": [-1]},
            "shape huge": {"shape": [2**40, 2**20]},
            "offsets swapped": {"data_offsets": [last, first]},
            "offsets outside": {"data_offsets": [first, len(body) + 4]},
            "offsets of the first": {"data_offsets": [0, last - first]},
        }
        for what, changed in changes.items():
            yield Hostile(kind, f"{name} {what}", file({**rest, name: {**value, **changed}}))
        if value["dtype"] == "F32" and last > first:
            for what, number in (("NaN", np.nan), ("inf", np.inf)):
                new = bytearray(body)
                new[first : first + 4] = np.float32(number).tobytes()
                yield Hostile(kind, f"{name} first {what}", file(header, bytes(new)))


def metadata_changes(text: str) -> Iterator[tuple[str, Any]]:
    """Texts in the place of one, which may be JSON: every entry of that changed."""
    yield from (("empty", ""), ("another", "nothing known"), ("a number", "7"), ("a list", "[1, 2]"), ("null", "null"))
    try:
        known = json.loads(text)
    except ValueError:
        return
    if isinstance(known, dict):
        for key, value in known.items():
            yield f"without {key}", json.dumps({k: v for k, v in known.items() if k != key})
            others: tuple[Any, ...] = (None, "text", -1, 10**9, 1.5, float("nan"), [], {})
            for new in others:
                if type(new) is not type(value) or new != value:
                    yield f"{key} {new!r}", json.dumps({**known, key: new})


def toml_changed(kind: str, original: Path) -> Iterator[Hostile]:
    """Every value in turn of another type or out of range, every line missing, twice or broken."""
    lines = original.read_text().splitlines()

    def text(lines: list[str]) -> Callable[[Path, Path], Any]:
        return lambda source, target: target.write_text("\n".join(lines) + "\n")

    values = ("nan", "inf", "-1", "0", "1e400", "9223372036854775808", "1.5", "true", '"text"', "[1, 2]", "[]", "{}",
              "1979-05-27", "[nan, nan]", "[2, 1]", '["a", "b"]', "1e-320", "99999999999999999999999999")  # fmt: skip
    for i, line in enumerate(lines):
        yield Hostile(kind, f"without {line!r}", text(lines[:i] + lines[i + 1 :]))
        if not line:
            continue
        yield Hostile(kind, f"twice {line!r}", text([*lines[: i + 1], *lines[i:]]))
        yield Hostile(kind, f"unknown beside {line!r}", text([*lines[: i + 1], "unheard_of = 3", *lines[i + 1 :]]))
        if "=" in line:
            name = line.partition("=")[0].strip()
            for value in values:
                yield Hostile(kind, f"{name} = {value}", text([*lines[:i], f"{name} = {value}", *lines[i + 1 :]]))


def hostile_files(originals: Path, kind: str) -> list[Hostile]:
    """All changes of the file of a kind."""
    original = originals / FOLDERS.get(kind, kind) / NAMES[kind]
    rng = np.random.default_rng(sorted(NAMES).index(kind))
    found = list(bytes_changed(kind, original.stat().st_size, rng))
    if original.suffix in (".h5", ".hdf5"):
        return found + list(hdf5_changed(kind, original))
    return found + list((toml_changed if original.suffix == ".toml" else tensors_changed)(kind, original))
