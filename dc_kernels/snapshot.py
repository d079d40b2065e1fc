"""Snapshots: everything that a simulation needs to continue, in one HDF5 file.

Groups ``model``, ``state``, ``joints`` and ``contacts`` hold the arrays of ``model/fields.py`` under their names, each
with its unit, meaning and axis as attributes; contacts are packed, world after world, without unused slots
(``contact_start`` has the first slot of each world). ``config`` has the solver's settings as attributes. Saving and
loading keep every bit, so a run that continues from a snapshot on the same device equals one that never stopped.

An unfinished step, in a world that froze or after an OverflowError, leaves its contacts in ``contacts``,
while the next step starts from those of the last finished step; only then the group ``cache`` holds the latter.
With sleep the group ``sleepers`` tells which bodies sleep, and holds their contacts; with sensors or
contact events ``overlaps`` and ``touches`` hold their lists; after bodies, shapes or joints were added or removed
``ids`` has their ids. ``stats`` has the statistics of the last solve; files of earlier versions without it are also
read, and so are those without ``rolling_impulse`` of contacts, which is then zero.
"""

from __future__ import annotations

import copy
import os
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, BinaryIO, TypeVar

import numpy as np

from dc_kernels.driving.ids import IDS, KINDS, Ids, check_ids
from dc_kernels.measure import contact_slots
from dc_kernels.model.arrays import ArrayGroup, Model, State
from dc_kernels.model.config import SimulationOptions, SolverConfig
from dc_kernels.model.dtypes import float_dtype, numpy_spec
from dc_kernels.model.fields import CACHE, CONTACTS, ITERATION, PER_CONTACT, ROLLING, SLEEPERS, STATS, TRAITS, Field
from dc_kernels.model.groups import GROUPS
from dc_kernels.model.joints.groups import Joints
from dc_kernels.model.room import used_slots
from dc_kernels.model.rules import BrokenRule, refuse
from dc_kernels.model.settings import WrongType, check_choice, shown
from dc_kernels.model.validate.scene import check_joints, check_model, check_state
from dc_kernels.runtime.backends import BACKENDS, check_device
from dc_kernels.runtime.files import file_name, write_file
from dc_kernels.runtime.hdf5 import image, reading
from dc_kernels.runtime.imports import require
from dc_kernels.runtime.inputs import check_count, check_file
from dc_kernels.runtime.threads import usable_cores

if TYPE_CHECKING:
    from dc_kernels.simulation import Simulation

Group = TypeVar("Group", bound=ArrayGroup)
Made = TypeVar("Made", bound="Simulation")

SCHEMA = "deep-contact snapshot"
SCHEMA_VERSION = 1
CACHED = "cached contact"
KEPT = "sleeping contact"
SOLVED = {name: STATS[name] for name in ("sweeps", "change", "residual", "colors")}
EVENTS = ("overlaps", "touches")
"""Groups of lists, which are there where sensors or contact events are."""
SOLVED["finished"] = ITERATION["finished"]
"""What is kept of the last solve."""
_AXES = ("world", "body", "shape", "vertex", "joint", "joint row", "contact")


def save(sim: Simulation, path: str | os.PathLike[str] | BinaryIO) -> None:
    """Write a snapshot, between steps, to a path or to an open binary file, such as ``io.BytesIO()``.

    A file at a path is complete or missing: it is written under another name in the same folder and renamed at the
    end, so that a full disk or a kill never damages an existing file. Links are followed.

    Raises:
        ValueError: it is called between ``collide`` and ``advance``, or the arrays hold values that ``load`` would
            refuse; the error names array, index, value and limit.
        OSError: the file, which the error names, cannot be written, or is a folder, a device or a FIFO.
        TypeError: ``path`` is neither a path nor a binary file.
        ImportError: h5py is not installed; the error names the extra.
    """
    path = check_file("path", path, "write")
    require("h5py", "pipeline")
    if sim.phase != "advance":
        raise ValueError("save() in the middle of a step: finish it with solve() and advance(), or take a step")
    model, state = sim.model.views(), sim.state.views()
    check_model(model, backend=sim.model.backend)
    check_state(state, model, frozen=True, backend=sim.model.backend)
    check_joints(sim.joints.views(), model)
    write_file(path, image(lambda file: _write(file, sim)))


