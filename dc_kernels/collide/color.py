"""Colouring of a contact graph: contacts of one colour share no movable body."""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels.model.enums import BodyType
from dc_kernels.model.fields import CONTACTS, JOINTS, LAUNCH, MODEL, ROWS, STATE
from dc_kernels.model.room import world_of
from dc_kernels.model.rules import refuse
from dc_kernels.model.settings import numeric
from dc_kernels.runtime.backends import bind, check_backend, kernel_file, make_kernels
from dc_kernels.runtime.capture import refuse_recording
from dc_kernels.runtime.inputs import check_layout, check_start, refuse_overlap
from dc_kernels.runtime.interop import host_view

INT = np.dtype(np.int32)


def color(
    body_a: Any,
    body_b: Any,
    movable: Any,
    *,
    color: Any = None,
    body_start: Any = None,
    contact_start: Any = None,
    backend: str = "warp",
) -> np.ndarray:
    """Colour contacts so that no two of a colour share a movable body, and can be solved in parallel.

    The colouring is greedy: each contact in turn takes the lowest colour that is free at both of its bodies, so that a
    graph of degree d takes at most 2 d - 1 colours, and equal contacts in equal order get equal colours. Colours kept
    from an earlier call come first. A contact for which none of the first 63 is free gets the last one, 63, whose
    contacts may share bodies and must be solved one after the other.

    Args:
        body_a: body A of each contact, (C,) int32.
        body_b: body B, (C,) int32.
        movable: whether contacts move each body, (N,) bool, or any numbers, such as inverse masses (0: False).
        color: colours to keep from an earlier call, (C,) int32; -1 for a new contact. It is written to, and a colour
            that two contacts of a body share is replaced. None: all contacts are new.
        body_start: first body of each world and N, (W + 1,); None: one world.
        contact_start: first contact of each world and C, (W + 1,); None: one world.
        backend: "warp", "taichi", or "numpy": the oracle.

    Returns:
        The colours, (C,) int32; ``color`` as numpy, if that was given.

    Raises:
        ValueError: an argument is invalid; the error names argument, index and limit.
        RuntimeError: it is called within ``wp.ScopedCapture``, where a ``ContactSolver`` can colour instead.

    Examples:
        >>> import numpy as np
        >>> import dc_kernels as dc
        >>> a, b = np.array([0, 1, 2], np.int32), np.array([1, 2, 3], np.int32)
        >>> dc.color(a, b, movable=[0.0, 1.0, 1.0, 1.0])
        array([0, 1, 0], dtype=int32)
    """
    refuse_recording("color", "it makes arrays of its own; a ContactSolver colours in a graph")
    check_backend(backend)
    body_a = check_layout("body_a", body_a, (None,), INT)
    body_b = check_layout("body_b", body_b, body_a.shape, INT)
    moves = numeric("movable", host_view("movable", movable), "(N,) bool or numbers", "buif")
    if moves.ndim != 1:
        raise ValueError(f"movable has shape {moves.shape}; it must be (N,) bool or numbers")
    refuse("movable", moves, ~np.isfinite(moves), "finite")
    contacts, bodies = len(body_a), len(moves)
    first_body = check_start("body_start", body_start, bodies, "bodies")
    first_contact = check_start("contact_start", contact_start, contacts, "contacts")
    worlds = len(first_body) - 1
    if len(first_contact) != worlds + 1:
        raise ValueError(f"contact_start has {len(first_contact) - 1} worlds, body_start {worlds}; they must agree")
    world = world_of(first_contact)
    low, high = first_body[world], first_body[world + 1]
    for name, body in (("body_a", body_a), ("body_b", body_b)):
        good = (body >= low) & (body < high) & ((body != body_a) if name == "body_b" else True)
        if not good.all():
            i = int(good.argmin())
            raise ValueError(
                f"{name}[{i}] is {body[i]}; it must be a body of its world, in [{low[i]}, {high[i] - 1}], "
                "and another than the contact's other one"
            )
    if color is None:
        colors = np.full(contacts, -1, np.int32)
    else:
        colors = check_layout("color", color, (contacts,), INT, writes=True)
        refuse_overlap({"color": colors}, {"body_a": body_a, "body_b": body_b, "movable": moves})
    kinds = np.where(moves != 0, BodyType.DYNAMIC, BodyType.STATIC).astype(np.int32)
    groups = {
        "launch": (LAUNCH, {"world_offset": 0}),
        "model": (
            MODEL,
            {
                "body_start": first_body.astype(np.int32),
                "body_type": kinds,
            },
        ),
        "state": (STATE, {"flags": np.zeros(worlds, np.int32)}),
        "joints": (JOINTS, {}),
        "contacts": (
            CONTACTS,
            {
                "contact_start": first_contact.astype(np.int32),
                "contact_count": np.diff(first_contact).astype(np.int32),
                "body_a": body_a,
                "body_b": body_b,
                "color": colors,
            },
        ),
        "rows": (
            ROWS,
            {
                "color_mask": np.zeros(bodies, np.uint64),
                "line_start": np.zeros(worlds + 1, np.int32),
                "row_start": np.zeros(worlds + 1, np.int32),
            },
        ),
    }
    make = kernel_file(backend, "groups").group
    values = {name: make(name, "float32", table, arrays) for name, (table, arrays) in groups.items()}
    kernels = make_kernels(backend, "collide.color", "float32")
    for name in ("keep_colors", "color_constraints"):
        bind(kernels[name], worlds, values, "cpu")()
    return colors
