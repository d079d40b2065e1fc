"""Checks of contacts: keys, bodies, colours, numbers."""

from __future__ import annotations

import numpy as np

from dc_kernels.model.enums import BodyType
from dc_kernels.model.fields import COLORS, CONTACTS, KEY_FEATURE_BITS, KEY_SHAPE_BITS, PER_CONTACT
from dc_kernels.model.rules import Ascending, BrokenRule, Index, Unit, refuse
from dc_kernels.model.validate.arrays import Layout, check_field, parts_of, sane
from dc_kernels.model.validate.glance import Arrays


def check_contacts(
    contacts: Arrays, model: Arrays, label: str = "", flags: np.ndarray | None = None, backend: str = "numpy"
) -> None:
    """Hold contacts, packed world after world, to their rules and to the model.

    Args:
        contacts: fields of ``model.fields.CONTACTS`` by name: ``contact_count`` and ``key``, and any of the others.
        model: arrays of a model that ``check_model`` has passed.
        label: what stands before the name of an array in errors.
        flags: of the worlds; numbers of the contacts of a world with any flag may be NaN or inf. None: none has any.
        backend: that may look at large arrays, if it has compiled code.

    Raises:
        BrokenRule: naming array, index, value and limit.
    """
    count, key = contacts["contact_count"], contacts["key"]
    check_field(f"{label}contact_count", CONTACTS["contact_count"], count, Layout(model))
    if (total := int(count.sum(dtype=np.int64))) != len(key):
        raise BrokenRule(f"{label}contact_count", f"adds up to {total}; it must be {len(key)}, the number of contacts")
    layout = Layout(model, count, backend)
    arrays = sane(CONTACTS, contacts, layout, flags)
    if "contact_dt" in contacts:
        check_field(f"{label}contact_dt", CONTACTS["contact_dt"], contacts["contact_dt"], layout)
    kept = layout.glance.keeping(arrays, CONTACTS)
    closer = []  # what takes several passes
    for name, values in arrays.items():
        field = CONTACTS[name]
        if name in kept:
            continue
        if isinstance(field.rule, Unit | Ascending):
            closer.append((name, field, values))
        elif field.per in PER_CONTACT and not isinstance(field.rule, Index):
            check_field(f"{label}{name}", field, values, layout)
    if layout.glance.contacts(arrays, model, layout.start["contact"]):
        closer = [(name, field, values) for name, field, values in closer if not isinstance(field.rule, Ascending)]
        if not closer:
            return
    colors = _Colors(f"{label}color", contacts["color"], model["body_type"]) if "color" in contacts else None
    for part in parts_of(len(key)):
        for name, field, values in closer:
            check_field(f"{label}{name}", field, values, layout, part)
        bodies = _bodies_of_keys(contacts, model, layout, part, label)
        if colors is not None:
            colors.take(bodies, part)
    if colors is not None:
        colors.check()


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
