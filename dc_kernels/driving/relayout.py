"""A simulation in arrays of other sizes, with everything that it goes on from: more slots, other joints."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from dc_kernels.driving.ids import ATTIC, EMPTY, KINDS
from dc_kernels.model.arrays import ArrayGroup, Model
from dc_kernels.model.checks import BODY_TRAITS, ROLE_TRAITS, SHAPE_TRAITS
from dc_kernels.model.fields import JOINTS, KEY_SHAPE_BITS, MODEL, STATE, TRAITS
from dc_kernels.model.joints.groups import count_rows
from dc_kernels.model.room import rows_of, starts, world_of
from dc_kernels.runtime.memory import check_memory
from dc_kernels.storage import Moves

if TYPE_CHECKING:
    from dc_kernels.simulation import Simulation

NEUTRAL = BODY_TRAITS | {f"shape_{name}": value for name, value in (SHAPE_TRAITS | ROLE_TRAITS).items()}
"""What a body or shape has of the traits where none was given; 0 of others."""
AWAY = 1e4  # length scales from the origin of a world to the body of its empty shapes
LARGE = 10**6  # bodies and shapes together that are looked for memory for before anything is allocated
TRAITED = tuple(name for name, field in MODEL.items() if field.per == "shape trait")
ROW = 256  # empty shapes that lie in a row

Arrays = dict[str, np.ndarray]


class NewJoints(NamedTuple):
    """Joints that come."""

    fields: Arrays
    """Fields of ``JOINTS`` on the axis of joints, with bodies as they will be numbered."""
    world: np.ndarray
    """World of each, (n,)."""
    ids: np.ndarray
    """Id of each, (n,)."""


@dataclass
class Layout:
    """What the arrays of a simulation are to have room for."""

    bodies: np.ndarray
    """Slots of each world, (W,)."""
    shapes: np.ndarray
    """Slots of each world, (W,)."""
    vertices: int
    """Of all worlds."""
    traits: set[str] = field(default_factory=set)
    """Axes of ``fields.TRAITS`` that are to be there."""
    gone: np.ndarray | None = None
    """Joints that go, as they are numbered now."""
    joints: NewJoints | None = None
    """Joints that come."""

    @classmethod
    def of(cls, model: Model) -> Layout:
        """The room that there is."""
        bodies, shapes = (np.diff(model.numpy(f"{axis}_start")).astype(np.int64) for axis in ("body", "shape"))
        return cls(bodies, shapes, model.sizes["vertex"])


def relayout(sim: Simulation, layout: Layout) -> None:
    """Lay the arrays of a simulation out anew; what is in them stays, and launches are bound anew.

    Views taken before show the arrays that there were; ``layout_version`` changes. Contacts keep their impulses. Each
    world has one body more than asked for when this is first done, which the shapes of empty slots belong to.

    Raises:
        MemoryError, OverflowError, ValueError: for more than there may be, before anything is changed.
    """
    model, state, joints, ids = sim.model, sim.state, sim.joints, sim.ids
    first_time = not (ids.numpy("body_id") == ATTIC).any()
    if first_time:
        layout.bodies = layout.bodies + 1
    if layout.shapes.max() > 2**KEY_SHAPE_BITS:
        w = int(layout.shapes.argmax())
        raise OverflowError(f"world {w} needs {layout.shapes[w]} shapes; at most {2**KEY_SHAPE_BITS} fit the keys")
    start = {"body": starts(layout.bodies), "shape": starts(layout.shapes)}
    if sum(int(first[-1]) for first in start.values()) > LARGE:
        grown = max(start[axis][-1] / max(model.sizes[axis], 1) for axis in ("body", "shape"))
        check_memory(f"room for {start['body'][-1]} bodies", grown * sum(sim.memory().values()))
    moves = _moves(sim, layout, start)
    named = {"next_id": ids.numpy("next_id").copy()}
    for kind in KINDS:
        named[f"{kind}_id"] = moves.of(ids.numpy(f"{kind}_id"), kind, EMPTY)
    if layout.joints is not None:
        named["joint_id"][moves.fresh] = layout.joints.ids
    if first_time:
        named["body_id"][start["body"][1:] - 1] = ATTIC
    attics = np.flatnonzero(named["body_id"] == ATTIC)
    fields = _model_fields(model, moves, layout, attics, named["shape_id"])
    linked = _joint_fields(sim, moves, layout)
    states = [
        {name: moves.of(group.numpy(name), "body", 0) for name in STATE if STATE[name].per == "body"}
        | {name: group.numpy(name).copy() for name in STATE if STATE[name].per == "world"}
        for group in (state, sim.built)
    ]
    for values in states:  # far from all else, so that no image and no query sees it
        values["position"][attics] = -AWAY * model.numpy("length_scale")[:, None]
    sizes = dict(moves.sizes)
    for group, values in ((model, fields), (joints, linked), (ids, named), *zip((state, sim.built), states)):
        _refill(group, values, sizes)
    sim.take_layout(moves)


def relink(sim: Simulation, gone: np.ndarray | None, joints: NewJoints | None) -> None:
    """Let joints go and come; arrays of joints and of solver rows are allocated anew, and launches are bound anew.

    Args:
        sim: whose they are.
        gone: joints that go, as they are numbered now.
        joints: that come.
    """
    layout = Layout.of(sim.model)
    layout.gone, layout.joints = gone, joints
    moves = _moves(sim, layout, {axis: sim.model.numpy(f"{axis}_start") for axis in ("body", "shape")})
    named = moves.of(sim.ids.numpy("joint_id"), "joint", EMPTY)
    if joints is not None:
        named[moves.fresh] = joints.ids
    linked = _joint_fields(sim, moves, layout)
    sim.model.fill("joint_start", moves.start["joint"])
    _refill(sim.joints, linked, moves.sizes)
    sim.ids.reallocate(("joint_id",), joint=len(named))
    sim.ids.fill("joint_id", named)
    sim.take_joints(moves)


def _moves(sim: Simulation, layout: Layout, start: Arrays) -> Moves:
    """Where the elements of all axes come to lie."""
    model, joints = sim.model, sim.joints
    sizes, places = {}, {}
    for axis in ("body", "shape"):
        before = model.numpy(f"{axis}_start")
        shift = np.repeat(start[axis][:-1].astype(np.int64) - before[:-1], np.diff(before))
        places[axis] = (np.arange(before[-1]), np.arange(before[-1]) + shift)
        sizes[axis] = int(start[axis][-1])
        sizes[f"{axis}+1"] = sizes[axis] + 1
    first = model.numpy("joint_start")
    kept = np.ones(first[-1], bool)
    if layout.gone is not None:
        kept[layout.gone] = False
    kept_at = np.flatnonzero(kept)
    world = world_of(first)[kept_at]
    kinds = [(joints.numpy(name)[kept_at], name) for name in ("joint_kind", "joint_parts")]
    if layout.joints is not None:
        world = np.concatenate([world, layout.joints.world])
        kinds = [(np.concatenate([values, layout.joints.fields[name]]), name) for values, name in kinds]
    order = np.argsort(world, kind="stable")
    to = np.empty(len(order), np.int64)
    to[order] = np.arange(len(order))
    row_start = starts(count_rows(*(values[order] for values, _ in kinds)))
    start["joint"] = starts(np.bincount(world, minlength=model.world_count))
    start["joint row"] = row_start
    places["joint"] = (kept_at, to[: len(kept_at)])
    places["joint row"] = (rows_of(joints.numpy("joint_row_start"), kept_at), rows_of(row_start, to[: len(kept_at)]))
    sizes |= {"joint": len(to), "joint+1": len(to) + 1, "joint row": int(row_start[-1])}
    sizes |= {"vertex": layout.vertices}
    sizes |= {trait: sizes[axis] for trait, axis in TRAITS.items() if model.sizes[trait] or trait in layout.traits}
    return Moves(sizes, start, places, to[len(kept_at) :])


def _model_fields(model: Model, moves: Moves, layout: Layout, attics: np.ndarray, shape_id: np.ndarray) -> Arrays:
    """Fields of the model; empty slots have a static body without shapes, or a disc that collides with nothing."""
    found = {f"{axis}_start": moves.start[axis] for axis in ("body", "shape", "joint")}
    for name, of in MODEL.items():
        axis = TRAITS.get(of.per, of.per)
        if of.per == "world":
            found[name] = model.numpy(name).copy()
        elif of.per in TRAITS and not moves.sizes.get(of.per, 0):
            continue
        elif axis in ("body", "shape"):
            values, fill = model.numpy(name), NEUTRAL.get(name, 0)
            if of.per in TRAITS and not len(values):
                found[name] = np.full(moves.sizes[axis], fill, values.dtype)
            else:
                found[name] = moves.of(values, axis, fill)
    count = np.ones(moves.sizes["shape"], np.int64)
    source, target = moves.places["shape"]
    count[target] = np.diff(model.numpy("vertex_start"))[source]
    found["vertex_start"] = starts(count)
    kept = rows_of(found["vertex_start"], target)
    for name in ("vertices", "vertex_normals"):
        found[name] = np.zeros((layout.vertices, 2), model.dtype)
        found[name][kept] = model.numpy(name)[: len(kept)]
    found["shape_body"][target] = moves.places["body"][1][model.numpy("shape_body")]
    empty = np.ones(moves.sizes["shape"], bool)
    empty[target] = False
    park(found, np.flatnonzero(empty), attics)
    return found


def park(fields: Arrays, shapes: np.ndarray, attics: np.ndarray) -> None:
    """Make shapes of one vertex discs that collide with nothing, each somewhere else, so that no cell is crowded.

    Args:
        fields: of the model, to be written.
        shapes: indices.
        attics: body of each world that they are to belong to, (W,).
    """
    if not len(shapes):
        return
    world = np.searchsorted(fields["shape_start"], shapes, "right") - 1
    place, scale = shapes - fields["shape_start"][world], fields["length_scale"][world]
    center = -2.0 * scale[:, None] * np.stack([place % ROW + 1, place // ROW + 1], axis=1)
    fields["shape_body"][shapes] = attics[world]
    fields["shape_type"][shapes] = 0
    fields["shape_radius"][shapes] = fields["shape_extent"][shapes] = scale / 2
    fields["shape_center"][shapes] = fields["vertices"][fields["vertex_start"][:-1][shapes]] = center
    fields["vertex_normals"][fields["vertex_start"][:-1][shapes]] = 0
    for name in ("shape_category", "shape_mask"):
        fields[name][shapes] = 0
    for name in TRAITED:
        if len(fields.get(name, ())):
            fields[name][shapes] = NEUTRAL.get(name, 0)
    like = np.flatnonzero(fields["shape_category"])
    for name in ("shape_friction", "shape_restitution"):  # what all have in common is looked up once
        fields[name][shapes] = fields[name][like[0]] if len(like) else 0


def _joint_fields(sim: Simulation, moves: Moves, layout: Layout) -> Arrays:
    """Fields of the joints; those that come have no colour and no impulse."""
    found: Arrays = {"joint_row_start": moves.start["joint row"]}
    for name, of in JOINTS.items():
        if of.per in ("joint", "joint row"):
            found[name] = moves.of(sim.joints.numpy(name), of.per, -1 if name == "joint_color" else 0)
    for name in ("joint_body_a", "joint_body_b"):
        source, target = moves.places["joint"]
        found[name][target] = moves.places["body"][1][sim.joints.numpy(name)[source]]
    if layout.joints is not None:
        for name, values in layout.joints.fields.items():
            found[name][moves.fresh] = values
    return found


def _refill(group: ArrayGroup, values: Arrays, sizes: dict[str, Any]) -> None:
    """Allocate all arrays of a group anew and write them; those without values are zero, or have no elements."""
    group.reallocate(group.table, **{axis: size for axis, size in sizes.items() if axis in group.sizes})
    for name, array in values.items():
        group.fill(name, array)
