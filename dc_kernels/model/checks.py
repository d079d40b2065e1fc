"""Checks of numbers that a builder or an array is given; what is wrong is named with its field, index and limit."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Any, TypedDict

import numpy as np

from dc_kernels.model.enums import BodyType, ShapeRole
from dc_kernels.model.settings import (
    Limits,
    WrongType,
    checker,
    meant,
    number_limits,
    numeric,
    shown,
    with_article,
)
from dc_kernels.model.shapes import LARGEST

Finite = Annotated[float, Limits(size=LARGEST)]
Positive = Annotated[float, Limits(above=0.0, size=LARGEST)]
NotNegative = Annotated[float, Limits(least=0.0, size=LARGEST)]
ALL_BITS = 0xFFFFFFFF
Bits = Annotated[int, Limits(least=0, most=ALL_BITS)]
MATERIAL: dict[str, Any] = {
    "density": NotNegative,
    "friction": NotNegative,
    "restitution": Annotated[float, Limits(least=0.0, most=1.0)],
    "category": Bits,
    "mask": Bits,
    "surface_speed": Finite,
    "rolling_resistance": NotNegative,
}
"""What the keywords of every shape may be, by name."""
FIELDS: dict[str, Any] = {
    **MATERIAL,
    "mass": Positive,
    "inertia": NotNegative,
    "radius": Positive,
    "rounding": NotNegative,
    "half_width": Positive,
    "half_height": Positive,
    "length": NotNegative,
    "present_length": Positive,
    "max_length": Positive,
    "min_length": NotNegative,
    "frequency": NotNegative,
    "spring_frequency": Positive,
    "damping_ratio": NotNegative,
    "lower": Finite,
    "upper": Finite,
    "motor_speed": Finite,
    "speed": Finite,
    "max_motor_torque": NotNegative,
    "max_motor_force": NotNegative,
    "max_force": NotNegative,
    "break_force": Positive,
    "reference_angle": Finite,
    "ratio": Finite,
    "phase": Finite,
    "length_scale": Positive,
    "angle": Finite,
    "angular_velocity": Finite,
    "linear_damping": NotNegative,
    "angular_damping": NotNegative,
    "gravity_scale": Finite,
}
"""Types and limits of the numbers of bodies, shapes and joints, by name."""
_LABELS = {"rounding": "radius", "spring_frequency": "frequency", "present_length": "length"}
_CHECKS = {name: checker(hint) for name, hint in FIELDS.items()}
_LIMITS = {name: number_limits(hint) for name, hint in FIELDS.items()}
_finite = checker(Finite)
truth = checker(bool)
"""Returns True or False, or raises a TypeError with the name."""
whole = checker(int)
"""Returns an integer, or raises a TypeError with the name."""


class Material(TypedDict, total=False):
    """Keywords that every shape takes."""

    density: float  # >= 0 [kg/m^2], default 1, of a sensor 0; segments have no mass
    friction: float  # Coulomb coefficient >= 0 [1], default 0.5
    restitution: float  # coefficient of restitution in [0, 1], default 0
    category: int  # 32 bits: the categories of the shape, default 1
    mask: int  # 32 bits: the categories with which it collides, default all
    surface_speed: float  # speed of the surface, clockwise: the top of a belt moves right [m/s], default 0
    rolling_resistance: float  # largest torque over normal force and radius of the round shape, >= 0 [1], default 0
    one_way: Any  # direction (2,) in the body's frame: it collides only with bodies from that side; default none
    sensor: bool  # whether it only detects overlaps (``Simulation.overlaps``), default False


BODY_TRAITS = {"linear_damping": 0.0, "angular_damping": 0.0, "gravity_scale": 1.0}
SHAPE_TRAITS = {"surface_speed": 0.0, "rolling_resistance": 0.0}
"""Neutral values of the optional numbers of bodies and of shapes, by name."""
ROLES = ("sensor", "one_way")
"""Keywords that make a shape something other than solid."""
ROLE_TRAITS = {"role": 0.0, "one_way": 0.0}
"""Stored values of these keywords: a ``ShapeRole``, and the angle of a direction."""


class BodyTraits(TypedDict, total=False):
    """Optional keywords of bodies; a scene without them spends no time and no memory on them."""

    fixed_rotation: bool  # whether the body cannot rotate (its inverse inertia is 0), default False
    linear_damping: float  # rate >= 0 [1/s], default 0: a free velocity decays as exp(-linear_damping t)
    angular_damping: float  # rate >= 0 [1/s], default 0: a free spin decays as exp(-angular_damping t)
    gravity_scale: float  # factor of the world's gravity for the body [1], default 1


def body_type(value: Any, where: str) -> BodyType:
    """Return a ``BodyType``, given as such or as its number.

    Raises:
        TypeError, ValueError: naming ``where``.
    """
    names = [kind.name for kind in BodyType]
    if isinstance(value, BodyType):
        return value
    if not isinstance(value, int | np.integer) or isinstance(value, bool):
        raise WrongType(f"type of {where} is {shown(value)}; it must be one of {names}")
    if value not in set(BodyType):
        raise ValueError(f"type of {where} is {shown(value)}; it must be one of {names}")
    return BodyType(int(value))


def number(name: str, value: Any, where: str) -> float:
    """Return one number within the limits of its field.

    Raises:
        TypeError, ValueError: "radius of shape 3 is -1; it must be finite and > 0", where ``where`` is "shape 3".
    """
    return _CHECKS[name](f"{_LABELS.get(name, name)} of {where}", value)


def refuse_keyword(where: str, given: Iterable[str], known: Sequence[str], others: Sequence[str] = ()) -> None:
    """Raise a TypeError for the first keyword that is none of those known.

    Args:
        where: what it was given for.
        given: names of keywords.
        known: those that are taken.
        others: arguments that may be meant, too.
    """
    wrong = next((name for name in given if name not in known), None)
    if wrong is not None:
        more = f"beside its own arguments it takes {', '.join(known)}"
        likely = [name for name in (*known, *others) if name != wrong]
        raise TypeError(f"{wrong!r} is no keyword of {where}{meant(wrong, likely)}; {more}")


def material(
    where: str,
    density: Any = 1.0,
    friction: Any = 0.5,
    restitution: Any = 0.0,
    category: Any = 1,
    mask: Any = ALL_BITS,
    **others: Any,
) -> tuple[float, ...]:
    """Return the values of a shape's keywords, each checked against its limits.

    Raises:
        TypeError, ValueError: naming field and ``where``; ``others`` are none of a shape.
    """
    refuse_keyword(where, others, (*Material.__annotations__,), ("center", "angle", "radius", "closed", "one_sided"))
    return (
        number("density", density, where),
        number("friction", friction, where),
        number("restitution", restitution, where),
        number("category", category, where),
        number("mask", mask, where),
    )


def fill(column: np.ndarray, name: str, values: Any) -> None:
    """Write numbers within the limits of their field into a column; a single one fills it.

    Raises:
        TypeError, ValueError: naming field, index and limit.
    """
    kind, limits = _LIMITS[name]
    plain = type(values) is kind
    if plain and limits.hold(values) and abs(values) <= limits.size:
        column[:] = values  # as most are, which would take five times as long below
        return
    wanted = f"a number or {column.shape}"
    array = numeric(name, values, wanted)
    if array.shape not in ((), column.shape):
        raise ValueError(f"{name} has shape {array.shape}; it must be {wanted}")
    good = limits.hold_all(array)
    if kind is int:
        good &= array == np.floor(array)
    if not good.all():
        i = int(good.argmin())
        value = array.flat[i].item() if kind is int else float(array.flat[i])
        place = f"[{i}]" if array.ndim else " of the discs"
        raise ValueError(f"{name}{place} is {value!r}; {limits.demand(value, kind)}")
    column[:] = array


def trait_columns(call: str, traits: Mapping[str, Any], count: int) -> dict[str, np.ndarray]:
    """Return the numbers of what few bodies and shapes have, (count,) each, by name.

    Raises:
        TypeError, ValueError: naming ``call`` and an argument that it has not got; field, index and limit.
    """
    found: dict[str, np.ndarray] = {}
    for name, values in traits.items():
        if name == "sensor":
            found["role"] = np.where(truths(name, values, count), float(ShapeRole.SENSOR), 0.0)
        elif name == "fixed_rotation":
            found[name] = truths(name, values, count)
        elif name in {**BODY_TRAITS, **SHAPE_TRAITS}:
            fill(found.setdefault(name, np.empty(count)), name, values)
        else:
            raise TypeError(f"{call}() has no argument {name!r}")
    return found


def role_of(where: str, one_sided: bool, sensor: Any = False, one_way: Any = None) -> dict[str, float]:
    """Return what the keywords of ``ROLES`` say of a shape, and of a one-sided chain, as ``ROLE_TRAITS``.

    Raises:
        TypeError, ValueError: naming field and ``where``; for more than one of them.
    """
    given = {
        ShapeRole.SENSOR: truth(f"sensor of {where}", sensor),
        ShapeRole.ONE_WAY: one_way is not None,
        ShapeRole.ONE_SIDED: one_sided,
    }
    roles = [role for role, wanted in given.items() if wanted]
    if len(roles) > 1:
        raise ValueError(f"{where} is to be {' and '.join(role.name for role in roles)}; it has one role")
    x, y = (1.0, 0.0) if one_way is None else unit("one_way", one_way, where)
    return {"role": float(roles[0] if roles else ShapeRole.SOLID), "one_way": math.atan2(y, x)}


def truths(name: str, values: Any, count: int) -> np.ndarray:
    """Return truth values, (count,), given as such or as one of all.

    Raises:
        TypeError, ValueError: naming field, index and limit.
    """
    if not isinstance(values, np.ndarray | list | tuple):
        return np.full(count, truth(name, values))
    array = numeric(name, values, f"True, False, or bools of shape ({count},)", "b")
    if array.shape != (count,):
        raise ValueError(f"{name} has shape {array.shape}; it must be a bool or ({count},)")
    return array


def pair(name: str, value: Any, where: str) -> tuple[float, float]:
    """Return two finite numbers.

    Raises:
        TypeError, ValueError: naming field and ``where``.
    """
    if not (isinstance(value, tuple | list) and len(value) == 2):
        value = numeric(f"{name} of {where}", given := value, "two numbers")
        if value.shape != (2,):
            raise ValueError(f"{name} of {where} is {shown(given)}; it must be two numbers")
    return _finite(f"{name}[0] of {where}", value[0]), _finite(f"{name}[1] of {where}", value[1])


def triple(name: str, value: Any, where: str) -> tuple[float, float, float]:
    """Return three finite numbers.

    Raises:
        TypeError, ValueError: naming field and ``where``.
    """
    numbers = numeric(f"{name} of {where}", value, "three numbers")
    if numbers.shape != (3,):
        raise ValueError(f"{name} of {where} is {shown(value)}; it must be three numbers")
    x, y, z = (_finite(f"{name}[{k}] of {where}", numbers[k].item()) for k in range(3))
    return x, y, z


def unit(name: str, value: Any, where: str) -> tuple[float, float]:
    """Return a direction of length 1 along two finite numbers.

    Raises:
        TypeError, ValueError: naming field and ``where``.
    """
    x, y = pair(name, value, where)
    length = math.hypot(x, y)
    if not 0.0 < length < math.inf:
        raise ValueError(f"{name} of {where} is ({x:g}, {y:g}); it must be a direction, of a length that is not 0")
    return x / length, y / length


def check_values(name: str, values: Any, shape: tuple[int, ...], dtype: np.dtype, *, finite: bool = True) -> np.ndarray:
    """Values as a contiguous array of the given shape and dtype.

    Where these are integers, an array of floats that are whole is taken, as ``np.zeros`` makes one, and truth values.

    Raises:
        TypeError: naming the field: what is no number; truth values, where these are floats.
        ValueError: naming field and first bad index: another shape, an integer that does not fit, and, where numbers
            must be ``finite``, NaN or inf.
    """
    array = numeric(name, values, f"numbers of shape {shape}", "iuf" if dtype.kind == "f" else "buif")
    if array.shape != shape:
        raise ValueError(f"{name} has shape {array.shape}; it must be {shape}")
    bad = limit = None
    with np.errstate(over="ignore", invalid="ignore"):
        kept = np.ascontiguousarray(array, dtype=dtype)
        if dtype.kind != "f":
            if array.dtype != dtype:
                bad, limit = np.argwhere(kept.reshape(shape) != array), with_article(dtype.name)
        elif finite and not np.isfinite(kept.sum()):  # looking at each takes several times as long
            bad, limit = np.argwhere(~np.isfinite(array)), "finite"
            if not len(bad):
                bad = np.argwhere(~np.isfinite(kept.reshape(shape)))
                limit = f"within {np.finfo(dtype).max:g} of zero, as {dtype}"
    if bad is not None and len(bad):
        index = tuple(int(i) for i in bad[0])
        place = f"[{', '.join(map(str, index))}]" if index else ""
        raise ValueError(f"{name}{place} is {array[index]}; it must be {limit}")
    return kept
