"""The contacts of candidate pairs, their room, and what they keep from step to step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from dc_kernels.model.arrays import ArrayGroup, Contacts, Model, to_numpy
from dc_kernels.model.checks import check_values
from dc_kernels.model.dtypes import numpy_spec
from dc_kernels.model.enums import Flag
from dc_kernels.model.fields import CACHE, CONTACTS, PER_CONTACT, ROLLING
from dc_kernels.model.room import Room, fill_segments, move_segments
from dc_kernels.model.validate.contacts import check_contacts
from dc_kernels.runtime.inputs import check_mapping


class Cache(ArrayGroup):
    """Contacts of the last finished step, by key (``model.fields.CACHE``)."""

    table = CACHE


class Restored(NamedTuple):
    """Contacts of an earlier run, checked."""

    counts: np.ndarray
    """Contacts of each world, (W,) int64."""
    arrays: Mapping[str, np.ndarray]
    """Fields of ``CONTACTS`` by name, world after world."""
    contact_dt: np.ndarray
    """Time step of the impulses, (W,) [s]."""


class FoundContacts:
    """Contacts and their room.

    Attributes:
        contacts: the contacts, sorted by key in each world.
        room: contacts reserved for each world.
        rolls: whether contacts may resist rolling, and have an impulse more.
    """

    rolls = False

    def __init__(self, sizes: Mapping[str, int], slots: np.ndarray, dtype: Any, device: str, backend: str) -> None:
        """Reserve.

        Args:
            sizes: of the axes "world" and "world+1".
            slots: contacts to reserve for each world, (W,).
            dtype: float32 or float64.
            device: of the arrays.
            backend: of the arrays.
        """
        self.room = Room("contacts", Flag.CONTACT_OVERFLOW, slots)
        self.contacts = Contacts({**sizes, **self.sizes}, dtype, device, backend)
        self.contacts.fill("contact_start", self.room.starts())

    @property
    def sizes(self) -> dict[str, int]:
        """Slots on the axes of contacts."""
        total = self.room.total
        return {"contact": total, ROLLING: total if self.rolls else 0}

    @property
    def used(self) -> np.ndarray:
        """Contacts of each world at the last step, (W,)."""
        return self.contacts.numpy("contact_count")

    def groups(self) -> list[tuple[ArrayGroup, str]]:
        """The groups with a slot for each contact, and the field that holds the number of those of each world."""
        return [(self.contacts, "contact_count")]

    def relayout(self, further: Sequence[tuple[ArrayGroup, str]] = ()) -> None:
        """Allocate the room anew and move the contacts, also those of ``further`` groups, to their new places."""
        old, new = self.contacts.numpy("contact_start").copy(), self.room.starts()
        for group, count in [*self.groups(), *further]:
            sizes = {axis: size for axis, size in self.sizes.items() if axis in group.sizes}
            before = group.renew(**sizes)
            for name, field in group.table.items():
                if sizes.get(field.per):
                    move_segments(before[name], group.array(name), old, new, group.numpy(count))
        self.contacts.assign("contact_start", new)


class StepContacts(FoundContacts):
    """The contacts of a step of a simulation, and those of the step before.

    Their kernels are ``narrowphase``, ``match_contacts`` and ``color_constraints``.

    Attributes:
        cache: what persists of the contacts of the last finished step, in slots of the same numbers.
    """

    def __init__(self, model: Model, contacts_per_body: float, joint_rows: int, rolls: bool) -> None:
        """Reserve so many contacts for each body, and remember the impulses of so many rows of joints."""
        self.rolls = rolls
        bodies = np.diff(model.numpy("body_start"))
        sizes = {**model.sizes, "joint row": joint_rows}
        super().__init__(sizes, np.ceil(contacts_per_body * bodies), model.dtype, model.device, model.backend)
        self.cache = Cache(self.contacts.sizes, model.dtype, model.device, model.backend)

    def roll(self, rolls: bool, further: Sequence[tuple[ArrayGroup, str]]) -> None:
        """Allocate the impulses of rolling resistance of contacts, also those of ``further`` groups, or free them."""
        self.rolls = rolls
        for group, _ in [*self.groups(), *further]:
            if ROLLING in group.sizes:
                group.reallocate(("rolling_impulse",), **{ROLLING: self.sizes[ROLLING]})

    def adopt(self, contacts: Contacts, cache: Cache, slots: np.ndarray) -> None:
        """Take over the contacts of the same bodies, and their room."""
        self.contacts, self.cache, self.room.slots = contacts, cache, slots

    def groups(self) -> list[tuple[ArrayGroup, str]]:
        """See ``FoundContacts.groups``."""
        return [*super().groups(), (self.cache, "count")]

    def check_restored(
        self, model: Model, count: Any, arrays: Mapping[str, Any], contact_dt: Any, flags: np.ndarray
    ) -> Restored:
        """Check contacts of an earlier run against the rules of their fields and a model.

        Args:
            model: of the contacts.
            count: contacts of each world, (W,).
            arrays: fields of ``CONTACTS`` by name, world after world.
            contact_dt: time step of the impulses, (W,) [s].
            flags: of the worlds; numbers of the contacts of a world with flags may be NaN or inf.

        Raises:
            ValueError: naming what is missing, of a wrong shape or dtype, or out of its range.
        """
        worlds, real = self.contacts.sizes["world"], self.contacts.dtype
        count = check_values("contact_count", count, (worlds,), np.dtype(np.int64))
        contact_dt = check_values("contact_dt", contact_dt, (worlds,), real, finite=False)
        for name in ("key", "impulse", "color", "age"):
            if name not in check_mapping("arrays", arrays):
                raise ValueError(f"{name} is missing; the contact cache needs key, impulse, color and age")
        found, total = {}, np.size(arrays["key"])
        for name, values in arrays.items():
            field = CONTACTS.get(name)
            if field is None or field.per not in PER_CONTACT:
                raise ValueError(f"{name} is no field of a contact")
            if field.per == ROLLING and not self.rolls:
                raise ValueError(f"{name} is given, but no shape has a rolling_resistance")
            dtype, inner = numpy_spec(field, real)
            found[name] = check_values(name, values, (total, *inner), dtype, finite=False)
        given = {"contact_count": count, "contact_dt": contact_dt, **found}
        check_contacts(given, model.views(), flags=flags, backend=model.backend)
        if self.rolls:  # as contacts of before had none, and of other scenes
            found.setdefault("rolling_impulse", np.zeros(total, real))
        return Restored(count, found, contact_dt)

    def restore(self, given: Restored, joint_impulse: np.ndarray, *, shown: bool = True) -> None:
        """Put contacts of an earlier run, checked and with room for them, where the next step looks for the last.

        Args:
            given: from ``check_restored``.
            joint_impulse: what the next step starts from, of each row of the joints [N s].
            shown: put them into ``contacts`` too.
        """
        start = self.contacts.numpy("contact_start")
        for group in (self.contacts, self.cache) if shown else (self.cache,):
            for name, values in given.arrays.items():
                if name in group.table:
                    array = to_numpy(group.array(name))
                    fill_segments(array, values, start, given.counts)
                    if group.device != "cpu":
                        group.array(name).assign(array)
        if shown:
            self.contacts.assign("contact_count", given.counts)
        self.cache.assign("count", given.counts)
        self.contacts.assign("contact_dt", given.contact_dt)
        self.cache.assign("joint_impulse", joint_impulse)

    def check_start(self) -> None:
        """Raise ValueError, naming the contact, if a start impulse is NaN or inf."""
        first = self.contacts.numpy("contact_start")
        for name in ("impulse", "rolling_impulse") if self.rolls else ("impulse",):
            impulse = self.contacts.numpy(name)
            for w, count in enumerate(self.used):
                start = impulse[first[w] : first[w] + count]
                bad = np.argwhere(~np.isfinite(start))
                if len(bad):
                    c, *k = (int(i) for i in bad[0])
                    at = ", ".join(map(str, (first[w] + c, *k)))
                    raise ValueError(
                        f"contacts.{name}[{at}] (contact {c} of world {w}) is {start[(c, *k)]}; "
                        "a start impulse must be finite"
                    )
