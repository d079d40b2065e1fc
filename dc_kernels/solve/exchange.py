"""Arrays that a solver of other engines' contacts reads and writes where they lie, and what they must hold."""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping
from numbers import Real
from typing import Any

import numpy as np

from dc_kernels.model.arrays import ArrayGroup
from dc_kernels.model.dtypes import numpy_spec
from dc_kernels.model.fields import field_table
from dc_kernels.model.rules import UNIT_TOLERANCE, Number, Rule, refuse
from dc_kernels.model.settings import WrongType, numeric, shown
from dc_kernels.runtime.backends import kernel_file, on_numpy
from dc_kernels.runtime.building import start_warp
from dc_kernels.runtime.inputs import check_finite, check_layout, check_mapping, check_start, refuse_overlap
from dc_kernels.runtime.interop import host_view

UNIT = 2.0 * UNIT_TOLERANCE  # of a squared length
ARM = 1e-3  # of an arm: what may lie beside the normal where all that moves is discs

# axes: world, body, contact (capacity), "contact point" and "contact color" (capacity, or 0), "body before" (or 0)
EXCHANGE = field_table(
    ("count", "world", "int32", "1", "contacts of each world"),
    ("point", "contact point", "vec2", "m", "contact points, in the coordinates of the bodies' positions"),
    ("color", "contact color", "int32", "1", "colours that contacts keep, -1 for none"),
    ("velocity", "body", "vec2", "m/s", "with the step's forces applied; then solved"),
    ("angular_velocity", "body", "real", "rad/s", "with the step's torques applied; then solved"),
    ("velocity_before", "body before", "vec2", "m/s", "before the step's forces, which a bounce mirrors"),
    ("angular_velocity_before", "body before", "real", "rad/s", "before the step's torques"),
    ("impulse", "contact", "vec2", "N s", "normal and tangential: the start, then the solution"),
)


NEEDED = ("body_a", "body_b", "normal", "gap", "friction", "restitution")
"""Fields of the contacts that a solver is given."""
LINES = ("joint_body_a", "joint_body_b", "joint_anchor_a", "joint_anchor_b", "joint_length")
"""Fields of joints that it is given, where there are any."""
VELOCITIES = ("velocity", "angular_velocity")
BEFORE = ("velocity_before", "angular_velocity_before")
WRITTEN = (*VELOCITIES, "impulse", "color", "joint_impulse", "row_impulse")


class Exchange(ArrayGroup):
    """What a solve is given and gives back (``EXCHANGE``)."""

    table = EXCHANGE


def own_lines(joints: Mapping[str, Any] | None) -> dict[str, Any]:
    """A caller's distance joints by the names of ``LINES``; empty without any.

    Raises:
        TypeError: for what is no mapping.
        ValueError: naming what is unknown.
    """
    lines = {} if joints is None else dict(check_mapping("joints", joints))
    for name in lines:
        if name not in (known := (*LINES, "joint_impulse")):
            raise ValueError(
                f"{name} is unknown; joints have {', '.join(known)}, as rods do: what else joins bodies goes in as rows"
            )
    return lines


OWN_ROWS = {
    "row_body_a": None,
    "row_body_b": None,
    "row_jacobian_a": None,
    "row_jacobian_b": None,
    "row_bias": 0.0,
    "row_lower": -np.inf,
    "row_upper": np.inf,
    "row_softness": 0.0,
    "row_impulse": 0.0,
}
"""What a caller's own rows are given by (``model.fields.ROWS``), and what it is otherwise; None: it must be given."""


BOUNDS = ("row_lower", "row_upper")
"""What may be infinite."""


def own_rows(rows: Mapping[str, Any] | None) -> dict[str, Any]:
    """A caller's own rows, complete; empty without any.

    Raises:
        TypeError: for what is no mapping.
        ValueError: naming what is unknown or missing.
    """
    if rows is None or not check_mapping("rows", rows):
        return {}
    for name in rows:
        if name not in OWN_ROWS:
            raise ValueError(f"{name} is unknown; rows have {tuple(OWN_ROWS)}")
    given = {name: default if rows.get(name) is None else rows[name] for name, default in OWN_ROWS.items()}
    for name, values in given.items():
        if values is None:
            raise ValueError(f"{name} is missing; rows need their bodies and Jacobians")
    return given


