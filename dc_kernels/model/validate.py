"""Checks of arrays from outside against the rules of the field tables, before a kernel goes by them.

A scene or a run that was made here passes; a wrong index, type, offset, colour or number is named with its array,
place, value and limit. Arrays are NumPy's and have the dtypes and shapes of their fields already. No loop runs over
worlds, and what takes several passes over many contacts takes them part by part, within the processor's cache: a check
costs a few percent of what reads or makes the arrays.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from dc_kernels.model.arrays import ArrayGroup, Joints, Model, State
from dc_kernels.model.enums import BodyType, ShapeType
from dc_kernels.model.fields import COLORS, CONTACTS, JOINTS, KEY_FEATURE_BITS, KEY_SHAPE_BITS, MODEL, STATE, Field
from dc_kernels.model.geometry import check_geometry
from dc_kernels.model.rules import Ascending, BrokenRule, Code, Index, Number, Start, Unit, refuse
from dc_kernels.model.settings import WrongType, checker

_model, _state, _joints = checker(Model), checker(State), checker(Joints)
Arrays = Mapping[str, np.ndarray]
UNIT_TOLERANCE = 2e-3  # of the squared length of a unit vector: far above rounding, far below what moves a contact
INVERSE_TOLERANCE = 1e-3  # of mass times inverse mass: inverses of large float32 numbers have few digits
PART = 2**14  # contacts that are checked together
_ELEMENTS = {"body": "bodies", "shape": "shapes", "joint": "joints", "contact": "contacts"}


class Layout:
    """Where the elements of each world lie on the axes of a scene, and of its contacts.

    Attributes:
        start: first element of each world and the number of elements, (W + 1,), by axis.
    """

    def __init__(self, model: Arrays, contact_count: np.ndarray | None = None) -> None:
        """Take the offsets of a model, which must be right, and contacts packed world after world."""
        self.start = {axis: model[f"{axis}_start"] for axis in ("body", "shape", "joint")}
        if contact_count is not None:
            self.start["contact"] = np.concatenate(([0], np.cumsum(contact_count, dtype=np.int64)))
        self._world: dict[str, np.ndarray] = {}

    def world(self, axis: str) -> np.ndarray:
        """World of each element of an axis, made once."""
        if axis not in self._world:
            start = self.start[axis]
            self._world[axis] = np.repeat(np.arange(len(start) - 1), np.diff(start))
        return self._world[axis]

    def shapes_of_contacts(self, part: slice) -> tuple[np.ndarray, np.ndarray]:
        """First shape of the world of some contacts, and one past its last."""
        start = self.start["contact"]
        stop = min(part.stop, int(start[-1]))
        w0, w1 = np.searchsorted(start, (part.start, stop - 1), "right") - 1
        edges = np.clip(start[w0 : w1 + 2], part.start, stop)
        shapes, count = self.start["shape"][w0 : w1 + 2].astype(np.int64), np.diff(edges)
        return np.repeat(shapes[:-1], count), np.repeat(shapes[1:], count)


def check_field(label: str, field: Field, values: np.ndarray, layout: Layout, part: slice = slice(0, None)) -> None:
    """Hold an array to the rule of its field; one of offsets is held to its axis by ``check_start``.

    Args:
        label: what errors call the array.
        field: whose rule it is.
        values: the array.
        layout: for indices and what is sorted within a world.
        part: rows of the array to look at.

    Raises:
        BrokenRule: naming label, index, value and limit.
    """
    rule, first = field.rule, part.start
    values = values[part]
    if not values.size:
        return
    if isinstance(rule, Number | Code | Unit):
        check_rule(label, values, rule, first)
    elif isinstance(rule, Index):
        start, world = layout.start[rule.axis], layout.world(field.per)[part]
        bad = (values < start[world]) | (values >= start[world + 1])
        if bad.any():
            w = int(world[bad.argmax()])
            within = f"{_ELEMENTS[rule.axis]} {start[w]} .. {start[w + 1] - 1}"
            refuse(label, values, bad, f"a {rule.axis} of its world {w} ({within})", first)
    elif isinstance(rule, Ascending):
        if values.min() < 0:
            refuse(label, values, values < 0, ">= 0", first)
        falls = values[1:] <= values[:-1]
        start = layout.start[field.per]
        inner = start[np.searchsorted(start, first + 1) : np.searchsorted(start, first + len(values))]
        falls[inner - (first + 1)] = False  # the first element of a world may be smaller than the one before
        refuse(label, values[1:], falls, "larger than the one before it in its world", first + 1)


def check_rule(label: str, values: np.ndarray, rule: Number | Code | Unit, first: int = 0) -> None:
    """Hold values to a rule that looks at each alone.

    Args:
        label: what errors call the array.
        values: the array, or a part of it.
        rule: what they must satisfy.
        first: row of the array at which the part begins.

    Raises:
        BrokenRule: naming label, index, value and limit.
    """
    if not values.size:
        return
    if isinstance(rule, Number):
        if _within(values, rule):
            return
        bad = ~np.isfinite(values) | (values < rule.low) | (values > rule.high)
        if rule.open:
            bad |= values == rule.low
        refuse(label, values, bad, rule.limits, first)
    elif isinstance(rule, Code):
        codes = sorted(int(value) for value in rule.values)
        if codes == list(range(len(codes))) and values.min() >= 0 and values.max() < len(codes):
            return
        names = ", ".join(f"{value.value} ({value.name})" for value in rule.values)
        refuse(label, values, ~np.isin(values, codes), f"one of {names}", first)
    else:
        square = values * values
        length = square[:, 0] + square[:, 1]
        if not (length.min() >= 1.0 - UNIT_TOLERANCE and length.max() <= 1.0 + UNIT_TOLERANCE):
            refuse(label, values, ~(np.abs(length - 1.0) <= UNIT_TOLERANCE), "a unit vector", first)


def _within(values: np.ndarray, rule: Number) -> bool:
    """Whether a glance shows that all values keep to a rule; it may miss that they do, but not that one does not."""
    low = values.min() if rule.low > -np.inf else 0.0  # NaN is neither the least nor the most of anything
    if not (low > rule.low if rule.open else low >= rule.low):
        return False
    if rule.high < np.inf:
        return bool(values.max() <= rule.high)
    if values.dtype.kind != "f":
        return True
    flat = values.reshape(-1)
    with np.errstate(over="ignore", invalid="ignore"):
        return bool(np.isfinite(np.dot(flat, flat)))  # a finite sum has finite terms


def check_start(label: str, values: np.ndarray, length: int) -> None:
    """Hold offsets to an axis of some length.

    Raises:
        BrokenRule: naming label, index, value and limit.
    """
    refuse(label, values, np.array(values[:1] != 0), "0")
    refuse(label, values[1:], values[1:] < values[:-1], "ascending, at least the one before it", 1)
    last = len(values) - 1
    refuse(label, values[last:], np.array(values[last:] != length), f"{length}, the length of its axis", last)


def check_scene(model: Model, state: State | None, joints: Joints | None) -> tuple[State, Joints]:
    """Hold a model, its state and joints to each other, to their memory as kernels need it, and to their rules.

    Returns:
        The state, and the joints, of which there are none for None.

    Raises:
        TypeError: naming what is no group of arrays; for a builder, how to make them from it.
        ValueError: naming group, array, index, value and limit: arrays of another model, dtype, device or backend, or
            values out of range.
    """
    if callable(getattr(model, "finalize", None)):
        raise WrongType(f"model is a {type(model).__name__}; give model, state and joints: *builder.finalize()")
    _model("model", model)
    state = _state("state", state)
    joints = Joints({"joint": 0}, model.dtype, model.device, model.backend) if joints is None else joints
    _joints("joints", joints)
    groups: dict[str, ArrayGroup] = {"model": model, "state": state, "joints": joints}
    for name in ("state", "joints"):
        for what in ("dtype", "device", "backend"):
            found, wanted = getattr(groups[name], what), getattr(model, what)
            if found != wanted:
                raise ValueError(f"{name}.{what} is {found}; it must be the model's, {wanted}")
    for axis in ("body", "world"):
        if state.sizes[axis] != model.sizes[axis]:
            raise ValueError(
                f"state has {state.sizes[axis]} on axis {axis!r}; it must be the model's {model.sizes[axis]}"
            )
    for name, group in groups.items():
        group.check(name)
    arrays = {name: group.views() for name, group in groups.items()}
    check_model(arrays["model"])
    check_state(arrays["state"], arrays["model"])
    check_joints(arrays["joints"], arrays["model"])
    return state, joints


def check_model(model: Arrays, label: str = "model.") -> None:
    """Hold the arrays of a ``Model`` to their rules and to each other.

    Args:
        model: all fields of ``model.fields.MODEL`` by name.
        label: what stands before the name of an array in errors.

    Raises:
        BrokenRule: naming array, index, value and limit.
    """
    lengths = {field.per: len(model[name]) for name, field in MODEL.items()}
    if lengths["world"] < 1:
        raise BrokenRule(label.rstrip("./"), "has no world; it must have one at least")
    lengths["joint"] = int(model["joint_start"][-1])  # check_joints holds the joints to it
    for name, field in MODEL.items():
        if isinstance(field.rule, Start):
            check_start(f"{label}{name}", model[name], lengths[field.rule.axis])
    layout = Layout(model)
    for name, field in MODEL.items():
        if not isinstance(field.rule, Index):  # shape_body has a closer look below
            check_field(f"{label}{name}", field, model[name], layout)

    owned = model["body_shape_start"][model["body_start"]]
    wrong = model["shape_start"] != owned
    refuse(f"{label}shape_start", model["shape_start"], wrong, "where its bodies' shapes begin (body_shape_start)")
    shapes = np.diff(model["shape_start"])
    refuse(f"the number of shapes of {label}shape_start", shapes, shapes > 2**KEY_SHAPE_BITS, f"<= {2**KEY_SHAPE_BITS}")
    _check_owners(model, layout, label)
    for part in _parts(lengths["body"]):
        _check_masses(model, part, label)
    check_geometry(model, label)


def _check_owners(model: Arrays, layout: Layout, label: str) -> None:
    """Hold bodies of shapes to the shapes of bodies, and segments to static bodies."""
    name, body, start = f"{label}shape_body", model["shape_body"], model["body_shape_start"]
    owner = np.repeat(np.arange(len(start) - 1, dtype=body.dtype), np.diff(start))
    if not np.array_equal(body, owner):
        check_field(name, MODEL["shape_body"], body, layout)
        refuse(name, body, body != owner, "the body whose shapes it stands among (body_shape_start)")
    segment = np.flatnonzero(model["shape_type"] == ShapeType.SEGMENT)
    moving = segment[model["body_type"][body[segment]] != BodyType.STATIC]
    if len(moving):
        i = int(moving[0])
        refuse(name, body[i : i + 1], np.array([True]), "a STATIC body, for the shape is a SEGMENT", i)


def _check_masses(model: Arrays, part: slice, label: str) -> None:
    """Hold masses and inertias to the types of bodies, and their inverses to them."""
    names = ("mass", "inertia", "inv_mass", "inv_inertia")
    mass, inertia, inverse_mass, inverse_inertia = (model[name][part] for name in names)
    dynamic = model["body_type"][part] == BodyType.DYNAMIC
    heavy, turns = mass != 0, inertia != 0
    refuse(f"{label}mass", mass, heavy != dynamic, "> 0 if its body is DYNAMIC, 0 if not", part.start)
    refuse(f"{label}inertia", inertia, turns & ~dynamic, "0, for its body is not DYNAMIC", part.start)
    for name, given, inverse, some in (
        ("mass", mass, inverse_mass, heavy),
        ("inertia", inertia, inverse_inertia, turns),
    ):
        refuse(f"{label}inv_{name}", inverse, (inverse != 0) != some, f"0 if {name} is, else > 0", part.start)
        with np.errstate(over="ignore", under="ignore", invalid="ignore"):
            wrong = ~(np.abs(given * inverse - some) <= INVERSE_TOLERANCE)
        refuse(f"{label}inv_{name}", inverse, wrong, f"1 / {name}", part.start)


def check_state(state: Arrays, model: Arrays, label: str = "state.", *, frozen: bool = False) -> None:
    """Hold the arrays of a ``State`` to their rules.

    Args:
        state: all fields of ``model.fields.STATE`` by name.
        model: arrays of a model that ``check_model`` has passed.
        label: what stands before the name of an array in errors.
        frozen: pass whatever froze a world: numbers of worlds with flags may be NaN or inf.

    Raises:
        BrokenRule: naming array, index, value and limit.
    """
    layout = Layout(model)
    for name, values in _sane(STATE, state, layout, state["flags"] if frozen else None).items():
        check_field(f"{label}{name}", STATE[name], values, layout)


def check_joints(joints: Arrays, model: Arrays, label: str = "joints.") -> None:
    """Hold the arrays of ``Joints`` to their rules and to the model.

    Args:
        joints: all fields of ``model.fields.JOINTS`` by name.
        model: arrays of a model that ``check_model`` has passed.
        label: what stands before the name of an array in errors.

    Raises:
        BrokenRule: naming array, index, value and limit.
    """
    a, b = joints["joint_body_a"], joints["joint_body_b"]
    if len(a) != model["joint_start"][-1]:
        raise BrokenRule(label.rstrip("./"), f"has {len(a)}; it must be the model's {model['joint_start'][-1]}")
    layout = Layout(model)
    for name, values in joints.items():
        check_field(f"{label}{name}", JOINTS[name], values, layout)
    refuse(f"{label}joint_body_b", b, a == b, "another body than body A")
    dynamic = model["body_type"] == BodyType.DYNAMIC
    refuse(f"{label}joint_body_b", b, ~(dynamic[a] | dynamic[b]), "DYNAMIC, for body A is not")


def check_contacts(contacts: Arrays, model: Arrays, label: str = "", flags: np.ndarray | None = None) -> None:
    """Hold contacts, packed world after world, to their rules and to the model.

    Args:
        contacts: fields of ``model.fields.CONTACTS`` by name: ``contact_count`` and ``key``, and any of the others.
        model: arrays of a model that ``check_model`` has passed.
        label: what stands before the name of an array in errors.
        flags: of the worlds; numbers of the contacts of a world with any flag may be NaN or inf. None: none has any.

    Raises:
        BrokenRule: naming array, index, value and limit.
    """
    count, key = contacts["contact_count"], contacts["key"]
    check_field(f"{label}contact_count", CONTACTS["contact_count"], count, Layout(model))
    if (total := int(count.sum(dtype=np.int64))) != len(key):
        raise BrokenRule(f"{label}contact_count", f"adds up to {total}; it must be {len(key)}, the number of contacts")
    layout = Layout(model, count)
    arrays = _sane(CONTACTS, contacts, layout, flags)
    if "contact_dt" in contacts:
        check_field(f"{label}contact_dt", CONTACTS["contact_dt"], contacts["contact_dt"], layout)
    closer = []  # what takes several passes
    for name, values in arrays.items():
        field = CONTACTS[name]
        if isinstance(field.rule, Unit | Ascending):
            closer.append((name, field, values))
        elif field.per == "contact" and not isinstance(field.rule, Index):
            check_field(f"{label}{name}", field, values, layout)
    colors = _Colors(f"{label}color", contacts["color"], model["body_type"]) if "color" in contacts else None
    for part in _parts(len(key)):
        for name, field, values in closer:
            check_field(f"{label}{name}", field, values, layout, part)
        bodies = _bodies_of_keys(contacts, model, layout, part, label)
        if colors is not None:
            colors.take(bodies, part)
    if colors is not None:
        colors.check()


def _parts(length: int) -> Iterator[slice]:
    """Parts of an array; each begins with the last element of the one before, so that neighbours are compared."""
    for first in range(0, length, PART):
        yield slice(max(first - 1, 0), first + PART)


def _sane(table: Mapping[str, Field], arrays: Arrays, layout: Layout, flags: np.ndarray | None) -> Arrays:
    """The arrays, with numbers of worlds that have flags replaced by what passes."""
    if flags is None or not flags.any():
        return arrays
    found = dict(arrays)
    for name, values in arrays.items():
        field = table[name]
        if values.dtype.kind == "f" and field.per in layout.start:
            found[name] = values.copy()
            found[name][flags[layout.world(field.per)] != 0] = (1.0, 0.0) if isinstance(field.rule, Unit) else 0.0
    return found


def _bodies_of_keys(
    contacts: Arrays, model: Arrays, layout: Layout, part: slice, label: str
) -> tuple[np.ndarray, np.ndarray]:
    """Bodies A and B of contacts by their keys, whose shapes must be of their world; hold given bodies to them."""
    key = contacts["key"][part]
    first, last = layout.shapes_of_contacts(part)
    bodies = []
    for side, shift in (("a", KEY_SHAPE_BITS + KEY_FEATURE_BITS), ("b", KEY_FEATURE_BITS)):
        shape = key >> shift
        shape &= 2**KEY_SHAPE_BITS - 1
        shape += first
        limit = f"of shapes of its world; shape {side.upper()} is not"
        refuse(f"{label}key", key, shape >= last, limit, part.start)
        bodies.append(model["shape_body"].take(shape, mode="clip"))  # all are in range: this looks no second time
        name = f"body_{side}"
        if name in contacts and not np.array_equal(contacts[name][part], bodies[-1]):
            check_field(f"{label}{name}", CONTACTS[name], contacts[name], layout, part)
            wrong = contacts[name][part] != bodies[-1]
            limit = f"the body of shape {side.upper()} in the contact's key"
            refuse(f"{label}{name}", contacts[name][part], wrong, limit, part.start)
    return bodies[0], bodies[1]


class _Colors:
    """Looks for two contacts of one colour at a dynamic body: lanes would write to it at once."""

    def __init__(self, label: str, color: np.ndarray, body_type: np.ndarray) -> None:
        """Take the colours, which must be in range, and the bodies' types."""
        self.label = label
        self.color = color if color.max(initial=-1) < COLORS - 1 else np.where(color < COLORS - 1, color, -1)
        width = int(self.color.max(initial=-1)) + 2  # one place for -1; the serial colour, like it, blocks nobody
        bodies = len(body_type)
        self.first = np.arange(1, bodies * width + 1, width, dtype=np.int64)
        self.first[body_type != BodyType.DYNAMIC] = bodies * width + 1
        self.width, self.trash = width, bodies * width
        self.marks = np.zeros((bodies + 1) * width, bool)
        self.bodies: list[tuple[np.ndarray, np.ndarray]] = []
        self.count = 0

    def take(self, bodies: tuple[np.ndarray, np.ndarray], part: slice) -> None:
        """Note the colours of a part of the contacts."""
        skip = 1 if part.start else 0  # that one was in the part before
        color = self.color[part][skip:]
        fresh = np.count_nonzero(color < 0) > 0
        self.bodies.append((bodies[0][skip:], bodies[1][skip:]))
        for side in self.bodies[-1]:
            places = self.first.take(side, mode="clip")
            blocked = places < self.trash
            if fresh:
                blocked &= color >= 0
            self.count += int(np.count_nonzero(blocked))
            places += color
            self.marks[places] = True

    def check(self) -> None:
        """Refuse a colour that comes twice at a body."""
        marks = self.marks[: self.trash].reshape(-1, self.width)
        marks[:, 0] = False
        if np.count_nonzero(marks) == self.count:
            return
        sides = [np.concatenate(side) for side in zip(*self.bodies)]
        places = np.concatenate([self.first[side] + self.color for side in sides])
        order = np.argsort(places, kind="stable")
        order = order[(places[order] < self.trash) & (places[order] % self.width != 0)]
        twice = int(np.flatnonzero(np.diff(places[order]) == 0)[0])
        i, j = sorted(int(k) % len(self.color) for k in order[twice : twice + 2])
        body = int(places[order[twice]] // self.width)
        text = f"is {self.color[j]}; it must be another than that of contact {i}, which acts on body {body} too"
        raise BrokenRule(f"{self.label}[{j}]", text)
