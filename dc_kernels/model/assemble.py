"""From a builder's rows to the fields of the model, vectorised: reference points, masses, scales.

Everything is float64 here; the builder casts.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from dc_kernels.model.arrays import ArrayGroup, Model, State
from dc_kernels.model.config import SolverConfig
from dc_kernels.model.enums import BodyType, ShapeType
from dc_kernels.model.fields import JOINTS, KEY_SHAPE_BITS
from dc_kernels.model.joints.groups import COLUMNS, Joints, count_rows
from dc_kernels.model.joints.heavy import with_rows_across
from dc_kernels.model.shapes import edge_normals, mass_properties
from dc_kernels.model.validate.known import Made

CELL_FACTOR = 1.3
"""The finest cell holds the smallest box of a dynamic shape with this to spare: a box then meets few cells [1]."""

TOGETHER = 2**12  # numbers of an array that is looked at in one piece with others

# columns of the tables of bodies (NaN mass or inertia: from the shapes) and shapes
X, Y, ANGLE, VX, VY, SPIN, TYPE, MASS, INERTIA = range(9)
BODY, SHAPE, COUNT, RADIUS, DENSITY, FRICTION, RESTITUTION, CATEGORY, MASK = range(9)


class World(NamedTuple):
    """A world's settings, and how much was there when it began."""

    gravity: tuple[float, float]
    origin: tuple[float, float]
    length_scale: float  # NaN: from the shapes
    body: int
    joint: int


def assemble(
    worlds: list[World],
    bodies: np.ndarray,
    shapes: np.ndarray,
    vertices: np.ndarray,
    joints: np.ndarray,
    sensors: np.ndarray | None = None,
    centers: Mapping[int, np.ndarray] | None = None,
) -> dict[str, np.ndarray]:
    """All fields of the model, state and joints that are not zero, in float64 (integers as they are).

    Args:
        worlds: their settings.
        bodies: (n, 9) and ``shapes`` (m, 9), with the columns named above.
        vertices: (v, 2) [m], shape after shape, in the frames of the bodies.
        joints: (j, ``joints.WIDTH``), with the columns named in ``joints.COLUMNS``.
        sensors: which shapes, sorted by body, are sensors, (m,) bool: these are no measure of a world's lengths, and
            move no centre of mass unless they weigh; None: none.
        centers: centre of mass of bodies by their index, where it is not to be that of their shapes, (2,) [m].

    Raises:
        ValueError: a dynamic body without mass; too many shapes in a world.
    """
    owner = shapes[:, BODY].astype(np.int64)
    if (np.diff(owner) < 0).any():
        order = np.argsort(owner, kind="stable")
        vertices = vertices[np.argsort(np.repeat(owner, shapes[:, COUNT].astype(np.int64)), kind="stable")]
        shapes, owner = shapes[order], owner[order]
    body_start = np.array([w.body for w in worlds] + [len(bodies)])
    shapes_of = np.bincount(owner, minlength=len(bodies))
    shape_start = _starts(shapes_of)[body_start]
    shapes_per_world = np.diff(shape_start)
    if shapes_per_world.max() > 2**KEY_SHAPE_BITS:
        w = int(shapes_per_world.argmax())
        raise ValueError(
            f"world {w} has {shapes_per_world[w]} shapes; at most {2**KEY_SHAPE_BITS} fit the contact keys"
        )
    world_of = np.repeat(np.arange(len(worlds)), np.diff(body_start))

    geometry = Geometry(shapes, vertices)
    weighed = np.ones(len(shapes), bool) if sensors is None else ~sensors | (shapes[:, DENSITY] > 0)
    com, mass, inertia = _masses(bodies, shapes, owner, weighed, geometry)
    solid = slice(None) if sensors is None else ~sensors
    for body, center in (centers or {}).items():
        com[body] = center
    dynamic = bodies[:, TYPE] == BodyType.DYNAMIC
    length_scale, cell_size = _scales(worlds, world_of[owner][solid], 2 * geometry.extent[solid], dynamic[owner][solid])
    links = {name: joints[:, at] if at.stop - at.start > 1 else joints[:, at.start] for name, at in COLUMNS.items()}
    links |= {name: links[name].astype(np.int64) for name in links if JOINTS[name].dtype == "int32"}
    links["joint_parts"] = with_rows_across(links, bodies[:, TYPE], mass)
    return {
        "body_start": body_start,
        "shape_start": shape_start,
        "joint_start": np.array([w.joint for w in worlds] + [len(joints)]),
        "gravity": np.array([w.gravity for w in worlds]),
        "origin": np.array([w.origin for w in worlds]),
        "length_scale": length_scale,
        "cell_size": cell_size,
        "body_type": bodies[:, TYPE].astype(np.int32),
        "mass": mass,
        "inertia": inertia,
        "inv_mass": np.divide(1.0, mass, out=np.zeros_like(mass), where=mass > 0),
        "inv_inertia": np.divide(1.0, inertia, out=np.zeros_like(inertia), where=inertia > 0),
        "center_of_mass": com,
        "shape_body": owner,
        "shape_type": shapes[:, SHAPE].astype(np.int32),
        "shape_radius": shapes[:, RADIUS],
        "shape_center": geometry.center - com[owner],
        "shape_extent": geometry.extent,
        "shape_friction": shapes[:, FRICTION],
        "shape_restitution": shapes[:, RESTITUTION],
        "shape_category": shapes[:, CATEGORY].astype(np.uint32),
        "shape_mask": shapes[:, MASK].astype(np.uint32),
        "vertex_start": geometry.vertex_start,
        "vertices": vertices - np.repeat(com[owner], geometry.count, axis=0),
        "vertex_normals": geometry.normals,
        **place(worlds, bodies, com),
        **links,
        "joint_anchor_a": links["joint_anchor_a"] - com[links["joint_body_a"]],
        "joint_anchor_b": links["joint_anchor_b"] - com[links["joint_body_b"]],
        "joint_row_start": _starts(count_rows(links["joint_kind"], links["joint_parts"])),
    }


