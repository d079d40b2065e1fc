"""What a solver of other engines' contacts found out of range: the first value, by name and index."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NoReturn

import numpy as np

from dc_kernels.model.arrays import ArrayGroup
from dc_kernels.model.enums import Flag
from dc_kernels.model.rules import POSITIVE, refuse
from dc_kernels.model.validate.arrays import Layout, check_field
from dc_kernels.runtime.capture import STALE
from dc_kernels.solve.exchange import BEFORE, LINES, VELOCITIES, refuse_same, view_of

LOOKED_AT = ("model", "state", "joints", "contacts", "rows", "exchange")
STOPS = int(Flag.CONTACT_OVERFLOW | Flag.ROW_OVERFLOW | Flag.NONFINITE | Flag.INVALID)


@np.errstate(over="ignore", invalid="ignore")
def raise_fault(
    groups: Mapping[str, ArrayGroup], given: Mapping[str, Any], *, kept: bool, positions: bool, discs: bool
) -> NoReturn:
    """Raise ValueError that names the first value out of range of the first world that has one.

    Args:
        groups: of the solver: model, state, joints, contacts, rows and exchange.
        given: the caller's arrays that are exchanged, by name.
        kept: whether contacts, joints and masses were not looked at.
        positions: whether bodies have positions.
        discs: whether all bodies that contacts turn are said to be discs.
    """
    model, state, joints, contacts, rows, exchange = (groups[name] for name in LOOKED_AT)
    flags = state.numpy("flags")
    w = int(np.flatnonzero(flags & STOPS)[0])
    layout = Layout(model.views())
    layout.start["contact"] = start = contacts.numpy("contact_start")
    layout.start["own row"] = rows.numpy("row_start")
    given = {name: view_of(exchange, name, array) for name, array in given.items()}  # as numpy
    count, room = int(exchange.numpy("count")[w]), int(start[w + 1] - start[w])
    if flags[w] & Flag.CONTACT_OVERFLOW:
        left = "; a stage whose room grew has left its arrays, take them anew" if count == STALE else ""
        raise ValueError(f"count[{w}] is {count}; it must lie in [0, {room}], the room of world {w}{left}")
    parts = {axis: slice(int(at[w]), int(at[w + 1])) for axis, at in layout.start.items()}
    parts["contact"] = slice(int(start[w]), int(start[w]) + count)

    def check(group: ArrayGroup, *names: str, lent: Mapping[str, np.ndarray] | None = None) -> None:
        for name in names:
            field = group.table[name]
            values = group.numpy(name) if lent is None else lent[name]
            axis = field.per if field.per in parts else field.per.split()[0]
            check_field(name, field, values, layout, parts[axis])

    if not kept:
        arms = () if "point" in given else ("arm_a", "arm_b")
        check(model, "inv_mass", "inv_inertia")
        check(state, *(("position",) if positions else ()))
        check(contacts, "body_a", "body_b")
        refuse_same("body_b", contacts.numpy("body_a"), contacts.numpy("body_b"), parts["contact"])
        check(exchange, *(("point",) if "point" in given else ()), lent=given)
        check(contacts, "normal", "gap", "friction", "restitution", *arms)
        if parts["joint"].stop > parts["joint"].start:
            check(state, "angle")
            check(joints, *LINES)
            length = joints.numpy("joint_length")[parts["joint"]]
            refuse("joint_length", length, length <= 0, POSITIVE.limits, parts["joint"].start)
            ends = joints.numpy("joint_body_a"), joints.numpy("joint_body_b")
            refuse_same("joint_body_b", ends[0], ends[1], parts["joint"])
    extra = parts["own row"]
    if not kept and extra.stop > extra.start:
        check(rows, "row_body_a", "row_body_b", "row_jacobian_a", "row_jacobian_b", "row_bias", "row_softness")
        refuse_same("row_body_b", rows.numpy("row_body_a"), rows.numpy("row_body_b"), extra)
        lower, upper = rows.numpy("row_lower")[extra], rows.numpy("row_upper")[extra]
        some = (lower <= upper) & (lower < np.inf) & (upper > -np.inf)
        refuse("row_lower", lower, ~some, "at most row_upper, and below infinity", extra.start)
    check(rows, "row_impulse")
    check(exchange, *(name for name in (*VELOCITIES, *BEFORE) if name in given), lent=given)
    check(exchange, "impulse", lent={"impulse": exchange.numpy("impulse"), **given})
    check(joints, "joint_impulse")
    if not kept and discs and flags[w] & Flag.INVALID:
        raise ValueError(
            f"discs is True, but a contact of world {w} has an arm that is not along its normal; "
            "only discs about their centre of mass have none"
        )
    raise ValueError(f"the solve of world {w} ran off: its velocities are not finite, and nothing was written")
