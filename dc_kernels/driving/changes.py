"""Changes of a model while a simulation uses it: checked as a whole, written, and what was derived from it made anew.

A simulation derives from its model what a step then needs not look up: coefficients that all shapes share, kernels for
scenes of discs, boxes and pairs of shapes, colours of contacts, the weight of a typical body. What a change does not
touch keeps its bits: other worlds, and the contacts with their impulses.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from dc_kernels.choice import Planned, check_kernels
from dc_kernels.model.arrays import ArrayGroup, Model, to_numpy
from dc_kernels.model.assemble import Geometry
from dc_kernels.model.checks import check_values
from dc_kernels.model.dtypes import numpy_spec
from dc_kernels.model.enums import BodyType
from dc_kernels.model.fields import (
    CACHE,
    JOINTS,
    KEY_FEATURE_BITS,
    KEY_SHAPE_BITS,
    MODEL,
    PER_CONTACT,
    STATE,
    TRAITS,
    Field,
)
from dc_kernels.model.joints.groups import Joints
from dc_kernels.model.room import rows_of
from dc_kernels.model.rules import Number
from dc_kernels.model.settings import UnknownName, meant, numeric
from dc_kernels.model.validate.arrays import check_rule
from dc_kernels.model.validate.scene import check_joints, check_model
from dc_kernels.runtime.interop import host_view
from dc_kernels.runtime.threads import uninterrupted

if TYPE_CHECKING:
    from dc_kernels.simulation import Simulation

Arrays = dict[str, np.ndarray]

ALONE = (
    *("gravity", "origin", "length_scale", "cell_size", "shape_friction", "shape_restitution"),
    *(name for name in Model.traits if name != "shape_role"),
)
"""Fields that are held to a rule each, and to no other field; categories and masks are held to none."""
PAIRED = ("length_scale", "cell_size", "body_type", "shape_category", "shape_mask", "shape_radius", "vertices")
"""Fields that candidate pairs depend on."""
COLORED = ("body_type", "joint_body_a", "joint_body_b")
"""Fields that the colours of contacts depend on."""
WEIGHED = ("gravity", "body_type", "mass", "inv_mass")
"""Fields that the weight of a typical body depends on."""
SHAPED = ("shape_radius", "vertices")
"""Fields that centres, extents and normals of shapes follow from."""
OWNERS = {"vertex": "shape", "joint row": "joint"}
"""Axes whose elements belong to those of another one."""
CENTERS = ("shape_center", "shape_extent", "vertex_normals")


def change(sim: Simulation, values: Mapping[str, Any]) -> None:
    """Write fields of a model and its joints, or take up what was written to their memory.

    Args:
        sim: one of the simulations that use them.
        values: by name of a field; none: whatever may have been written.

    Raises:
        TypeError, ValueError: naming field, index and limit, before anything is written.
    """
    model, joints = sim.model, sim.joints
    given = {name: _given(name, array, model, joints) for name, array in values.items()}
    _leave_empty(given, sim)
    _complete(given, model)
    _check(given, model, joints)
    users = sorted({*model.users, *joints.users}, key=id)  # others may share either
    with contextlib.ExitStack() as calls:
        for user in users:
            calls.enter_context(user.calls)
        planned = Planned(given, lambda name: (model if name in MODEL else joints).numpy(name))
        for user in users:
            check_kernels(planned, planned, user.config, user.specialize, user.backend)
        if any(user.phase != "advance" for user in users):
            raise ValueError(
                "change_model() in the middle of a step: finish it with solve() and advance(), or take a step"
            )
        changed = {name: _worlds_of(name, given.get(name), model, joints) for name in (given or (*MODEL, *JOINTS))}
        with uninterrupted():
            frozen = given.get("body_type", model.numpy("body_type")) == BodyType.STATIC
            if given:
                frozen &= model.numpy("body_type") != BodyType.STATIC
            for name, array in given.items():
                (model if name in MODEL else joints).fill(name, array)
            for user in users:
                _stop(user, np.flatnonzero(frozen))
                _take_up(user, changed, given)


def _given(name: str, values: Any, model: Model, joints: Joints) -> np.ndarray:
    """An array of a field's own shape and dtype; one element (a number, or a vector) is that of all."""
    group: ArrayGroup = model if name in MODEL else joints
    if name not in group.changeable:
        changeable = (*model.changeable, *joints.changeable)
        why = "cannot be changed in a simulation; make a new one"
        if name not in {**MODEL, **JOINTS}:
            why = "is no field of a model or of joints"
            if name in STATE:
                why += f', but of the state, which is written at any time: sim.state.assign("{name}", values)'
            else:
                why += meant(name, changeable)
        raise UnknownName(f"{name} {why}. It may be one of {', '.join(changeable)}")
    field = group.table[name]
    if field.per in TRAITS and not group.sizes[field.per] and group.sizes[axis := TRAITS[field.per]]:
        keyword = name.removeprefix("shape_")
        raise ValueError(
            f"{name} is not there, as no {axis} was built with any of {', '.join(_beside(field))}; "
            f"give {keyword} to one {axis} at least when the model is built"
        )
    scalar, inner = numpy_spec(field, group.dtype)
    shape = (group.sizes[field.per], *inner)
    array = numeric(name, host_view(name, values), f"numbers of shape {shape}")
    if array.shape == inner:
        one = check_values(name, array, inner, np.dtype(np.float64) if scalar.kind == "f" else scalar)
        array = np.broadcast_to(one, shape)
    return np.array(check_values(name, array, shape, scalar))


