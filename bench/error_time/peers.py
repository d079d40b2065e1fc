"""Scenes of any shapes in pymunk and pybox2d: built from a model and state of ours, stepped, and read back."""

from __future__ import annotations

import math
from typing import Any, Protocol

import numpy as np

import dc_kernels as dc
from bench.peers.peers import require
from dc_kernels.model.enums import ShapeType


class World(Protocol):
    """One engine's copy of a world."""

    def run(self, steps: int, dt: float) -> None:
        """Take steps of dt [s]."""

    def places(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions (bodies, 2) [m] and angles (bodies,) [rad] of all bodies, the static ones too, in our order."""


class _Scene:
    """What a builder reads of the first world of a model."""

    def __init__(self, model: dc.Model, state: dc.State, joints: dc.Joints) -> None:
        self.model = {name: model.numpy(name) for name in model.table}
        self.state = {name: state.numpy(name).astype(np.float64) for name in ("position", "angle", "velocity")}
        self.spin = state.numpy("angular_velocity").astype(np.float64)
        self.joints = {name: joints.numpy(name) for name in joints.table}
        self.count = model.body_count
        self.gravity = tuple(self.model["gravity"][0].tolist())

    def shapes(self, body: int) -> list[tuple[int, np.ndarray, float, float]]:
        """Type, vertices (n, 2) [m], radius [m] and friction of a body's shapes."""
        found = []
        for s in range(*self.model["body_shape_start"][body : body + 2]):
            vertices = self.model["vertices"][slice(*self.model["vertex_start"][s : s + 2])].astype(np.float64)
            kind = int(self.model["shape_type"][s])
            if kind == ShapeType.SEGMENT:
                vertices = vertices[:2]
            radius, friction = (float(self.model[f"shape_{name}"][s]) for name in ("radius", "friction"))
            found.append((kind, vertices, radius, friction))
        return found


class Pymunk:
    """Chipmunk; it multiplies friction coefficients, so each shape has the root of the pair's."""

    def __init__(self, model: dc.Model, state: dc.State, joints: dc.Joints, iterations: int) -> None:
        """Copy the first world."""
        pymunk = require("pymunk")
        scene = _Scene(model, state, joints)
        self.space = pymunk.Space()
        self.space.gravity = scene.gravity
        self.space.iterations = iterations
        self.bodies = []
        for b in range(scene.count):
            if scene.model["body_type"][b] == dc.BodyType.DYNAMIC:
                # what does not turn has an infinite moment here
                moment = float(scene.model["inertia"][b]) or math.inf
                body = pymunk.Body(float(scene.model["mass"][b]), moment)
            else:
                body = pymunk.Body(body_type=pymunk.Body.STATIC)
            body.position = tuple(scene.state["position"][b])
            body.angle = float(scene.state["angle"][b])
            shapes = []
            for kind, vertices, radius, friction in scene.shapes(b):
                points = [tuple(vertex) for vertex in vertices]
                shape: Any
                if kind == ShapeType.DISC:
                    shape = pymunk.Circle(body, radius, points[0])
                elif len(points) == 2:
                    shape = pymunk.Segment(body, points[0], points[1], radius)
                else:
                    shape = pymunk.Poly(body, points, radius=radius)
                shape.friction, shape.elasticity = math.sqrt(friction), 0.0
                shapes.append(shape)
            self.space.add(body, *shapes)
            if body.body_type == pymunk.Body.DYNAMIC:
                body.velocity, body.angular_velocity = tuple(scene.state["velocity"][b]), float(scene.spin[b])
            self.bodies.append(body)
        for j in range(len(scene.joints["joint_body_a"])):
            ends = [self.bodies[scene.joints[f"joint_body_{end}"][j]] for end in "ab"]
            anchors = [tuple(scene.joints[f"joint_anchor_{end}"][j].tolist()) for end in "ab"]
            self.space.add(pymunk.PinJoint(*ends, *anchors))

    def run(self, steps: int, dt: float) -> None:
        for _ in range(steps):
            self.space.step(dt)

    def places(self) -> tuple[np.ndarray, np.ndarray]:
        return np.array([tuple(b.position) for b in self.bodies]), np.array([b.angle for b in self.bodies])


class Pybox2d:
    """Box2D 2.3; its edges and polygons carry a skin of 1 cm, which is taken away. A capsule is a box and two discs."""

    def __init__(
        self, model: dc.Model, state: dc.State, joints: dc.Joints, velocity_iterations: int, position_iterations: int
    ) -> None:
        """Copy the first world."""
        box2d = require("Box2D")
        scene = _Scene(model, state, joints)
        self.iterations = velocity_iterations, position_iterations
        self.space = box2d.b2World(gravity=scene.gravity, doSleep=False)
        self.space.warmStarting = True
        self.bodies = []
        for b in range(scene.count):
            place = {
                "position": tuple(scene.state["position"][b].tolist()),
                "angle": float(scene.state["angle"][b]),
            }
            dynamic = scene.model["body_type"][b] == dc.BodyType.DYNAMIC
            body = self.space.CreateDynamicBody(**place) if dynamic else self.space.CreateStaticBody(**place)
            for kind, vertices, radius, friction in scene.shapes(b):
                for shape in self._shapes(box2d, kind, vertices, radius):
                    body.CreateFixture(shape=shape, density=1.0, friction=friction, restitution=0.0)
            if dynamic:
                mass, inertia = float(scene.model["mass"][b]), float(scene.model["inertia"][b])
                body.massData = box2d.b2MassData(mass=mass, I=inertia, center=(0.0, 0.0))
                body.linearVelocity = tuple(scene.state["velocity"][b].tolist())
                body.angularVelocity = float(scene.spin[b])
            self.bodies.append(body)
        for j in range(len(scene.joints["joint_body_a"])):
            a, b = (self.bodies[scene.joints[f"joint_body_{end}"][j]] for end in "ab")
            anchors = [tuple(scene.joints[f"joint_anchor_{end}"][j].tolist()) for end in "ab"]
            self.space.CreateDistanceJoint(
                bodyA=a,
                bodyB=b,
                localAnchorA=anchors[0],
                localAnchorB=anchors[1],
                length=float(scene.joints["joint_length"][j]),
            )

    @staticmethod
    def _shapes(box2d: Any, kind: int, vertices: np.ndarray, radius: float) -> list[Any]:
        points = [tuple(vertex) for vertex in vertices.tolist()]
        if kind == ShapeType.DISC:
            return [box2d.b2CircleShape(radius=radius, pos=points[0])]
        if kind == ShapeType.SEGMENT:
            edge = box2d.b2EdgeShape(vertices=points)
            edge.radius = 0.0
            return [edge]
        discs = []
        if len(points) == 2:
            discs = [box2d.b2CircleShape(radius=radius, pos=point) for point in points]
            along = vertices[1] - vertices[0]
            across = radius * np.array([-along[1], along[0]]) / np.linalg.norm(along)
            points = [tuple(p) for p in (*(vertices - across), *(vertices[::-1] + across))]
        polygon = box2d.b2PolygonShape(vertices=points)
        polygon.radius = 0.0 if discs else radius
        return [polygon, *discs]

    def run(self, steps: int, dt: float) -> None:
        for _ in range(steps):
            self.space.Step(dt, *self.iterations)

    def places(self) -> tuple[np.ndarray, np.ndarray]:
        places = np.array([tuple(body.position) for body in self.bodies], np.float64)
        return places.reshape(-1, 2), np.array([body.angle for body in self.bodies], np.float64)


ENGINES: dict[str, tuple[type, tuple[tuple[int, ...], ...]]] = {
    "pymunk": (Pymunk, ((5,), (10,), (20,), (50,), (100,))),
    "pybox2d": (Pybox2d, ((4, 2), (10, 3), (10, 10), (20, 10), (50, 20), (100, 40))),
}
"""What makes a world, and its numbers of iterations: of pybox2d velocity and position iterations."""