def load(
    make: Callable[..., Made],
    path: str | os.PathLike[str] | BinaryIO,
    threads: int | None = None,
    *,
    device: str | None = None,
    backend: str | None = None,
    **options: Any,
) -> Made:
    """Return the simulation of a snapshot.

    Args:
        make: the class ``Simulation``, or a function of the constructor's arguments.
        path: path of the file, or an open binary file, read from its position to its end.
        threads: number of threads; the result does not depend on it. None: the saved number, but no more
            than there are cores.
        device: "cpu" or a CUDA device of Warp; None: the saved device.
        backend: "warp", "numpy" or "taichi"; None: the saved backend.
        **options: options of the constructor of ``Simulation``, instead of the saved ones.

    Raises:
        ValueError: the file is not a snapshot, truncated or damaged, or of another schema version; a dataset is missing
            or has another shape or dtype; a value violates the rule of its field; values are in other
            files, or sizes exceed the file (``runtime.hdf5``). The error names file and dataset.
        OSError: the file does not exist, is a folder, FIFO or device, or must not be read.
        TypeError: ``path`` is neither a path nor a binary file.
        ImportError: h5py is not installed; the error names the extra.
    """
    path = check_file("path", path, "read")
    threads = None if threads is None else check_count("threads", threads)
    label = file_name(path)
    with reading(path, schema=SCHEMA) as file:
        header = _Header(file, label)
        tables = {"model": Model.table, "state": State.table, "joints": Joints.table, "contacts": CONTACTS}
        values = {name: _read(file, label, name, table, header) for name, table in tables.items()}
        cache = _read(file, label, "cache", CACHE, header.counting(CACHED)) if "cache" in file else None
        sleepers = _read(file, label, "sleepers", SLEEPERS, header.counting(KEPT)) if "sleepers" in file else None
        listed = {n: _read(file, label, n, GROUPS[n], header.listing(n)) for n in EVENTS if n in file}
        solved = _read(file, label, "stats", SOLVED, header) if "stats" in file else {}
        ids = _read(file, label, "ids", IDS, header) if "ids" in file else None
    contacts = values["contacts"]
    del contacts["contact_start"]  # the simulation reserves its slots itself
    count, contact_dt = contacts.pop("contact_count"), contacts.pop("contact_dt")
    backend = backend or header.backend
    device = device or header.device_of(backend)
    model = _filled(Model(header.sizes, header.real, device, backend), values["model"])
    joints = _filled(Joints(header.sizes, header.real, device, backend), values["joints"])
    state = State(header.sizes, header.real, device, backend)
    froze = values["state"]["flags"].any()
    if not froze:
        _filled(state, values["state"])
    threads = threads or min(header.threads, usable_cores())
    options = {"config": header.config, "threads": threads, **header.options, **options}
    try:
        sim = make(model, state, joints, **options)  # which checks them
    except BrokenRule as error:
        raise ValueError(f"{label}: dataset {error.place.replace('.', '/', 1)} {error.text}") from error
    where = f"{label}: dataset "
    if froze:  # afterwards: the constructor would refuse the force that froze a world
        check_state(values["state"], values["model"], f"{where}state/", frozen=True, backend=backend)
        _filled(state, values["state"])
        _filled(sim.built, values["state"])
    group = "cache"
    try:
        if cache is not None:
            cached = {name: cache[name] for name, field in CACHE.items() if field.per in PER_CONTACT and name in cache}
            sim.restore_contacts(cache["count"], cached, contact_dt)  # for the room that they need
        group = "contacts"
        sim.restore_contacts(count, contacts, contact_dt)
        if cache is not None:
            group = "cache"
            sim.storage.restore_cache(cache["count"], cached, contact_dt, cache["joint_impulse"])
        group = "sleepers"
        if sleepers is not None and sim.config.sleep:
            sim.restore_sleepers(sleepers)
        for group, lists in listed.items():
            sim.restore_lists(group, lists)
        group = "ids"
        if ids is not None:
            check_ids(ids, model)
            sim.given_ids = _filled(Ids(header.sizes, header.real, "cpu", "numpy"), ids)
            sim.storage.pass_over_empty({"body": ids["body_id"], "shape": ids["shape_id"]})
        group = "stats"
        _show_solved(sim, solved)
    except ValueError as error:
        raise ValueError(f"{where}{group}/{error}") from error
    return sim


def _show_solved(sim: Simulation, solved: Mapping[str, np.ndarray]) -> None:
    """Show what the last solve took; nothing of it matters for the next step."""
    for name, values in solved.items():
        refuse(name, values, values < 0, ">= 0")
        if name != "finished":
            sim.stats.fill(name, values)
    if solved:
        iteration = sim.stats.numpy("iteration").copy()
        for name in ("finished", "sweeps", "change"):
            iteration[name] = solved[name]
        sim.stats.fill("iteration", iteration)