def place(worlds: list[World], bodies: np.ndarray, com: np.ndarray) -> dict[str, np.ndarray]:
    """All fields of the state that are not zero, in float64.

    Args:
        worlds: their settings.
        bodies: see ``assemble``.
        com: their centres of mass, in their frames, (n, 2) [m].
    """
    origin, first = np.array([w.origin for w in worlds]), np.array([w.body for w in worlds] + [len(bodies)])
    cos, sin = np.cos(bodies[:, ANGLE]), np.sin(bodies[:, ANGLE])
    arm = np.stack((cos * com[:, 0] - sin * com[:, 1], sin * com[:, 0] + cos * com[:, 1]), axis=1)
    spin = bodies[:, SPIN]
    return {
        "position": (bodies[:, X : Y + 1] - origin.repeat(np.diff(first), axis=0)) + arm,
        "angle": bodies[:, ANGLE],
        "velocity": bodies[:, VX : VY + 1] + spin[:, None] * np.stack((-arm[:, 1], arm[:, 0]), axis=1),
        "angular_velocity": spin,
    }


def as_scalar(fields: dict[str, np.ndarray], real: np.dtype) -> dict[str, np.ndarray]:
    """Fields in a model's scalar type, but for integers and origins; what is too large becomes infinite."""
    with np.errstate(over="ignore", invalid="ignore"):
        return {
            name: value.astype(real) if value.dtype.kind == "f" and name != "origin" else value
            for name, value in fields.items()
        }


def groups_of(fields: dict[str, np.ndarray], made: Made | None, *memory: Any) -> tuple[Model, State, Joints]:
    """The groups of a scene.

    Args:
        fields: of the state in float64 (integers as they are), and of model and joints.
        made: model and joints of an equal scene, where the fields are not those of these too.
        memory: dtype, device and backend.

    Raises:
        ValueError: see ``write``.
    """
    sizes, of_joints = _sizes(fields) if made is None else (made.sizes, made.of_joints)
    model, state, joints = Model(sizes, *memory), State(sizes, *memory), Joints(of_joints, *memory)
    write(state, fields)
    if made is not None and model.whole is not None and joints.whole is not None:
        model.whole.put(made.model)
        joints.whole.put(made.joints)
    else:
        write(model, fields)
        write(joints, fields)
    return model, state, joints


