"""ModelBuilder: worlds, bodies, shapes and joints one by one or in bulk, then all arrays at once.

What is added is kept as rows of numbers; ``finalize`` turns them into the arrays of ``model/fields.py`` with numpy, in
float64 up to the last cast, so that a world far from the origin is as exact as one at it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from dc_kernels.model.arrays import Model, State
from dc_kernels.model.assemble import (
    ANGLE,
    BODY,
    CATEGORY,
    COUNT,
    DENSITY,
    FRICTION,
    INERTIA,
    MASK,
    RADIUS,
    RESTITUTION,
    SHAPE,
    SPIN,
    TYPE,
    VX,
    VY,
    World,
    X,
    Y,
    assemble,
    groups_of,
    place,
)
from dc_kernels.model.checks import (
    ALL_BITS,
    BODY_TRAITS,
    ROLE_TRAITS,
    ROLES,
    SHAPE_TRAITS,
    BodyTraits,
    Material,
    body_type,
    fill,
    material,
    number,
    pair,
    role_of,
    trait_columns,
    truth,
    whole,
)
from dc_kernels.model.dtypes import float_dtype
from dc_kernels.model.enums import BodyType, ShapeRole, ShapeType
from dc_kernels.model.joints.builder import JointBuilder
from dc_kernels.model.joints.groups import WIDTH, Joints
from dc_kernels.model.row_table import RowTable, Traits
from dc_kernels.model.settings import numeric, shown
from dc_kernels.model.shapes import TOLERANCE, box_vertices, convex_polygon, points
from dc_kernels.model.validate.known import Key, made_of, remember_made, tables_key
from dc_kernels.model.validate.scene import check_scene
from dc_kernels.runtime.backends import check_device

if TYPE_CHECKING:
    from typing_extensions import Unpack


class ModelBuilder(JointBuilder):
    """Collects worlds and makes their ``Model``, ``State`` and ``Joints``.

    Worlds are built one after the other: every ``add_*`` adds to the latest world, checks its
    arguments and raises a ValueError that names field, index and limit. All shapes take the keywords of
    ``Material``.

    Shape indices count shapes in the order in which they are added. In the model shapes are sorted by body, so the
    two agree only if shapes are added body by body.
    """

    def __init__(self) -> None:
        self._worlds: list[World] = []
        self._bodies = RowTable(9)
        self._shapes = RowTable(9)
        self._vertices = RowTable(2)
        self._joints = RowTable(WIDTH)
        self._body_traits, self._shape_traits = Traits(BODY_TRAITS), Traits({**SHAPE_TRAITS, **ROLE_TRAITS})
        self._centers: dict[int, np.ndarray] = {}

    def add_world(self, gravity: Any = (0.0, -9.8), origin: Any = (0.0, 0.0), length_scale: float | None = None) -> int:
        """Begin a new world and return its index.

        Args:
            gravity: acceleration (2,) [m/s^2].
            origin: (2,) [m], subtracted from all positions before they are cast to the model's dtype.
            length_scale: typical diameter of a body, > 0 [m]; None: the median diameter of the dynamic bodies' shapes
                (of all shapes if there are none, and 1 m in an empty world).
        """
        where = f"world {len(self._worlds)}"
        scale = math.nan if length_scale is None else number("length_scale", length_scale, where)
        world = World(
            pair("gravity", gravity, where),
            pair("origin", origin, where),
            scale,
            self._bodies.count,
            self._joints.count,
        )
        self._worlds.append(world)
        return len(self._worlds) - 1

    def add_body(
        self,
        position: Any = (0.0, 0.0),
        angle: float = 0.0,
        velocity: Any = (0.0, 0.0),
        angular_velocity: float = 0.0,
        type: BodyType = BodyType.DYNAMIC,
        mass: float | None = None,
        inertia: float | None = None,
        **traits: Unpack[BodyTraits],
    ) -> int:
        """Add a body to the latest world and return its index over all worlds.

        Args:
            position: position (2,) [m] of the origin of the body's frame, in world coordinates.
            angle: orientation [rad], counter-clockwise.
            velocity: velocity (2,) [m/s] of the origin of the body's frame; zero for a static body.
            angular_velocity: [rad/s], counter-clockwise; zero for a static body.
            type: static, kinematic or dynamic.
            mass: [kg], > 0; None: from the shapes' density. It only affects dynamic bodies.
            inertia: moment of inertia [kg m^2] about the centre of mass, >= 0; with 0 the body does not rotate; None:
                from the shapes (a given mass is distributed by their densities), 0 for a point mass without shape.
            **traits: see ``BodyTraits``; they only affect dynamic bodies.
        """
        where = f"body {self._bodies.count}"
        self._need_world(where)
        kind = body_type(type, where)
        x, y = pair("position", position, where)
        vx, vy = pair("velocity", velocity, where)
        spin = number("angular_velocity", angular_velocity, where)
        if kind == BodyType.STATIC and (vx or vy or spin):
            raise ValueError(f"velocity of {where} is ({vx}, {vy}), {spin}; a static body must have none")
        if traits and self._traits(where, spin, inertia, **traits):
            inertia = 0.0
        return self._bodies.append(
            x,
            y,
            number("angle", angle, where),
            vx,
            vy,
            spin,
            kind,
            math.nan if mass is None else number("mass", mass, where),
            math.nan if inertia is None else number("inertia", inertia, where),
        )

    def add_disc(self, body: int, radius: float, center: Any = (0.0, 0.0), **material: Unpack[Material]) -> int:
        """Add a disc of ``radius`` > 0 [m] around ``center`` (2,) [m] in the body's frame; return its shape index."""
        where = self._shape_of(body)
        radius = number("radius", radius, where)
        return self._add(
            body, ShapeType.DISC, np.array([pair("center", center, where)]), radius, self._material(where, material)
        )

    def add_box(
        self,
        body: int,
        half_width: float,
        half_height: float,
        center: Any = (0.0, 0.0),
        angle: float = 0.0,
        radius: float = 0.0,
        **material: Unpack[Material],
    ) -> int:
        """Add a box and return its shape index.

        Args:
            body: index of the body.
            half_width: half the width > 0 [m], without the rounding.
            half_height: half the height > 0 [m], without the rounding.
            center: centre (2,) [m], in the body's frame.
            angle: orientation [rad], in the body's frame.
            radius: radius >= 0 [m] of the rounding, which enlarges the box on all sides.
            **material: see ``Material``.
        """
        where = self._shape_of(body)
        half_width, half_height = number("half_width", half_width, where), number("half_height", half_height, where)
        corners = box_vertices(half_width, half_height, pair("center", center, where), number("angle", angle, where))
        radius = number("rounding", radius, where)
        return self._add(
            body,
            ShapeType.POLYGON,
            convex_polygon(corners, f"corners of {where}"),
            radius,
            self._material(where, material),
        )

    def add_polygon(self, body: int, vertices: Any, radius: float = 0.0, **material: Unpack[Material]) -> int:
        """Add a convex polygon and return its shape index.

        Args:
            body: index of the body.
            vertices: (n, 2) [m], 3 <= n <= 8, in the body's frame, in either order; see ``convex_polygon``.
            radius: radius >= 0 [m] of the rounding, which enlarges the polygon on all sides.
            **material: see ``Material``.
        """
        where = self._shape_of(body)
        checked = convex_polygon(vertices, f"vertices of {where}")
        radius = number("rounding", radius, where)
        return self._add(body, ShapeType.POLYGON, checked, radius, self._material(where, material))

    def add_capsule(self, body: int, p1: Any, p2: Any, radius: float, **material: Unpack[Material]) -> int:
        """Add a capsule of ``radius`` > 0 [m] around the segment from ``p1`` to ``p2`` (2,) [m]; return its index."""
        where = self._shape_of(body)
        ends = np.array((pair("p1", p1, where), pair("p2", p2, where)))
        radius = number("radius", radius, where)
        length = math.hypot(*(ends[1] - ends[0]))
        if not length > TOLERANCE * radius:
            raise ValueError(f"p1 and p2 of {where} are {length:g} m apart; it must exceed {TOLERANCE:g} of the radius")
        return self._add(body, ShapeType.POLYGON, ends, radius, self._material(where, material))

    def add_chain(
        self, body: int, vertices: Any, closed: bool = False, one_sided: bool = False, **material: Unpack[Material]
    ) -> np.ndarray:
        """Add a chain of segments and return their shape indices.

        Each segment stores its neighbours in the chain, so that bodies do not catch on the vertices. Segments do not
        collide with segments. They have no mass; the ``mass`` of a dynamic body that has only chains is spread along
        them.

        Args:
            body: index of the body.
            vertices: (n, 2) [m], n >= 2, or n >= 3 if closed, in the body's frame. Successive ones must be further
                apart than 1e-6 of the chain's size.
            closed: whether to add the segment from the last vertex to the first.
            one_sided: whether the chain collides only on the right of the path from vertex to vertex.
            **material: see ``Material``.
        """
        where = self._shape_of(body)
        closed, one_sided = truth(f"closed of {where}", closed), truth(f"one_sided of {where}", one_sided)
        corners = points(vertices, f"vertices of {where}", 3 if closed else 2)
        start = corners if closed else corners[:-1]
        end = np.concatenate((corners[1:], corners[:1]))[: len(start)]
        edges = end - start
        length = np.hypot(edges[:, 0], edges[:, 1])
        size = math.hypot(*np.ptp(corners, axis=0))
        if length.min() <= TOLERANCE * size:
            i = int(length.argmin())
            raise ValueError(
                f"vertices of {where}: {i} and {(i + 1) % len(corners)} are {length[i]:g} m apart; "
                f"it must exceed {TOLERANCE:g} of the chain's size {size:g}"
            )
        before, after = np.concatenate((start[-1:], start[:-1])), np.concatenate((end[1:], end[:1]))
        if not closed:
            before[0], after[-1] = start[0], end[-1]
        first, n = self._shapes.count, len(start)
        row = np.array((body, ShapeType.SEGMENT, 4, 0.0, *self._material(where, material, n, one_sided)))
        self._shapes.extend(np.tile(row, (n, 1)))
        self._vertices.extend(np.stack((start, end, before, after), axis=1).reshape(-1, 2))
        return np.arange(first, first + n)

    def add_discs(
        self,
        positions: Any,
        radius: Any,
        *,
        velocity: Any = None,
        angle: Any = 0.0,
        angular_velocity: Any = 0.0,
        density: Any = 1.0,
        friction: Any = 0.5,
        restitution: Any = 0.0,
        category: Any = 1,
        mask: Any = ALL_BITS,
        **traits: Any,
    ) -> np.ndarray:
        """Add n dynamic bodies with a centred disc each, and return their body indices.

        All arguments after ``positions`` except ``velocity`` are one number, or an array (n,).

        Args:
            positions: positions (n, 2) [m], in world coordinates.
            radius: > 0 [m].
            velocity: (n, 2) or (2,) [m/s]; None: at rest.
            angle: [rad].
            angular_velocity: [rad/s].
            density: see ``Material``.
            friction: see ``Material``.
            restitution: see ``Material``.
            category: see ``Material``.
            mask: see ``Material``.
            **traits: those of ``BodyTraits``, and ``surface_speed``, ``rolling_resistance``, ``sensor`` of
                ``Material``.
        """
        first = self._bodies.count
        self._need_world(f"body {first}")
        positions = points(positions, "positions", 0)
        n = len(positions)
        bodies = np.full((n, 9), np.nan)
        bodies[:, X : Y + 1] = positions
        wanted = f"({n}, 2) or (2,)"
        given = (0.0, 0.0) if velocity is None else velocity
        speed = numeric("velocity", given, f"numbers of shape {wanted}", inner=(2,))
        if speed.shape not in ((n, 2), (2,)):
            raise ValueError(f"velocity has shape {speed.shape}; it must be {wanted}")
        bodies[:, VX : VY + 1] = points(speed.reshape(-1, 2), "velocity", 0)
        fill(bodies[:, ANGLE], "angle", angle)
        fill(bodies[:, SPIN], "angular_velocity", angular_velocity)
        bodies[:, TYPE] = BodyType.DYNAMIC
        shapes = np.empty((n, 9))
        shapes[:, BODY] = np.arange(first, first + n)
        shapes[:, SHAPE] = ShapeType.DISC
        shapes[:, COUNT] = 1
        fill(shapes[:, RADIUS], "radius", radius)
        fill(shapes[:, DENSITY], "density", density)
        fill(shapes[:, FRICTION], "friction", friction)
        fill(shapes[:, RESTITUTION], "restitution", restitution)
        fill(shapes[:, CATEGORY], "category", category)
        fill(shapes[:, MASK], "mask", mask)
        if traits:
            columns = trait_columns("add_discs", traits, n)
            self._lock(bodies, columns.pop("fixed_rotation", None))
            self._body_traits.add(first, columns)
            self._shape_traits.add(self._shapes.count, columns)
        self._bodies.extend(bodies)
        self._shapes.extend(shapes)
        self._vertices.extend(np.zeros((n, 2)))
        return np.arange(first, first + n)

    def finalize(
        self, dtype: Any = "float32", device: str = "cpu", backend: str = "warp"
    ) -> tuple[Model, State, Joints]:
        """Return the model, state and joints of all worlds; the builder can be extended and finalized again.

        The reference point of a body is its centre of mass; that of a static body is the mean of its shapes'
        centroids, which keeps coordinates small and exact, and that of a kinematic body the origin of its frame,
        whose velocity is the given one.

        Args:
            dtype: "float32" or "float64".
            device: "cpu", or a CUDA device of Warp.
            backend: "warp", or on the CPU "numpy" or "taichi", see ``runtime.backends``.

        Raises:
            ValueError: there is no world; a dynamic body has no mass; a world has too many shapes; the dtype cannot
                represent a value; dtype, device or backend is unknown.
        """
        real = float_dtype(dtype)
        check_device(device, backend)
        if not self._worlds:
            raise ValueError("the builder has no world: call add_world first")
        key = self._key(real, device, backend)
        made = made_of(key)
        with np.errstate(over="ignore", invalid="ignore"):  # values too large are found when they are assigned
            fields = self._fields() if made is None else place(self._worlds, self._bodies.collect(), made.com)
        model, state, joints = groups_of(fields, made, real, device, backend)
        check_scene(model, state, joints, again=True)  # what was right in float64 may have underflowed
        if made is None:
            remember_made(key, model, joints, fields["center_of_mass"])
        return model, state, joints

    def _key(self, real: np.dtype, device: str, backend: str) -> Key | None:
        """Return a key of all data from which the model and the joints are made."""
        if self._centers or device != "cpu":
            return None
        bodies, shapes = self._bodies.collect()[:, TYPE:], self._shapes.collect()
        given = (*self._body_traits.given, *self._shape_traits.given)
        tables = (bodies, shapes, self._vertices.collect(), self._joints.collect(), *(one[-1] for one in given))
        return tables_key((real, backend, *self._worlds, *(one[:-1] for one in given)), tables)

    def _fields(self) -> dict[str, np.ndarray]:
        """Return all nonzero fields of the model, state and joints, in float64 (integers unchanged)."""
        traits = self._body_traits.collect(np.arange(self._bodies.count))
        surfaces = self._shape_traits.collect(np.argsort(self._shapes.collect()[:, BODY], kind="stable"), "shape_")
        sensors = surfaces["shape_role"] == ShapeRole.SENSOR if surfaces else None
        bodies, shapes = self._bodies.collect(), self._shapes.collect()
        vertices, joints = self._vertices.collect(), self._joints.collect()
        with np.errstate(over="ignore", invalid="ignore"):  # values too large are found when they are assigned
            return assemble(self._worlds, bodies, shapes, vertices, joints, sensors, self._centers) | traits | surfaces

    def _need_world(self, where: str) -> None:
        if not self._worlds:
            raise ValueError(f"{where} has no world: call add_world first")

    def _body(self, name: str, body: Any, where: str) -> int:
        """Return the index of a body of the latest world, checked."""
        self._need_world(where)
        index = whole(f"{name} of {where}", body)
        if not 0 <= index < self._bodies.count:
            raise ValueError(f"{name} of {where} is {shown(index)}; it must lie in [0, {self._bodies.count})")
        if index < self._worlds[-1].body:
            raise ValueError(
                f"{name} of {where} is {index}, a body of an earlier world; "
                f"those of the latest world {len(self._worlds) - 1} begin at {self._worlds[-1].body}"
            )
        return index

    def _shape_of(self, body: Any) -> str:
        """Return the name of the next shape in error messages, after checking its body."""
        where = f"shape {self._shapes.count}"
        self._body("body", body, where)
        return where

    def _add(self, body: int, kind: ShapeType, vertices: np.ndarray, radius: float, material: tuple[float, ...]) -> int:
        self._vertices.extend(vertices)
        return self._shapes.append(int(body), kind, len(vertices), radius, *material)

    def _material(
        self, where: str, given: Mapping[str, Any], count: int = 1, one_sided: bool = False
    ) -> tuple[float, ...]:
        """Return the material of the next ``count`` shapes, and store the keywords that few shapes have."""
        if given.keys().isdisjoint((*SHAPE_TRAITS, *ROLES)) and not one_sided:
            return material(where, **given)
        traits = {name: np.full(count, number(name, given[name], where)) for name in SHAPE_TRAITS if name in given}
        plain = {name: value for name, value in given.items() if name not in (*SHAPE_TRAITS, *ROLES)}
        role = role_of(where, one_sided, **{name: given[name] for name in ROLES if name in given})
        if role["role"] == ShapeRole.SENSOR:
            plain.setdefault("density", 0.0)
        found = material(where, **plain)
        traits |= {name: np.full(count, value) for name, value in role.items()}
        self._shape_traits.add(self._shapes.count, traits)
        return found

    @staticmethod
    def _lock(bodies: np.ndarray, fixed: np.ndarray | None) -> None:
        """Let nothing turn some of the bodies, rows of the table."""
        if fixed is None:
            return
        wrong = fixed & (bodies[:, SPIN] != 0)
        if wrong.any():
            i = int(wrong.argmax())
            raise ValueError(f"angular_velocity[{i}] is {bodies[i, SPIN]:g}; a body of fixed_rotation has one of 0")
        bodies[fixed, INERTIA] = 0.0

    def _traits(self, where: str, spin: float, inertia: Any, fixed_rotation: Any = False, **given: Any) -> bool:
        """Keep what few bodies have for the next one; whether nothing turns it."""
        if unknown := given.keys() - BODY_TRAITS:
            raise TypeError(f"add_body() has no argument {min(unknown)!r}")
        found = {name: np.array([number(name, value, where)]) for name, value in given.items()}
        fixed = truth(f"fixed_rotation of {where}", fixed_rotation)
        if fixed and (spin or inertia):
            raise ValueError(
                f"angular_velocity of {where} is {spin:g}, inertia {shown(inertia)}; a body of fixed_rotation has an "
                "angular_velocity of 0, and an inertia of 0 or None"
            )
        self._body_traits.add(self._bodies.count, found)
        return fixed