def _write(file: Any, sim: Simulation) -> None:
    from dc_kernels import __version__

    model = sim.model
    file.attrs.update(
        {
            "schema": SCHEMA,
            "schema_version": SCHEMA_VERSION,
            "dc_kernels_version": __version__,
            "dtype": model.dtype.name,
            "backend": model.backend,
            "device": str(model.device),
            "schedule": sim.schedule,
            "on_overflow": sim.on_overflow,
            "specialize": sim.specialize,
            "threads": sim.most_threads,
        }
    )
    slots, _ = contact_slots(sim.contacts)
    cached = used_slots(sim.contacts.numpy("contact_start"), sim.cache.numpy("count"))
    sizes = {**model.sizes, **sim.joints.sizes, "contact": len(slots), CACHED: len(cached)}
    rolls = sim.storage.narrowphase.rolls
    if rolls:
        sizes[ROLLING] = len(slots)
    used = {"cache": cached}
    groups = {"model": model, "state": sim.state, "joints": sim.joints, "contacts": sim.contacts}
    if _unfinished(sim, slots, cached):
        groups["cache"] = sim.cache
    if sim.config.sleep:
        groups["sleepers"] = sim.sleepers
        used["sleepers"] = used_slots(sim.contacts.numpy("contact_start"), sim.sleepers.numpy("count"))
        sizes[KEPT] = len(used["sleepers"])
    lists = {name: sim.storage.packed_lists(name) for name in EVENTS if getattr(sim, name).sizes["world"]}
    groups |= {name: getattr(sim, name) for name in lists}
    listed = {GROUPS[name][field].per: len(array) for name in lists for field, array in lists[name].items()}
    sizes = {**listed, **sizes}
    names = [*_AXES, *(name for name in (*TRAITS, *listed) if sizes[name] and name not in _AXES)]
    names += (name for name, group in ((CACHED, "cache"), (KEPT, "sleepers")) if group in groups)
    names += [ROLLING] * rolls
    file.create_group("sizes").attrs.update({name: sizes[name] for name in names})
    file.create_group("config").attrs.update(
        {name: value for name, value in sim.config.to_dict().items() if value is not None}
    )
    for name, group in groups.items():
        folder = file.create_group(name)
        for field in group.table.values():
            values = lists[name][field.name] if name in lists else group.numpy(field.name)
            if (field.per in TRAITS and not len(values)) or (field.per == ROLLING and not rolls):
                continue
            if field.per in PER_CONTACT:
                values = values[used.get(name, slots)]
            _write_field(folder, field, values)
    if sim.given_ids is not None:
        folder = file.create_group("ids")
        for field in IDS.values():
            _write_field(folder, field, sim.given_ids.numpy(field.name))
    folder = file.create_group("stats")
    solved = {**sim.stats.views(), "finished": sim.stats.numpy("iteration")["finished"]}
    for field in SOLVED.values():
        _write_field(folder, field, solved[field.name])


def _write_field(folder: Any, field: Field, values: np.ndarray) -> None:
    """Write an array with its unit, meaning and axis; a checksum finds damage that HDF5 would not notice."""
    dataset = folder.create_dataset(field.name, data=values, fletcher32=True if values.size else None)
    dataset.attrs.update({"unit": field.unit, "meaning": field.meaning, "axis": field.per})


def _unfinished(sim: Simulation, slots: np.ndarray, cached: np.ndarray) -> bool:
    """Whether the contacts are others than those that the next step starts from, by any bit."""
    contacts, cache = sim.contacts, sim.cache
    pairs = [(contacts.numpy("contact_count"), cache.numpy("count"))]
    pairs.append((sim.joints.numpy("joint_impulse"), cache.numpy("joint_impulse")))
    if len(slots) == len(cached):
        names = [name for name, field in CACHE.items() if field.per in PER_CONTACT and cache.sizes[field.per]]
        pairs += [(contacts.numpy(name)[slots], cache.numpy(name)[cached]) for name in names]
    return any(one.tobytes() != other.tobytes() for one, other in pairs)


def _plain(value: Any) -> Any:
    """An attribute as Python's own number or truth value, if it is one."""
    return value.item() if isinstance(value, np.generic) else value