def make_exchange(contacts: ArrayGroup, bodies: int, given: Mapping[str, Any]) -> Exchange:
    """Allocate what is exchanged: as much of the optional arrays as is given."""
    room = contacts.sizes["contact"]
    sizes = {
        "world": contacts.sizes["world"],
        "body": bodies,
        "contact": room,
        "contact point": room if "point" in given else 0,
        "contact color": room if "color" in given else 0,
        "body before": bodies if any(name in given for name in BEFORE) else 0,
    }
    exchange = Exchange(sizes, contacts.dtype, contacts.device, contacts.backend)
    if "count" not in given:
        exchange.assign("count", np.diff(contacts.numpy("contact_start")))
    return exchange


def view_of(group: ArrayGroup, name: str, array: Any, *, writes: bool = False) -> np.ndarray:
    """An array that is to be a field of a group as numpy, the same memory.

    Args:
        group: on the CPU.
        name: of the field, which errors name.
        array: numpy array, torch tensor, ``wp.array``, or anything with ``__dlpack__``.
        writes: whether kernels write to it.

    Raises:
        ValueError: naming the field, for another dtype, shape, device or memory layout.
    """
    field = group.table[name]
    scalar, inner = numpy_spec(field, group.dtype)
    shape = (*(group.sizes[axis] for axis in field.axes), *inner)
    return check_layout(name, array, shape, scalar, writes=writes)


def stays(array: Any, before: Any, at: int | None) -> bool:
    """Whether an array is the one of the call before; a tensor's memory may have been exchanged since."""
    return array is before and (not hasattr(array, "data_ptr") or array.data_ptr() == at)


def share_all(
    group: ArrayGroup,
    arrays: Mapping[str, Any],
    writes: Container[str] = (),
    *,
    numbers: Container[str] = (),
    needed: Iterable[str] = (),
) -> dict[str, np.ndarray]:
    """Let fields of a group lie in the memory of given arrays, which live as long as the group.

    Args:
        group: on the CPU.
        arrays: by the names of fields: arrays (see ``view_of``), or None.
        writes: fields that kernels write to.
        numbers: fields that may be one number instead, which fills the field's own array.
        needed: fields that must be given.

    Returns:
        The arrays that were given, as numpy.

    Raises:
        ValueError: naming the field.
    """
    for name in arrays:
        if name not in group.table:
            raise ValueError(f"{name} is unknown; it must be one of {tuple(group.table)}")
    for name in needed:
        if arrays.get(name) is None:
            raise ValueError(f"{name} is missing; it must be an array")
    views = {}
    for name, array in arrays.items():
        if array is None:
            continue
        if isinstance(array, Real) and name in numbers:
            group.numpy(name)[...] = _number(name, array, group.table[name].rule)
            continue
        views[name] = view = view_of(group, name, array, writes=name in writes)
        if on_numpy(group.backend):
            group.share(name, view)
            continue
        import warp as wp

        start_warp()
        field = group.table[name]
        element = kernel_file(group.backend, "groups").field_type(field, group.dtype.name)
        shape = view.shape[: len(field.axes)]
        group.share(name, wp.array(view, dtype=element, shape=shape, device="cpu", copy=False))
    return views


def _number(name: str, value: Any, rule: Rule | None) -> Any:
    """Return the number of all elements of a field; the bounds of rows, which may be infinite, are seen by kernels.

    Raises:
        ValueError: naming it and its limits.
    """
    if name in BOUNDS:
        return value
    number = check_finite(name, value)
    if isinstance(rule, Number) and not rule.low <= number <= rule.high:
        raise ValueError(f"{name} is {shown(value)}; it must be {rule.limits}")
    return number