def _leave_empty(given: Arrays, sim: Simulation) -> None:
    """Let empty slots of bodies and shapes be as they are, whatever was given for all."""
    if sim.given_ids is None:
        return
    for name, array in given.items():
        axis = TRAITS.get(MODEL[name].per, MODEL[name].per) if name in MODEL else ""
        if axis in ("body", "shape"):
            empty = sim.given_ids.numpy(f"{axis}_id") < 0
            array[empty] = sim.model.numpy(name)[empty]


def _beside(field: Field) -> list[str]:
    """The fields on the axis of a field."""
    return [name for name, other in MODEL.items() if other.per == field.per]


def _complete(given: Arrays, model: Model) -> None:
    """Add what follows from the given fields: inverses of masses, centres, extents and normals of shapes."""
    if "body_type" in given:
        dynamic = given["body_type"] == BodyType.DYNAMIC
        released = dynamic & (model.numpy("body_type") != BodyType.DYNAMIC)
        for name in ("mass", "inertia"):
            if name in given or f"inv_{name}" in given:
                continue
            if released.any():
                i = int(released.argmax())
                raise ValueError(f"{name} is missing; body {i} becomes DYNAMIC and needs one (inertia 0: no turn)")
            given[name] = np.where(dynamic, model.numpy(name), 0).astype(model.dtype)
    for name, other in (("mass", "inv_mass"), ("inertia", "inv_inertia")):
        for one, inverse in ((name, other), (other, name)):
            if one in given and inverse not in given:
                values = given[one].astype(np.float64)
                with np.errstate(over="ignore"):
                    exact = np.divide(1, values, out=np.zeros_like(values), where=values > 0).astype(model.dtype)
                same = given[one] == model.numpy(one)  # keeps its bits, which stem from more digits
                given[inverse] = np.where(same, model.numpy(inverse), exact)
    if any(name in given for name in SHAPED):
        given |= _shaped(given, model)


def _shaped(given: Arrays, model: Model) -> Arrays:
    """Centres, extents and normals, worked out anew for the shapes of which a vertex or the radius has changed."""
    start = model.numpy("vertex_start").astype(np.int64)
    count = np.diff(start)
    radius, vertices = (given.get(name, model.numpy(name)) for name in SHAPED)
    moved = (vertices != model.numpy("vertices")).any(axis=1)[: start[-1]]
    shape = np.repeat(np.arange(len(count)), count)
    differs = radius != model.numpy("shape_radius")
    differs[shape[moved]] = True
    chosen = np.flatnonzero(differs)
    found = {name: model.numpy(name).copy() for name in CENTERS}
    if len(chosen):
        rows = rows_of(start, chosen)
        with np.errstate(all="ignore"):
            geometry = Geometry.of(model.numpy("shape_type")[chosen], count[chosen], radius[chosen], vertices[rows])
        made = {"shape_center": geometry.center, "shape_extent": geometry.extent, "vertex_normals": geometry.normals}
        for name, values in made.items():
            at = rows if name == "vertex_normals" else chosen
            # what is no shape is refused for what was given, not for what follows from it
            found[name][at] = np.where(np.isfinite(values), values, found[name][at])
    return found


def _check(given: Arrays, model: Model, joints: Joints) -> None:
    """Hold what is given to the rules, with the other fields where it is not held alone."""
    rest = set(given) - {*ALONE, "shape_category", "shape_mask"}
    for name in set(given) & set(ALONE):
        if isinstance(rule := MODEL[name].rule, Number):
            check_rule(f"model.{name}", given[name], rule)
    if rest or not given:
        arrays = {**model.views(), **{name: array for name, array in given.items() if name in MODEL}}
        if rest & set(MODEL) or not given:
            check_model(arrays, backend=model.backend)
        check_joints({**joints.views(), **{name: array for name, array in given.items() if name in JOINTS}}, arrays)