class _Header:
    """What a snapshot says about itself."""

    def __init__(self, file: Any, path: str) -> None:
        self.path = path
        schema, version = file.attrs.get("schema"), file.attrs.get("schema_version")
        if not isinstance(schema, str) or schema != SCHEMA:
            raise ValueError(f"{path} is not a {SCHEMA}: its attribute 'schema' is {schema!r}")
        if version != SCHEMA_VERSION:
            raise ValueError(f"{path} has schema version {version}; this version reads {SCHEMA_VERSION}")
        for name in ("sizes", "config"):
            if name not in file:
                raise ValueError(f"{path}: group {name} is missing")
        try:
            self.real = float_dtype(file.attrs["dtype"])
            self.device, self.backend = file.attrs["device"], file.attrs["backend"]
            self.threads = check_count("threads", _plain(file.attrs.get("threads", 1)))
            self.options = {name: _plain(file.attrs[name]) for name in ("schedule", "on_overflow", "specialize")}
            SimulationOptions(**self.options)
            check_choice("backend", self.backend, BACKENDS)
            if not isinstance(self.device, str):
                raise WrongType(f"device is {shown(self.device)}; it must be a str")
            sizes = {name: int(value) for name, value in file["sizes"].attrs.items()}
            self.sizes = {**{name: sizes[name] for name in _AXES}, **{name: sizes.get(name, 0) for name in TRAITS}}
            if ROLLING in sizes:
                self.sizes[ROLLING] = sizes[ROLLING]
            self._counts = {name: sizes.get(name) for name in (CACHED, KEPT)}
            self._listed = {name: size for name, size in sizes.items() if name not in self.sizes}
        except KeyError as error:
            raise ValueError(f"{path}: an attribute is missing: {error}") from error
        except (TypeError, ValueError) as error:
            raise ValueError(f"{path}: an attribute has a wrong value: {error}") from error
        self.sizes["kind"] = len(KINDS)
        self.sizes |= {f"{name}+1": self.sizes[name] + 1 for name in ("world", "body", "shape", "joint")}
        values = {name: _plain(value) for name, value in file["config"].attrs.items()}
        try:
            self.config = SolverConfig(**values)
        except (TypeError, ValueError) as error:
            raise ValueError(f"{path}: config: {error}") from error

    def device_of(self, backend: str) -> str:
        """The device that it was saved from.

        Raises:
            ValueError: where there is no such device of the backend.
        """
        try:
            return check_device(self.device, backend)
        except ValueError as error:
            raise ValueError(f"{self.path}: attribute {error}; load(device=) takes another one") from error

    def counting(self, name: str) -> _Header:
        """The header of a group that has contacts of its own, as many as the size of that name.

        Raises:
            ValueError: when it does not say how many.
        """
        count = self._counts[name]
        if count is None:
            raise ValueError(f"{self.path}: an attribute is missing: {name!r}")
        other = copy.copy(self)
        other.sizes = {**self.sizes, "contact": count, **({ROLLING: count} if ROLLING in self.sizes else {})}
        return other

    def listing(self, group: str) -> _Header:
        """The header of a group of lists; one without a size is empty."""
        other = copy.copy(self)
        axes = {field.per for field in GROUPS[group].values() if field.per not in self.sizes}
        other.sizes = {**self.sizes, **{axis: self._listed.get(axis, 0) for axis in axes}}
        return other


def _read(file: Any, path: str, group: str, table: Mapping[str, Field], header: _Header) -> dict[str, np.ndarray]:
    """The arrays of a group, of the shapes and dtypes that the header says."""
    arrays = {}
    for field in table.values():
        if field.per == ROLLING and ROLLING not in header.sizes:
            continue
        where = f"{path}: dataset {group}/{field.name}"
        dtype, components = numpy_spec(field, header.real)
        shape = (header.sizes[field.per], *components)
        if field.per in TRAITS and not shape[0]:
            arrays[field.name] = np.zeros(shape, dtype)
            continue
        try:
            dataset = file[group][field.name]
            found = getattr(dataset, "shape", None), getattr(dataset, "dtype", None)
            if found != (shape, dtype):
                raise ValueError(f"{where} has shape {found[0]}, dtype {found[1]}; it must be {shape}, {dtype}")
            values = dataset[()]
        except KeyError as error:
            raise ValueError(f"{where} is missing") from error
        except (OSError, RuntimeError) as error:
            raise ValueError(f"{where} is damaged: {error}") from error
        arrays[field.name] = values
    return arrays


def _filled(group: Group, values: dict[str, np.ndarray]) -> Group:
    """Copy bit by bit: ``assign`` would refuse what made a world freeze, such as a force that is not finite."""
    for name, value in values.items():
        group.fill(name, value)
    return group