def _sizes(fields: Mapping[str, np.ndarray]) -> tuple[dict[str, int], dict[str, int]]:
    """Elements on the axes of model and state, and on those of joints."""
    world, body, shape = len(fields["gravity"]), len(fields["angle"]), len(fields["shape_body"])
    sizes = {"world": world, "world+1": world + 1, "body": body, "body+1": body + 1}
    sizes |= {"shape": shape, "shape+1": shape + 1, "vertex": len(fields["vertices"])}
    sizes |= {"body trait": body * ("gravity_scale" in fields), "shape trait": shape * ("shape_role" in fields)}
    return sizes, {"joint": len(fields["joint_kind"]), "joint row": int(fields["joint_row_start"][-1])}


def write(group: ArrayGroup, fields: dict[str, np.ndarray]) -> None:
    """Write fields into a group that was just made, in its scalar type.

    Raises:
        ValueError: naming the field and the first bad index, see ``ArrayGroup.assign``.
    """
    names = [name for name in group.table if name in fields]  # the others begin as zero
    if group.device != "cpu" or not _written(group, {name: fields[name] for name in names}):
        cast = as_scalar({name: fields[name] for name in names}, group.dtype)
        for name in names:
            group.assign(name, cast[name])


def _written(group: ArrayGroup, fields: dict[str, np.ndarray]) -> bool:
    """Write fields on the CPU; whether a glance at all of them shows that every number fits."""
    small, right = [np.zeros(1, group.dtype)], True
    with np.errstate(over="ignore", invalid="ignore"):
        for name, values in fields.items():
            memory = group.memory(name)
            if memory.shape != values.shape:
                return False
            memory[...] = values
            if memory.dtype.kind != "f":
                right &= memory.dtype == values.dtype or bool((memory == values).all())
            elif memory.dtype != group.dtype or memory.size > TOGETHER:
                right &= bool(np.isfinite(memory.sum()))
            else:
                small.append(memory.reshape(-1))
        return right and bool(np.isfinite(np.concatenate(small).sum()))


class Geometry:
    """Of each shape, in the frame it was given in; worked out for all shapes of a kind at once."""

    @classmethod
    def of(cls, kind: np.ndarray, count: np.ndarray, radius: np.ndarray, vertices: np.ndarray) -> Geometry:
        """Of shapes of some types, with so many vertices each and rounded by so much."""
        shapes = np.zeros((len(kind), MASK + 1))
        shapes[:, SHAPE], shapes[:, COUNT], shapes[:, RADIUS] = kind, count, radius
        return cls(shapes, np.asarray(vertices, np.float64))

    def __init__(self, shapes: np.ndarray, vertices: np.ndarray) -> None:
        self.count = shapes[:, COUNT].astype(np.int64)
        self.vertex_start = _starts(self.count)
        self.normals = np.zeros_like(vertices)
        self.center = np.zeros((len(shapes), 2))
        self.area = np.zeros(len(shapes))
        self.length = np.zeros(len(shapes))  # of a segment
        self.inertia = np.zeros(len(shapes))  # about the centroid, of unit density
        self.extent = np.zeros(len(shapes))
        code = shapes[:, SHAPE].astype(np.int64) * 16 + self.count
        for kind in np.flatnonzero(np.bincount(code)):
            chosen = np.flatnonzero(code == kind)
            radius = shapes[chosen, RADIUS]
            n = 2 if kind // 16 == ShapeType.SEGMENT else kind % 16  # without a segment's neighbours
            index = self.vertex_start[chosen, None] + np.arange(n)
            corners = vertices[index]
            self.normals[index] = edge_normals(corners)
            if kind // 16 == ShapeType.SEGMENT:
                self.center[chosen] = corners.mean(axis=1)
                self.length[chosen] = np.hypot(*(corners[:, 1] - corners[:, 0]).T)
            else:
                self.area[chosen], self.center[chosen], self.inertia[chosen] = mass_properties(corners, radius)
            reach = corners - self.center[chosen, None]
            self.extent[chosen] = np.hypot(reach[..., 0], reach[..., 1]).max(axis=1) + radius