def _worlds_of(name: str, values: np.ndarray | None, model: Model, joints: Joints) -> np.ndarray:
    """Which worlds have other values of a field than before, (W,) bool; all where nobody knows."""
    worlds = model.world_count
    field = (MODEL if name in MODEL else JOINTS)[name]
    if values is None:
        return np.ones(worlds, bool)
    group: ArrayGroup = model if name in MODEL else joints
    other = (values != to_numpy(group.array(name))).reshape(len(values), -1).any(axis=1)
    if field.per == "world":
        return other
    axis = {**TRAITS, **OWNERS}.get(field.per, field.per)
    start = model.numpy(f"{axis}_start")
    if field.per == "vertex":
        start = model.numpy("vertex_start")[start]
    elif field.per == "joint row":
        start = joints.numpy("joint_row_start")[start]
    found = np.zeros(worlds, bool)
    chosen = np.flatnonzero(other)
    found[np.searchsorted(start, chosen[chosen < start[-1]], "right") - 1] = True
    return found


def _stop(sim: Simulation, bodies: np.ndarray) -> None:
    """Take the velocities of bodies that have become static: contacts look at those before the step."""
    if len(bodies):
        for name in ("velocity", "angular_velocity"):
            array = to_numpy(sim.state.array(name))
            array[bodies] = 0
            sim.state.fill(name, array)


def _take_up(sim: Simulation, changed: Mapping[str, np.ndarray], given: Arrays) -> None:
    """Derive anew what a simulation has derived from the changed fields."""

    def worlds(names: Iterable[str]) -> np.ndarray:
        return np.logical_or.reduce(
            [np.zeros(sim.model.world_count, bool), *(changed[n] for n in names if n in changed)]
        )

    broken, uncolored = worlds(PAIRED), worlds(COLORED)
    if broken.any():
        for name in ("valid", "kept_count"):
            sim.pairs.fill(name, np.where(broken, 0, to_numpy(sim.pairs.array(name))))
    if uncolored.any():
        recolor(sim, np.flatnonzero(uncolored), np.flatnonzero(worlds(("body_type",))))
    if worlds(WEIGHED).any():
        sim.storage.integrator.weigh(sim.model)
    if "joint_impulse" in given:
        sim.cache.fill("joint_impulse", given["joint_impulse"])
    sim.storage.sleep.forget(np.flatnonzero(worlds(changed)), sim.model.numpy("body_start"))
    sim.adapt_to_model(stale=bool(worlds((*PAIRED, *COLORED)).any()))


def recolor(sim: Simulation, worlds: np.ndarray, turned: np.ndarray) -> None:
    """Let the next step colour all contacts of some worlds anew, and know them by the types that bodies have now."""
    start = sim.contacts.numpy("contact_start")
    for group, count in ((sim.contacts, "contact_count"), (sim.cache, "count")):
        slots = rows_of(start, worlds, group.numpy(count))
        color = to_numpy(group.array("color"))
        color[slots] = -1
        group.fill("color", color)
    slots = rows_of(start, turned, sim.cache.numpy("count"))
    if not len(slots):
        return
    names = [name for name, field in CACHE.items() if field.per in PER_CONTACT and sim.cache.sizes[field.per]]
    arrays = {name: to_numpy(sim.cache.array(name)) for name in names}
    world = np.repeat(turned, sim.cache.numpy("count")[turned])
    before = arrays["key"][slots]
    key = turned_keys(before, world, sim.model)
    order = np.lexsort((key, world))
    for name, array in arrays.items():
        values = key if name == "key" else array[slots]
        if name == "rolling_impulse":  # turns B, where the others are the same from either side
            values = np.where((key ^ before) >> (KEY_SHAPE_BITS + KEY_FEATURE_BITS), -values, values)
        array[slots] = values[order]
        sim.cache.fill(name, array)


def turned_keys(key: np.ndarray, world: np.ndarray, model: Model) -> np.ndarray:
    """Keys of contacts as they are with the present types of bodies: shape A is static, or has the lower index.

    The impulse of a contact is the same from either side, that of its rolling the opposite one; its feature has the
    vertex of A before that of B.

    Args:
        key: of the contacts, (n,).
        world: of each, (n,).
        model: whose types have changed.
    """
    mask, half = 2**KEY_SHAPE_BITS - 1, KEY_FEATURE_BITS // 2
    feature = key & (2**KEY_FEATURE_BITS - 1)
    a, b = (key >> (KEY_SHAPE_BITS + KEY_FEATURE_BITS)) & mask, (key >> KEY_FEATURE_BITS) & mask
    low, high = np.minimum(a, b), np.maximum(a, b)
    body = model.numpy("shape_body")[high + model.numpy("shape_start")[world]]
    static = model.numpy("body_type")[body] == BodyType.STATIC
    first, second = np.where(static, high, low), np.where(static, low, high)
    turned = ((feature & (2**half - 1)) << half) | (feature >> half)
    feature = np.where(first == a, feature, turned)
    return (first << (KEY_SHAPE_BITS + KEY_FEATURE_BITS)) | (second << KEY_FEATURE_BITS) | feature
