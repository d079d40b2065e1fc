"""Narrowphase: contact points of candidate pairs, and what they keep from step to step."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from dc_kernels.model.arrays import ArrayGroup, Contacts, Joints, Model
from dc_kernels.model.enums import Flag
from dc_kernels.model.fields import CACHE
from dc_kernels.model.room import Room, move_segments
from dc_kernels.solve.rows import COLORS


class Cache(ArrayGroup):
    """Contacts of the last finished step, by key (``model.fields.CACHE``)."""

    table = CACHE


class Narrowphase:
    """The contacts of a step, those of the step before, and their room.

    Its kernels are ``narrowphase``, ``match_contacts`` and ``color_constraints``.

    Attributes:
        contacts: the contacts, sorted by key in each world.
        cache: what persists of those of the last finished step, in slots of the same numbers.
        room: contacts reserved for each world.
    """

    def __init__(self, model: Model, contacts_per_body: float) -> None:
        """Reserve so many contacts for each body."""
        bodies = np.diff(model.numpy("body_start"))
        self.room = Room("contacts", Flag.CONTACT_OVERFLOW, np.ceil(contacts_per_body * bodies))
        sizes = {**model.sizes, "contact": self.room.total, "joint": model.joint_count}
        self.contacts = Contacts(sizes, model.dtype, model.device, model.backend)
        self.cache = Cache(sizes, model.dtype, model.device, model.backend)
        self.contacts.assign("contact_start", self.room.starts())

    @property
    def used(self) -> np.ndarray:
        """Contacts of each world at the last step, (W,)."""
        return self.contacts.numpy("contact_count")

    def relayout(self) -> None:
        """Allocate the room anew and move the contacts to their new places."""
        old, new = self.contacts.numpy("contact_start").copy(), self.room.starts()
        for group, count in ((self.contacts, "contact_count"), (self.cache, "count")):
            before = group.renew(contact=self.room.total)
            for name, field in group.table.items():
                if field.per == "contact":
                    move_segments(before[name], group.array(name), old, new, group.numpy(count))
        self.contacts.assign("contact_start", new)

    def check_restored(self, count: np.ndarray, arrays: Mapping[str, np.ndarray]) -> np.ndarray:
        """Check contacts of an earlier run; returns how many each world has, (W,) int64.

        Raises:
            ValueError: naming a missing field or a wrong shape.
        """
        worlds = self.contacts.sizes["world"]
        count = np.asarray(count, np.int64)
        if count.shape != (worlds,) or (count < 0).any():
            raise ValueError(f"count has shape {count.shape}; it must be one number >= 0 for each of {worlds} worlds")
        total = int(count.sum())
        for name in ("key", "impulse", "color", "age"):
            if name not in arrays:
                raise ValueError(f"{name} is missing; the contact cache needs key, impulse, color and age")
        for name, values in arrays.items():
            if len(values) != total:
                raise ValueError(f"{name} has {len(values)} contacts; the worlds together have {total}")
        color = np.asarray(arrays["color"])
        wrong = np.flatnonzero((color < -1) | (color >= COLORS))
        if len(wrong):
            raise ValueError(f"color[{wrong[0]}] is {color[wrong[0]]}; it must lie in [-1, {COLORS - 1}]")
        return count

    def restore(self, count: np.ndarray, arrays: Mapping[str, np.ndarray], contact_dt: Any, joints: Joints) -> None:
        """Put contacts of an earlier run, checked and with room for them, where the next step looks for the last."""
        first = self.contacts.numpy("contact_start")
        source = np.concatenate([[0], np.cumsum(count)])
        for name, values in arrays.items():
            for group in (self.contacts, self.cache):
                if name not in group.table:
                    continue
                array = group.numpy(name)
                for w in range(len(count)):
                    array[first[w] : first[w] + count[w]] = values[source[w] : source[w + 1]]
                if group.device != "cpu":
                    group.array(name).assign(array)
        self.contacts.assign("contact_count", count)
        self.cache.assign("count", count)
        self.contacts.assign("contact_dt", contact_dt)
        self.cache.assign("joint_impulse", joints.numpy("joint_impulse"))

    def check_start(self) -> None:
        """Raise ValueError, naming the contact, if a start impulse is NaN or inf."""
        impulse = self.contacts.numpy("impulse")
        first = self.contacts.numpy("contact_start")
        for w, count in enumerate(self.used):
            start = impulse[first[w] : first[w] + count]
            bad = np.argwhere(~np.isfinite(start))
            if len(bad):
                c, k = (int(i) for i in bad[0])
                raise ValueError(
                    f"contacts.impulse[{first[w] + c}, {k}] (contact {c} of world {w}) is {start[c, k]}; "
                    "a start impulse must be finite"
                )
