"""Worlds of ours in two other engines: Box2D 2.3 (by pybox2d) and Chipmunk (by pymunk), which are imported when called.

Both get the bodies as they stand, with masses, shapes, materials, filters, velocities and joints, and never let a body
sleep. What an engine cannot hold as we do is an error; what it does otherwise by itself is said at each function.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

import dc_kernels as dc
from dc_kernels.model.enums import BodyType, ShapeType
from dc_kernels.model.settings import WrongType, shown
from dc_kernels.runtime.imports import require
from dc_kernels.runtime.inputs import check_whole
from dc_kernels.solve.rows import SURFACED, has_traits, variant_of
from pipeline.scenes.base import Scene
from pipeline.scenes.peer_joints import add_to_box2d, add_to_pymunk, peer_joints

WELD = 0.0025  # vertices of a polygon that are nearer than this become one in Box2D [m]
BITS = 16  # of Box2D's filters


class PeerWorld(NamedTuple):
    """A world of another engine."""

    space: Any
    """``b2World`` or ``pymunk.Space``."""
    bodies: list[Any]
    """Its bodies in the order of ours, static ones too."""


class _Shape(NamedTuple):
    """A shape as the engines are told of it."""

    number: int
    """Of the model, which errors name."""
    kind: int
    points: np.ndarray
    """Vertices in the frame of the body, relative to its centre of mass, (n, 2) [m]."""
    radius: float
    friction: float
    restitution: float
    category: int
    mask: int


class _World:
    """What is read of one world of a model."""

    def __init__(self, scene: Any, world: int, seed: int) -> None:
        model, state, joints = _groups(scene, world, seed)
        world = check_whole("world", world)
        if world >= model.world_count:
            raise ValueError(f"world is {world}; it must lie in [0, {model.world_count})")
        start = model.numpy("body_start")
        self.first, self.last = int(start[world]), int(start[world + 1])
        self.model = {name: model.numpy(name) for name in model.table}
        self.state = {name: state.numpy(name).astype(np.float64) for name in state.table}
        self.gravity = tuple(self.model["gravity"][world].tolist())
        fields = {name: joints.numpy(name) for name in joints.table}
        self.joints = peer_joints(fields, range(*model.numpy("joint_start")[world : world + 2].tolist()), self.first)
        self.shapes = [self._shapes(b) for b in self.bodies]
        for name in ("force", "torque"):
            lasting = np.abs(self.state[name][self.first : self.last])
            bad = np.flatnonzero(lasting.sum(axis=1) if lasting.ndim == 2 else lasting)
            if len(bad):
                at = self.first + int(bad[0])
                raise ValueError(f"{name}[{at}] is {self.state[name][at]}; it must be 0, as theirs last for one step")
        if has_traits(model) or variant_of(model, only_discs=False) in SURFACED:
            raise ValueError(
                "the scene has damping, gravity scales, or surfaces that move or resist rolling: theirs differ"
            )

        if model.numpy("shape_role").any():
            raise ValueError("the scene has sensors, or shapes that hold from one side: theirs differ")

    @property
    def bodies(self) -> range:
        return range(self.first, self.last)

    def _shapes(self, body: int) -> list[_Shape]:
        found = []
        for s in np.flatnonzero(self.model["shape_body"] == body).tolist():
            points = self.model["vertices"][slice(*self.model["vertex_start"][s : s + 2])].astype(np.float64)
            kind = int(self.model["shape_type"][s])
            if kind == ShapeType.SEGMENT:
                points = points[:2]
            radius, friction, restitution = (
                float(self.model[f"shape_{name}"][s]) for name in ("radius", "friction", "restitution")
            )
            category, mask = (int(self.model[f"shape_{name}"][s]) for name in ("category", "mask"))
            found.append(_Shape(s, kind, points, radius, friction, restitution, category, mask))
        return found


def _groups(scene: Any, world: int, seed: int) -> Any:
    """Model, state and joints of whatever has them."""
    if isinstance(scene, Scene):
        scene = scene.build(check_whole("world", world) + 1, seed)
    if isinstance(scene, dc.ModelBuilder):
        return scene.finalize("float64", backend="numpy")
    if isinstance(scene, dc.Simulation):
        return scene.model, scene.state, scene.joints
    if isinstance(scene, tuple) and [type(group) for group in scene] == [dc.Model, dc.State, dc.Joints]:
        return scene
    raise WrongType(
        f"scene is {shown(scene)}; it must be a scene, a ModelBuilder, a Simulation, or (Model, State, Joints)"
    )


def to_pymunk(scene: Any, world: int = 0, *, seed: int = 0) -> PeerWorld:
    """Copy a world to Chipmunk.

    Positions are relative to the world's origin. Chipmunk multiplies coefficients of friction and of restitution:
    each shape gets the root of its own, so that a pair has the geometric mean, as ours has of friction. Chains are
    segments without neighbours, over whose seams a box may stumble.

    Args:
        scene: a scene, a ``ModelBuilder``, a ``Simulation`` as it now stands, or (``Model``, ``State``, ``Joints``).
        world: which of its worlds.
        seed: of a scene's first world.

    Returns:
        The space, which has 10 iterations a step unless told otherwise, and its bodies.

    Raises:
        ImportError: without pymunk.
        TypeError, ValueError: for another scene or world, forces that last, shapes of different restitution, of
            which a pair of ours has the larger, or joints that pymunk does not have.
    """
    pymunk = require("pymunk", "bench")
    given = _World(scene, world, seed)
    shapes = [shape for of_body in given.shapes for shape in of_body]
    for shape in shapes:
        if shape.restitution != shapes[0].restitution:
            raise ValueError(
                f"shape_restitution[{shape.number}] is {shape.restitution:g} and [{shapes[0].number}] is "
                f"{shapes[0].restitution:g}; they must be equal: a pair of pymunk has their product, ours the larger"
            )
    space = pymunk.Space()
    space.gravity = given.gravity
    types = {
        BodyType.STATIC: pymunk.Body.STATIC,
        BodyType.KINEMATIC: pymunk.Body.KINEMATIC,
    }
    bodies = []
    for b, of_body in zip(given.bodies, given.shapes):
        kind = BodyType(int(given.model["body_type"][b]))
        if kind == BodyType.DYNAMIC:
            moment = float(given.model["inertia"][b]) or math.inf  # what does not turn has an infinite one here
            body = pymunk.Body(float(given.model["mass"][b]), moment)
        else:
            body = pymunk.Body(body_type=types[kind])
        body.position = tuple(given.state["position"][b].tolist())
        body.angle = float(given.state["angle"][b])
        space.add(body, *(_pymunk_shape(pymunk, body, shape) for shape in of_body))
        if kind != BodyType.STATIC:
            body.velocity = tuple(given.state["velocity"][b].tolist())
            body.angular_velocity = float(given.state["angular_velocity"][b])
        bodies.append(body)
    for joint in given.joints:
        add_to_pymunk(pymunk, space, bodies, joint)
    return PeerWorld(space, bodies)


def _pymunk_shape(pymunk: Any, body: Any, shape: _Shape) -> Any:
    points = [tuple(point) for point in shape.points.tolist()]
    made: Any
    if shape.kind == ShapeType.DISC:
        made = pymunk.Circle(body, shape.radius, points[0])
    elif len(points) == 2:
        made = pymunk.Segment(body, *points, shape.radius)
    else:
        made = pymunk.Poly(body, points, radius=shape.radius)
    made.friction, made.elasticity = math.sqrt(shape.friction), math.sqrt(shape.restitution)
    made.filter = pymunk.ShapeFilter(categories=shape.category, mask=shape.mask)
    return made


def to_box2d(scene: Any, world: int = 0, *, seed: int = 0) -> PeerWorld:
    """Copy a world to Box2D 2.3.

    Positions are relative to the world's origin; ``userData`` of a body is its index among those of its world. Pairs
    have the friction and restitution that ours have. The skin of 1 cm that Box2D gives to edges and polygons is taken
    away, so that all rest where they do here; a capsule is a box and two discs; chains are edges without neighbours.
    Box2D computes in float32, and moves no body by more than 2 m in a step.

    Args:
        scene: a scene, a ``ModelBuilder``, a ``Simulation`` as it now stands, or (``Model``, ``State``, ``Joints``).
        world: which of its worlds.
        seed: of a scene's first world.

    Raises:
        ImportError: without pybox2d.
        TypeError, ValueError: for another scene or world, forces that last, categories beyond 16 bits, polygons
            with vertices nearer than 2.5 mm, which Box2D welds, or joints that it does not have.
    """
    box2d = require("Box2D", "bench")
    given = _World(scene, world, seed)
    space = box2d.b2World(gravity=given.gravity, doSleep=False)
    space.warmStarting = True
    bodies: list[Any] = []
    for b, of_body in zip(given.bodies, given.shapes):
        kind = BodyType(int(given.model["body_type"][b]))
        make = {
            BodyType.STATIC: space.CreateStaticBody,
            BodyType.KINEMATIC: space.CreateKinematicBody,
            BodyType.DYNAMIC: space.CreateDynamicBody,
        }[kind]
        # the world's doSleep alone lets piles at rest fall asleep
        body = make(
            position=tuple(given.state["position"][b].tolist()),
            angle=float(given.state["angle"][b]),
            userData=len(bodies),
            allowSleep=False,
        )
        for shape in of_body:
            _add_fixtures(box2d, body, shape)
        if kind == BodyType.DYNAMIC:
            mass, inertia = float(given.model["mass"][b]), float(given.model["inertia"][b])
            body.massData = box2d.b2MassData(mass=mass, I=inertia, center=(0.0, 0.0))
        if kind != BodyType.STATIC:
            body.linearVelocity = tuple(given.state["velocity"][b].tolist())
            body.angularVelocity = float(given.state["angular_velocity"][b])
        bodies.append(body)
    for joint in given.joints:
        add_to_box2d(space, bodies, joint)
    return PeerWorld(space, bodies)


def _add_fixtures(box2d: Any, body: Any, shape: _Shape) -> None:
    if shape.category >= 1 << BITS:
        raise ValueError(f"shape_category[{shape.number}] is {shape.category:#x}; Box2D has {BITS} bits")
    edges = np.linalg.norm(shape.points - np.roll(shape.points, 1, axis=0), axis=1)
    if len(shape.points) > 1 and shape.kind != ShapeType.DISC and edges.min() < WELD:
        raise ValueError(
            f"shape {shape.number} has vertices {edges.min():g} m apart; Box2D welds those nearer than {WELD} m"
        )
    for made in _box2d_shapes(box2d, shape):
        fixture = body.CreateFixture(shape=made, density=1.0, friction=shape.friction, restitution=shape.restitution)
        fixture.filterData = box2d.b2Filter(
            categoryBits=shape.category, maskBits=shape.mask & ((1 << BITS) - 1), groupIndex=0
        )


def _box2d_shapes(box2d: Any, shape: _Shape) -> list[Any]:
    points = [tuple(point) for point in shape.points.tolist()]
    if shape.kind == ShapeType.DISC:
        return [box2d.b2CircleShape(radius=shape.radius, pos=points[0])]
    if shape.kind == ShapeType.SEGMENT:
        edge = box2d.b2EdgeShape(vertices=points)
        edge.radius = 0.0
        return [edge]
    discs = []
    if len(points) == 2:
        discs = [box2d.b2CircleShape(radius=shape.radius, pos=point) for point in points]
        along = shape.points[1] - shape.points[0]
        across = shape.radius * np.array([-along[1], along[0]]) / np.linalg.norm(along)
        points = [tuple(p) for p in (*(shape.points - across), *(shape.points[::-1] + across))]
    polygon = box2d.b2PolygonShape(vertices=points)
    polygon.radius = 0.0 if discs else shape.radius
    return [polygon, *discs]