def refuse_incomplete(given: Container[str], arrays: Mapping[str, np.ndarray]) -> None:
    """Refuse a call without all that it needs, or that writes to an array which lies in the memory of another.

    Velocities may be their own of before the step's forces, which are read first.

    Args:
        given: names of what is exchanged.
        arrays: all that are given, by name.

    Raises:
        ValueError: naming what is missing, or both.
    """
    for name in VELOCITIES:
        if name not in given:
            raise ValueError(f"{name} is missing; it must be given here or to the constructor")
    if (BEFORE[0] in given) != (BEFORE[1] in given):
        raise ValueError(f"{' and '.join(BEFORE)} go together")
    written = {name: array for name, array in arrays.items() if name in WRITTEN}
    read = {name: array for name, array in arrays.items() if name not in WRITTEN}
    for name, before in zip(VELOCITIES, BEFORE):
        if name in written and before in read and read[before].ctypes.data == written[name].ctypes.data:
            del read[before]
    refuse_overlap(written, read)


def length_of(name: str, array: Any) -> int:
    """The length of an array.

    Raises:
        ValueError: for what has none.
    """
    view = host_view(name, array)
    if not isinstance(view, np.ndarray | list | tuple) or (isinstance(view, np.ndarray) and not view.ndim):
        raise WrongType(f"{name} is {shown(array)}; it must be an array")
    return len(view)


def offsets(lengths: Mapping[str, int], starts: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Offsets of the worlds on each axis, (W + 1,) int64; one that is not given is of one world, or of nothing.

    Raises:
        ValueError: naming the axis and the first bad index, or for different numbers of worlds.
    """
    found = {"body": check_start("body_start", starts["body"], lengths["body"], "bodies")}
    worlds = len(found["body"]) - 1
    for axis in ("contact", "joint", "row"):
        name, start = f"{axis}_start", starts[axis]
        if start is None and not lengths[axis]:
            start = np.zeros(worlds + 1, np.int64)
        found[axis] = check_start(name, start, lengths[axis], f"{axis}s")
        if len(found[axis]) != len(found["body"]):
            raise ValueError(f"{name} is of {len(found[axis]) - 1} worlds, body_start of {worlds}; they must agree")
    return found


def for_each(name: str, values: Any, worlds: int, positive: bool = False) -> np.ndarray:
    """One number for each world, (W,) float64.

    Raises:
        ValueError: naming it, for another shape, or a value that is not finite, or negative, or 0 if it must not be.
    """
    array = numeric(name, host_view(name, values), f"a number or have shape {(worlds,)}").astype(np.float64)
    if array.shape not in ((), (worlds,)):
        raise ValueError(f"{name} has shape {array.shape}; it must be a number or ({worlds},)")
    array = np.array(np.broadcast_to(array, (worlds,)))
    good = np.isfinite(array) & (array > 0 if positive else array >= 0)
    if not good.all():
        w = int(good.argmin())
        raise ValueError(f"{name}[{w}] is {array[w]}; it must be finite and {'>' if positive else '>='} 0")
    return array


def gravity_of(gravity: Any, restitution: Any) -> Any:
    """Gravity as given, or 0 where no bounce depends on it.

    Raises:
        ValueError: without any, for a coefficient between 0 and 1, or an array, which may come to hold one.
    """
    fixed = isinstance(restitution, int | float | np.number) and restitution in (0, 1)
    if gravity is None and not fixed:
        raise ValueError(
            "gravity is None; it must be given [m/s^2, 0 without any] unless restitution is the number 0 or 1: "
            "what approaches more slowly than restitution_threshold sqrt(gravity length_scale) does not bounce"
        )
    return 0.0 if gravity is None else gravity


def refuse_lacking(point: Any, arm_a: Any, arm_b: Any, position: Any, angle: Any, joints: Any) -> None:
    """Raise ValueError where contacts have neither points nor arms, or joints no places and angles of bodies."""
    if (point is None) == (arm_a is None) or (arm_a is None) != (arm_b is None):
        raise ValueError("either point or both of arm_a and arm_b must be given")
    if point is not None and position is None:
        raise ValueError("point needs position: arms begin at the centres of mass")
    if joints is not None and (position is None or angle is None):
        raise ValueError("joints need position and angle: anchors turn with the bodies")


def refuse_same(name: str, a: np.ndarray, b: np.ndarray, part: slice) -> None:
    """Raise ValueError, naming the index, where body B is body A.

    Args:
        name: of the array of bodies B.
        a: bodies A.
        b: bodies B.
        part: what is looked at.
    """
    refuse(name, b[part], a[part] == b[part], "another body than body A", part.start)