def _masses(
    bodies: np.ndarray, shapes: np.ndarray, owner: np.ndarray, weighed: np.ndarray, geometry: Geometry
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centre of mass, mass and inertia of the bodies; of a body's shapes those count that are ``weighed``, or all."""
    n = len(bodies)
    shapes_of, counted = np.bincount(owner, minlength=n), np.bincount(owner[weighed], minlength=n)
    weighed = weighed | (counted[owner] == 0)
    counted = np.where(counted > 0, counted, shapes_of)
    given_mass, given_inertia = bodies[:, MASS], bodies[:, INERTIA]
    dynamic, kinematic = bodies[:, TYPE] == BodyType.DYNAMIC, bodies[:, TYPE] == BodyType.KINEMATIC
    weight = shapes[:, DENSITY] * geometry.area
    dense = np.bincount(owner, weight, n)
    lacking = dynamic & np.isnan(given_mass) & ~(dense > 0)
    if lacking.any():
        i = int(lacking.argmax())
        why = "the densities of its shapes are zero" if shapes_of[i] else "it has no shape"
        raise ValueError(f"mass of body {i} is not given and {why}; a dynamic body needs a mass > 0")
    # a body of given mass whose densities are all zero is taken as uniform, over its areas, or along its chains if it
    # has none; a static one has no mass to weigh by
    chained = np.bincount(owner, geometry.area * weighed, n)[owner] == 0
    measure = np.where(chained, geometry.length, geometry.area)
    weight = np.where(dynamic[owner], np.where(dense[owner] > 0, weight, measure), 1.0) * weighed
    total = np.bincount(owner, weight, n)
    safe = np.where(total > 0, total, 1.0)
    com = np.stack([np.bincount(owner, weight * geometry.center[:, k], n) / safe for k in (0, 1)], axis=1)
    # without the rounding of a product and a division: a centred disc stays at zero
    single = weighed & (counted[owner] == 1)
    com[owner[single]] = geometry.center[single]
    com[kinematic] = 0.0
    offset = geometry.center - com[owner]
    along = geometry.length * geometry.length / 12.0
    gyration = np.divide(geometry.inertia, geometry.area, out=along, where=geometry.area > 0)
    spread = np.bincount(owner, weight * (gyration + (offset * offset).sum(axis=1)), n)
    mass = np.where(dynamic, np.where(np.isnan(given_mass), total, given_mass), 0.0)
    inertia = np.where(dynamic, np.where(np.isnan(given_inertia), spread * (mass / safe), given_inertia), 0.0)
    return com, mass, inertia


def _scales(
    worlds: list[World], world: np.ndarray, diameter: np.ndarray, dynamic: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Length scale and finest cell of the worlds from their shapes' diameters."""
    n = len(worlds)
    moving = np.bincount(world, dynamic, n) > 0
    used = dynamic | ~moving[world]
    world, diameter = world[used], diameter[used]
    diameter = diameter[np.lexsort((diameter, world))]
    count = np.bincount(world, minlength=n)
    start = _starts(count)[:-1]
    median = np.ones(n)
    some = count > 0
    first, many = start[some], count[some]
    median[some] = (diameter[first + (many - 1) // 2] + diameter[first + many // 2]) / 2
    given = np.array([w.length_scale for w in worlds])
    scale = np.where(np.isnan(given), median, given)
    smallest = scale.copy()
    smallest[some] = diameter[first]
    return scale, CELL_FACTOR * (smallest + 2 * SolverConfig.margin * scale)


def _starts(counts: np.ndarray) -> np.ndarray:
    """Where each of consecutive runs begins, and where the last one ends."""
    return np.concatenate(([0], np.cumsum(counts)))
