"""Numbers by which bodies, shapes and joints are called for ever, whatever slot of the arrays they lie in."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from dc_kernels.model.arrays import ArrayGroup, Model
from dc_kernels.model.enums import BodyType, ShapeType
from dc_kernels.model.fields import field_table
from dc_kernels.model.rules import BrokenRule, Number, refuse
from dc_kernels.model.settings import numeric
from dc_kernels.model.validate.arrays import check_rule
from dc_kernels.runtime.interop import host_view

KINDS = ("body", "shape", "joint")
PLURAL: dict[str, str] = {"body": "bodies", "shape": "shapes", "joint": "joints"}
EMPTY, ATTIC = -1, -2
"""In place of an id: nothing is in the slot; its body has the shapes of all empty slots of its world."""
FEW = 8  # ids that are looked for one by one: each takes a look at all, which to sort takes as long as some of them
_ID, _NEXT = Number(ATTIC, 2**62), Number(0, 2**62)

IDS = field_table(
    ("body_id", "body", "int64", "1", "id of the body; -1: none is there; -2: it has the shapes of empty slots", _ID),
    ("shape_id", "shape", "int64", "1", "id of the shape; -1: none is there", _ID),
    ("joint_id", "joint", "int64", "1", "id of the joint", _ID),
    ("next_id", "kind", "int64", "1", "id of the next body, shape and joint", _NEXT),
)


class Ids(ArrayGroup):
    """Ids of what is in the slots of a simulation; those that it was built with have their index. None comes twice."""

    table = IDS

    @classmethod
    def built(cls, model: Model) -> Ids:
        """Ids of a model of which nothing has changed."""
        sizes = {"body": model.body_count, "shape": model.shape_count, "joint": model.joint_count, "kind": 3}
        made = cls(sizes, model.dtype, "cpu", "numpy")
        for kind in KINDS:
            made.fill(f"{kind}_id", np.arange(sizes[kind]))
        made.fill("next_id", np.array([sizes[kind] for kind in KINDS]))
        return made

    def take(self, kind: str, count: int) -> np.ndarray:
        """New ids, (count,) int64."""
        following = self.array("next_id")
        first = int(following[KINDS.index(kind)])
        following[KINDS.index(kind)] += count
        return np.arange(first, first + count)

    def find(self, kind: str, ids: Any, *, once: bool = False, name: str | None = None) -> np.ndarray:
        """The indices of bodies, shapes or joints by their ids, (k,) int64; an integer counts as one of them.

        Args:
            kind: of what.
            ids: integers, (k,).
            once: whether each may be there once only.
            name: of the argument, for errors; None: the plural of the kind.

        Raises:
            TypeError: for what is no integers.
            ValueError: naming the first that has been removed, has never been, or is there twice.
        """
        label = PLURAL[kind] if name is None else name
        given = numeric(label, host_view(label, ids), "integers", "iu")
        if given.ndim > 1:
            raise ValueError(f"{label} has shape {given.shape}; it must be one id, or (k,)")
        wanted = given.reshape(-1).astype(np.int64)
        if not len(wanted):
            return wanted
        present = self.numpy(f"{kind}_id")
        if len(wanted) <= FEW:
            index = np.array([next(iter(np.flatnonzero(present == one)), 0) for one in wanted.tolist()], np.int64)
        else:
            order = np.argsort(present, kind="stable")
            index = order[np.minimum(np.searchsorted(present, wanted, sorter=order), len(order) - 1)]
        bad = wanted < 0
        if len(present):
            bad |= present[index] != wanted
        else:
            bad[:] = True
        if bad.any():
            i = int(bad.argmax())
            following = int(self.numpy("next_id")[KINDS.index(kind)])
            gone = 0 <= wanted[i] < following
            there = f"ids lie in [0, {following - 1}]" if following else f"no {kind} has"
            why = "which has been removed" if gone else f"which has never been; {there}"
            place = f"{label}[{i}]" if name is None else name
            raise ValueError(f"{place} is the id {wanted[i]}, {why}")
        if once and len(np.unique(wanted)) < len(wanted):
            order = np.argsort(wanted, kind="stable")
            again = order[1:][wanted[order[1:]] == wanted[order[:-1]]]
            raise ValueError(f"{label}[{int(again.min())}] is the id {wanted[again.min()]}, which is there already")
        return index


def check_ids(ids: Mapping[str, np.ndarray], model: Model) -> None:
    """Hold ids of an earlier run to each other and to a model.

    Args:
        ids: fields of ``IDS`` by name.
        model: whose bodies and shapes they name.

    Raises:
        BrokenRule: naming array, index, value and limit.
    """
    check_rule("next_id", ids["next_id"], _NEXT)
    for kind, following in zip(KINDS, ids["next_id"].tolist()):
        name = f"{kind}_id"
        values = ids[name]
        least = ATTIC if kind == "body" else EMPTY if kind == "shape" else 0
        refuse(name, values, (values < least) | (values >= following), f"in [{least}, {following - 1}]")
        order = np.argsort(values, kind="stable")
        again = np.zeros(len(values), bool)
        again[order[1:]] = (values[order[1:]] == values[order[:-1]]) & (values[order[1:]] >= 0)
        refuse(name, values, again, "there once")
    body, shape = ids["body_id"], ids["shape_id"]
    wrong = (body < 0) & (model.numpy("body_type") != BodyType.STATIC)
    refuse("body_id", body, wrong, ">= 0, for its body is not STATIC")
    owner = body[model.numpy("shape_body")]
    refuse("shape_id", shape, (shape < 0) != (owner == ATTIC), f"{EMPTY} if its body has the id {ATTIC}, else >= 0")
    refuse("body_id", owner, owner == EMPTY, "another, for the slot has a shape")
    busy = (shape < 0) & ((model.numpy("shape_category") | model.numpy("shape_mask")) != 0)
    refuse("shape_id", shape, busy, ">= 0, for the shape collides with others")
    plain = (model.numpy("shape_type") == ShapeType.DISC) | (shape >= 0)
    refuse("shape_id", shape, ~plain, ">= 0, for the shape is no disc")
    world = np.searchsorted(model.numpy("body_start"), np.flatnonzero(body == ATTIC), "right") - 1
    attics = np.bincount(world, minlength=model.world_count)
    if (attics != attics[0]).any() or attics[0] > 1:
        raise BrokenRule("body_id", f"has {ATTIC} {attics.max()} times in a world; it must be once in each, or nowhere")
