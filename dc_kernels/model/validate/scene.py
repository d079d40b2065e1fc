"""Checks of a model, its state and joints."""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels.model.arrays import ArrayGroup, Model, State
from dc_kernels.model.dtypes import float_name, numpy_spec
from dc_kernels.model.enums import BodyType, JointPart, ShapeRole, ShapeType
from dc_kernels.model.fields import JOINTS, KEY_SHAPE_BITS, MODEL, STATE, TRAITS
from dc_kernels.model.joints.groups import HELD, OPTIONAL, Joints, check_extents, count_rows
from dc_kernels.model.rules import INVERSE_TOLERANCE, BrokenRule, Index, Start, refuse
from dc_kernels.model.settings import WrongType, checker
from dc_kernels.model.validate.arrays import Layout, check_field, check_start, parts_of, sane
from dc_kernels.model.validate.geometry import check_geometry
from dc_kernels.model.validate.glance import Arrays
from dc_kernels.model.validate.known import Facts, facts_of, is_known, key_of, remember_right, remember_state
from dc_kernels.runtime.backends import kernel_file, on_numpy

CORNERS = ("vertices", "vertex_normals")
_model, _state, _joints = checker(Model), checker(State), checker(Joints)


def check_scene(
    model: Model, state: State | None, joints: Joints | None, *, again: bool = False
) -> tuple[State, Joints, Facts]:
    """Hold a model, its state and joints to each other, to their memory as kernels need it, and to their rules.

    Args:
        model: of the scene.
        state: of the scene.
        joints: of the scene; None for none.
        again: remember what a small state holds, as it is soon to be checked again: then it is compared.

    Returns:
        The state; the joints, of which there are none for None; what is known of all models that hold the same.

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
    key = key_of(model, joints)
    facts = None if key is None else facts_of(key)
    right = facts is not None and is_known(state)
    if facts is None:
        _check_memory(model, "model")
        _check_memory(joints, "joints")
    if not right:
        _check_memory(state, "state")
    if facts is None:
        check_model(model.views(), backend=model.backend)
    if not right:
        offsets = {name: model.memory(name) for name in ("body_start", "shape_start", "joint_start", "mass")}
        check_state(state.views(), offsets, backend=model.backend)
    if facts is None:
        check_joints(joints.views(), model.views())
        facts = remember_right(key)
    if again:
        remember_state(state)
    return state, joints, facts


def _check_memory(group: ArrayGroup, label: str) -> None:
    """Raise ValueError, naming the field, for an array that a kernel must not see, whatever it holds.

    That is one of another type, dtype, shape, device or memory layout than is allocated.
    """
    for name, field in group.table.items():
        if name in group.blocks:
            continue
        array = getattr(group, name)
        scalar, shape = numpy_spec(field, group.dtype)
        count = group.sizes[field.per]
        found: tuple[Any, ...] = (
            type(array).__name__,
            getattr(array, "dtype", None),
            getattr(array, "shape", None),
        )
        if on_numpy(group.backend):
            wanted: tuple[Any, ...] = ("ndarray", scalar, (count, *shape))
            whole = isinstance(array, np.ndarray) and array.flags.c_contiguous
        else:
            import warp as wp

            dtype = kernel_file(group.backend, "groups").field_type(field, float_name(group.dtype))
            if found[0] == "array" and wp.types.types_equal(found[1], dtype):
                found = (found[0], dtype, found[2])  # Warp makes equal vector types anew
            found += (str(getattr(array, "device", None)),)
            wanted = ("array", dtype, (count,), group.device)
            whole = getattr(array, "is_contiguous", False)
        if found != wanted:
            raise ValueError(f"{label}.{name} is {found}; it must be {wanted}")
        if not whole:
            raise ValueError(f"{label}.{name} has strides {array.strides}; it must be contiguous")


def check_model(model: Arrays, label: str = "model.", backend: str = "numpy") -> None:
    """Hold the arrays of a ``Model`` to their rules and to each other.

    Args:
        model: all fields of ``model.fields.MODEL`` by name.
        label: what stands before the name of an array in errors.
        backend: that may look at large arrays, if it has compiled code.

    Raises:
        BrokenRule: naming array, index, value and limit.
    """
    lengths = {field.per: len(model[name]) for name, field in MODEL.items()}
    if lengths["world"] < 1:
        raise BrokenRule(label.rstrip("./"), "has no world; it must have one at least")
    for trait, axis in TRAITS.items():
        if lengths[trait] not in (0, lengths[axis]):
            name = next(name for name, field in MODEL.items() if field.per == trait)
            raise BrokenRule(
                f"{label}{name}", f"has {lengths[trait]}; it must have 0, or {lengths[axis]}: one a {axis}"
            )
    lengths["joint"] = int(model["joint_start"][-1])  # check_joints holds the joints to it
    for name, field in MODEL.items():
        if isinstance(field.rule, Start):
            check_start(f"{label}{name}", model[name], lengths[field.rule.axis], field.rule.spare)
    layout = Layout(model, backend=backend)
    kept = layout.glance.keeping({name: values for name, values in model.items() if name not in CORNERS}, MODEL)
    for name, field in MODEL.items():
        if name not in kept and name not in CORNERS and not isinstance(field.rule, Index):  # shape_body: see below
            check_field(f"{label}{name}", field, model[name], layout)
    shapes_fit = layout.glance.shapes(model)  # one pass over the largest arrays of a model, that of their rules too
    if not shapes_fit:
        for name in CORNERS:
            check_field(f"{label}{name}", MODEL[name], model[name], layout)

    if len(role := model["shape_role"]):
        wrong = (role == ShapeRole.ONE_SIDED) & (model["shape_type"] != ShapeType.SEGMENT)
        refuse(f"{label}shape_role", role, wrong, "another role than ONE_SIDED, for its shape is no SEGMENT of a chain")
    shapes = np.diff(model["shape_start"])
    refuse(f"the number of shapes of {label}shape_start", shapes, shapes > 2**KEY_SHAPE_BITS, f"<= {2**KEY_SHAPE_BITS}")
    if not layout.glance.bodies(model):
        _check_owners(model, layout, label)
        for part in parts_of(lengths["body"]):
            _check_masses(model, part, label)
    if not shapes_fit:
        check_geometry(model, label)


def _check_owners(model: Arrays, layout: Layout, label: str) -> None:
    """Hold bodies of shapes to their worlds."""
    check_field(f"{label}shape_body", MODEL["shape_body"], model["shape_body"], layout)


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


def check_state(
    state: Arrays, model: Arrays, label: str = "state.", *, frozen: bool = False, backend: str = "numpy"
) -> None:
    """Hold the arrays of a ``State`` to their rules.

    Args:
        state: all fields of ``model.fields.STATE`` by name.
        model: offsets and masses of a model that ``check_model`` has passed.
        label: what stands before the name of an array in errors.
        frozen: pass whatever froze a world: numbers of worlds with flags may be NaN or inf.
        backend: that may look at large arrays, if it has compiled code.

    Raises:
        BrokenRule: naming array, index, value and limit.
    """
    layout = Layout(model, backend=backend)
    arrays = sane(STATE, state, layout, state["flags"] if frozen else None)
    kept = layout.glance.keeping(arrays, STATE)
    for name, values in arrays.items():
        if name not in kept:
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
    start = joints["joint_row_start"]
    check_start(f"{label}joint_row_start", start, len(joints["joint_impulse"]))
    if not len(a):
        return
    layout = Layout(model)
    kept = layout.glance.keeping(joints, JOINTS)
    for name, values in joints.items():
        if name not in kept:
            check_field(f"{label}{name}", JOINTS[name], values, layout)
    rows = count_rows(joints["joint_kind"], joints["joint_parts"])
    refuse(f"{label}joint_row_start", start[1:], np.diff(start) != rows, "where the rows of joint_parts end", 1)
    _check_parts(joints, label)
    refuse(f"{label}joint_body_b", b, a == b, "another body than body A")
    dynamic = model["body_type"] == BodyType.DYNAMIC
    refuse(f"{label}joint_body_b", b, ~(dynamic[a] | dynamic[b]), "DYNAMIC, for body A is not")


def _check_parts(joints: Arrays, label: str) -> None:
    """Hold the parts of joints to their kinds, and lengths and limits to their parts."""
    kind, parts = joints["joint_kind"], joints["joint_parts"]
    optional = np.array([int(OPTIONAL.get(one, 0)) for one in HELD])[kind]
    parted = (parts | optional) == (int(JointPart.HOLD) | optional)
    across = parts & int(JointPart.ACROSS)
    parted &= (across == 0) | (parts == int(JointPart.HOLD) | across)
    refuse(f"{label}joint_parts", parts, ~parted | (parts == 0), "those that its kind has")
    check_extents(joints, label)
