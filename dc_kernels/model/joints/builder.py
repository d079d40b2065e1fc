"""The calls of a builder that add joints; docs/joints.md says what each kind keeps, and by which equations."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from dc_kernels.model.checks import number, pair, refuse_keyword, triple, truth, unit
from dc_kernels.model.enums import BodyType, JointKind, JointPart
from dc_kernels.model.fields import UNBOUNDED
from dc_kernels.model.joints.groups import COLUMNS, WIDTH, JointOptions
from dc_kernels.model.joints.heavy import IF_HEAVY
from dc_kernels.model.row_table import RowTable

if TYPE_CHECKING:
    from typing_extensions import Unpack

_X, _Y, _ANGLE, _TYPE = 0, 1, 2, 6  # columns of a builder's table of bodies
# arguments of some joints that a misspelt keyword may stand for
MEANT = (
    *("anchor_a", "anchor_b", "axis", "length", "lower", "upper", "motor_speed", "max_motor_torque"),
    *("max_motor_force", "frequency", "damping_ratio", "reference_angle"),
)


class JointBuilder:
    """The methods of a builder that add joints to its latest world; each returns the index of the joint.

    Anchors are in the frames of the bodies. Every method checks its arguments and raises a TypeError or ValueError
    that names field, joint and limit. All joints take the keywords of ``JointOptions``.
    """

    _bodies: RowTable
    _joints: RowTable

    def _body(self, name: str, body: Any, where: str) -> int:
        """The index of a body of the latest world."""
        raise NotImplementedError

    def add_distance_joint(
        self,
        body_a: int,
        body_b: int,
        anchor_a: Any = (0.0, 0.0),
        anchor_b: Any = (0.0, 0.0),
        length: float | None = None,
        *,
        frequency: float = 0.0,
        damping_ratio: float = 0.0,
        lower: float | None = None,
        upper: float | None = None,
        across: bool | None = False,
        **options: Unpack[JointOptions],
    ) -> int:
        """Keep two points at a distance, by a rod or by a spring.

        Args:
            body_a: index of a body of the latest world.
            body_b: index of another body; at least one of the two must be dynamic.
            anchor_a: (2,) [m], in the frame of body A.
            anchor_b: (2,) [m], in the frame of body B.
            length: >= 0 [m]; None: the present distance. A rod of length 0 becomes a revolute joint.
            frequency: natural frequency >= 0 [Hz] of a spring between the bodies without other constraints; 0: a rod.
            damping_ratio: damping ratio >= 0 [1] of the spring; 1: critical damping.
            lower: smallest distance >= 0 [m] of a spring's ends; None: 0.
            upper: largest distance > 0 [m] of a spring's ends; None: no limit.
            across: whether a rod (not a spring) is solved with its tree and has the additional row
                ``JointPart.ACROSS``; None: if its tree weighs more than 12 times the lightest body in it.
            **options: see ``JointOptions``.
        """
        where = f"joint {self._joints.count}"
        a, b = self._ends(body_a, body_b, where)
        anchors = pair("anchor_a", anchor_a, where), pair("anchor_b", anchor_b, where)
        if length is None:
            length = number("present_length", self._distance((a, b), anchors), where)
        length = number("length", length, where)
        options.setdefault("collide_connected", True)
        spring = {
            "frequency": number("frequency", frequency, where),
            "damping_ratio": number("damping_ratio", damping_ratio, where),
        }
        low, high, limited = self._limits(lower, upper, where, least=0.0)
        rigid = spring["frequency"] == 0.0
        parts = IF_HEAVY if across is None else int(JointPart.ACROSS) * truth(f"across of {where}", across)
        if parts and not rigid:
            raise ValueError(f"across of {where} is {across}, and it is a spring; only rods have a row across")
        if rigid and limited:
            raise ValueError(
                f"frequency of {where} is 0, and it has limits; a rod's length has none: give the frequency of a "
                "spring, or add_rope_joint"
            )
        if rigid and length == 0.0:
            return self._add_joint(JointKind.REVOLUTE, (a, b), anchors, where, options)
        parts |= int(JointPart.HOLD | (JointPart.LIMIT if limited else JointPart.NONE))
        more = {"length": length, "lower": low, "upper": high, **spring}
        return self._add_joint(JointKind.DISTANCE, (a, b), anchors, where, options, parts, **more)

    def add_rope_joint(
        self,
        body_a: int,
        body_b: int,
        anchor_a: Any = (0.0, 0.0),
        anchor_b: Any = (0.0, 0.0),
        max_length: float | None = None,
        *,
        min_length: float = 0.0,
        **options: Unpack[JointOptions],
    ) -> int:
        """Keep the distance of two points between two lengths.

        Args:
            body_a: see ``add_distance_joint``.
            body_b: see ``add_distance_joint``.
            anchor_a: (2,) [m], in the frame of body A.
            anchor_b: (2,) [m], in the frame of body B.
            max_length: largest distance > 0 [m]; None: the present distance.
            min_length: smallest distance [m], from 0 to ``max_length``.
            **options: see ``JointOptions``.
        """
        where = f"joint {self._joints.count}"
        a, b = self._ends(body_a, body_b, where)
        anchors = pair("anchor_a", anchor_a, where), pair("anchor_b", anchor_b, where)
        if max_length is None:
            max_length = self._distance((a, b), anchors)
        high = number("max_length", max_length, where)
        low = number("min_length", min_length, where)
        if low > high:
            raise ValueError(f"min_length of {where} is {low:g}; it must be at most max_length, {high:g}")
        options.setdefault("collide_connected", True)
        more = {"length": high, "lower": low, "upper": high}
        return self._add_joint(JointKind.DISTANCE, (a, b), anchors, where, options, JointPart.LIMIT, **more)

    def add_revolute_joint(
        self,
        body_a: int,
        body_b: int,
        anchor_a: Any = (0.0, 0.0),
        anchor_b: Any = None,
        *,
        lower: float | None = None,
        upper: float | None = None,
        motor_speed: float = 0.0,
        max_motor_torque: float | None = None,
        reference_angle: float | None = None,
        **options: Unpack[JointOptions],
    ) -> int:
        """Hold two points together by a hinge, with an optional motor and limits of the angle of B relative to A.

        Args:
            body_a: index of a body of the latest world.
            body_b: index of another body; at least one of the two must be dynamic.
            anchor_a: (2,) [m], in the frame of body A.
            anchor_b: (2,) [m], in the frame of body B; None: the present position of ``anchor_a``.
            lower: smallest angle of the joint [rad]; None: no limit.
            upper: largest angle of the joint [rad]; None: no limit.
            motor_speed: target angular velocity of B relative to A [rad/s].
            max_motor_torque: largest torque of the motor >= 0 [N m]; None: no motor.
            reference_angle: angle of B minus that of A at which the joint's angle is 0 [rad]; None: the present one.
            **options: see ``JointOptions``.
        """
        where = f"joint {self._joints.count}"
        a, b, anchors = self._placed(body_a, body_b, anchor_a, anchor_b, where)
        parts, more = self._driven(lower, upper, motor_speed, max_motor_torque, "max_motor_torque", where)
        more["reference"] = self._reference(a, b, reference_angle, where)
        return self._add_joint(JointKind.REVOLUTE, (a, b), anchors, where, options, JointPart.HOLD | parts, **more)

    def add_prismatic_joint(
        self,
        body_a: int,
        body_b: int,
        axis: Any,
        anchor_a: Any = (0.0, 0.0),
        anchor_b: Any = None,
        *,
        lower: float | None = None,
        upper: float | None = None,
        motor_speed: float = 0.0,
        max_motor_force: float | None = None,
        reference_angle: float | None = None,
        **options: Unpack[JointOptions],
    ) -> int:
        """Let body B slide on a line of body A without rotating against it, with an optional motor and limits.

        Args:
            body_a: see ``add_revolute_joint``.
            body_b: see ``add_revolute_joint``.
            axis: direction of the line (2,) in the frame of body A; its length may be any but 0.
            anchor_a: a point of the line (2,) [m], in the frame of body A.
            anchor_b: see ``add_revolute_joint``.
            lower: smallest displacement of anchor B from anchor A along the axis [m]; None: no limit.
            upper: largest displacement [m]; None: no limit.
            motor_speed: target velocity along the axis [m/s].
            max_motor_force: largest force of the motor >= 0 [N]; None: no motor.
            reference_angle: see ``add_revolute_joint``.
            **options: see ``JointOptions``.
        """
        where = f"joint {self._joints.count}"
        a, b, anchors = self._placed(body_a, body_b, anchor_a, anchor_b, where)
        parts, more = self._driven(lower, upper, motor_speed, max_motor_force, "max_motor_force", where)
        more["reference"] = self._reference(a, b, reference_angle, where)
        more["axis"] = unit("axis", axis, where)
        return self._add_joint(JointKind.PRISMATIC, (a, b), anchors, where, options, JointPart.HOLD | parts, **more)

    def add_weld_joint(
        self,
        body_a: int,
        body_b: int,
        anchor_a: Any = (0.0, 0.0),
        anchor_b: Any = None,
        *,
        frequency: float = 0.0,
        damping_ratio: float = 0.0,
        reference_angle: float | None = None,
        **options: Unpack[JointOptions],
    ) -> int:
        """Hold two points together, and the angle between their bodies rigidly or by a spring.

        Args:
            body_a: see ``add_revolute_joint``.
            body_b: see ``add_revolute_joint``.
            anchor_a: see ``add_revolute_joint``.
            anchor_b: see ``add_revolute_joint``.
            frequency: natural frequency >= 0 [Hz] of a spring of the angle; 0: rigid.
            damping_ratio: damping ratio >= 0 [1] of the spring; 1: critical damping.
            reference_angle: see ``add_revolute_joint``.
            **options: see ``JointOptions``.
        """
        where = f"joint {self._joints.count}"
        a, b, anchors = self._placed(body_a, body_b, anchor_a, anchor_b, where)
        more: dict[str, Any] = {"reference": self._reference(a, b, reference_angle, where)}
        more["frequency"] = number("frequency", frequency, where)
        more["damping_ratio"] = number("damping_ratio", damping_ratio, where)
        return self._add_joint(JointKind.WELD, (a, b), anchors, where, options, **more)

    def add_wheel_joint(
        self,
        body_a: int,
        body_b: int,
        axis: Any = (0.0, 1.0),
        anchor_a: Any = (0.0, 0.0),
        anchor_b: Any = None,
        *,
        frequency: float = 2.0,
        damping_ratio: float = 0.7,
        lower: float | None = None,
        upper: float | None = None,
        motor_speed: float = 0.0,
        max_motor_torque: float | None = None,
        **options: Unpack[JointOptions],
    ) -> int:
        """Hold a point of body B, a freely rotating wheel, on a line of body A by a spring: a suspension.

        Args:
            body_a: see ``add_revolute_joint``.
            body_b: index of the wheel.
            axis: direction of the suspension (2,) in the frame of body A; its length may be any but 0.
            anchor_a: position at which the spring holds the wheel (2,) [m], in the frame of body A.
            anchor_b: see ``add_revolute_joint``.
            frequency: natural frequency >= 0 [Hz] of the spring; 0: rigid.
            damping_ratio: damping ratio >= 0 [1] of the spring.
            lower: smallest displacement of anchor B from anchor A along the axis [m]; None: no limit.
            upper: largest displacement [m]; None: no limit.
            motor_speed: target angular velocity of B relative to A [rad/s].
            max_motor_torque: largest torque of the motor >= 0 [N m]; None: no motor.
            **options: see ``JointOptions``.
        """
        where = f"joint {self._joints.count}"
        a, b, anchors = self._placed(body_a, body_b, anchor_a, anchor_b, where)
        parts, more = self._driven(lower, upper, motor_speed, max_motor_torque, "max_motor_torque", where)
        more["axis"] = unit("axis", axis, where)
        more["frequency"] = number("frequency", frequency, where)
        more["damping_ratio"] = number("damping_ratio", damping_ratio, where)
        return self._add_joint(JointKind.WHEEL, (a, b), anchors, where, options, JointPart.HOLD | parts, **more)

    def add_target_joint(
        self,
        body_a: int,
        body_b: int,
        anchor_a: Any = (0.0, 0.0),
        anchor_b: Any = (0.0, 0.0),
        *,
        max_force: float,
        frequency: float = 5.0,
        damping_ratio: float = 0.7,
        **options: Unpack[JointOptions],
    ) -> int:
        """Pull a point of body B to a point of body A by a spring of limited force, as for dragging with a mouse.

        Args:
            body_a: index of a body of the latest world; with a static body, ``anchor_a`` is a target that may be moved
                between steps: ``joint_anchor_a`` of ``joints.assign``, relative to ``model.center_of_mass`` of A.
            body_b: index of a dynamic body.
            anchor_a: (2,) [m], in the frame of body A.
            anchor_b: (2,) [m], in the frame of body B.
            max_force: largest force >= 0 [N], along each of the world's axes.
            frequency: natural frequency > 0 [Hz] of the spring.
            damping_ratio: damping ratio >= 0 [1] of the spring.
            **options: see ``JointOptions``.
        """
        where = f"joint {self._joints.count}"
        a, b = self._ends(body_a, body_b, where)
        anchors = pair("anchor_a", anchor_a, where), pair("anchor_b", anchor_b, where)
        options.setdefault("collide_connected", True)
        more: dict[str, Any] = {"strength": number("max_force", max_force, where)}
        more["frequency"] = number("spring_frequency", frequency, where)
        more["damping_ratio"] = number("damping_ratio", damping_ratio, where)
        return self._add_joint(JointKind.TARGET, (a, b), anchors, where, options, **more)

    def add_gear_joint(
        self, body_a: int, body_b: int, ratio: float, *, phase: float | None = None, **options: Unpack[JointOptions]
    ) -> int:
        """Keep the angle of body B at ``ratio`` times that of A, plus a phase.

        Args:
            body_a: index of a body of the latest world.
            body_b: index of another body; at least one of the two must be dynamic.
            ratio: rotations of B for each rotation of A [1]; negative for two wheels that roll on each other.
            phase: angle of B minus ``ratio`` times that of A [rad]; None: the present one.
            **options: see ``JointOptions``.
        """
        where = f"joint {self._joints.count}"
        a, b = self._ends(body_a, body_b, where)
        ratio = number("ratio", ratio, where)
        if phase is None:
            phase = self._bodies.row(b)[_ANGLE] - ratio * self._bodies.row(a)[_ANGLE]
        more: dict[str, Any] = {"ratio": ratio, "reference": number("phase", phase, where)}
        return self._add_joint(JointKind.GEAR, (a, b), ((0.0, 0.0), (0.0, 0.0)), where, options, **more)

    def add_general_joint(
        self,
        body_a: int,
        body_b: int,
        jacobian_a: Any,
        jacobian_b: Any,
        *,
        speed: float = 0.0,
        lower: float | None = None,
        upper: float | None = None,
        **options: Unpack[JointOptions],
    ) -> int:
        """Add your own constraint row: J_A V_A + J_B V_B = speed for V = (x, y, spin), by a limited force.

        The Jacobians, the speed and the limits may be written between steps (``joints.assign``).

        Args:
            body_a: index of a body of the latest world.
            body_b: index of another body; at least one of the two must be dynamic.
            jacobian_a: J_A, (3,) [1, 1, m].
            jacobian_b: J_B, (3,) [1, 1, m].
            speed: target of the row [m/s].
            lower: smallest force along the Jacobians [N]; None: no limit.
            upper: largest force [N]; None: no limit.
            **options: see ``JointOptions``.
        """
        where = f"joint {self._joints.count}"
        a, b = self._ends(body_a, body_b, where)
        more: dict[str, Any] = {
            "jacobian_a": triple("jacobian_a", jacobian_a, where),
            "jacobian_b": triple("jacobian_b", jacobian_b, where),
            "speed": number("speed", speed, where),
        }
        more["lower"], more["upper"], _ = self._limits(lower, upper, where)
        return self._add_joint(JointKind.GENERAL, (a, b), ((0.0, 0.0), (0.0, 0.0)), where, options, **more)

    def _ends(self, body_a: Any, body_b: Any, where: str) -> tuple[int, int]:
        """Return the bodies of a joint, checked."""
        a, b = self._body("body_a", body_a, where), self._body("body_b", body_b, where)
        if a == b:
            raise ValueError(f"body_a and body_b of {where} are both {a}; they must differ")
        if BodyType.DYNAMIC not in (self._bodies.row(a)[_TYPE], self._bodies.row(b)[_TYPE]):
            raise ValueError(f"body_a and body_b of {where} are {a} and {b}; one of them must be DYNAMIC")
        return a, b

    def _placed(self, body_a: Any, body_b: Any, anchor_a: Any, anchor_b: Any, where: str) -> Any:
        """Return the bodies and anchors of a joint; anchor B is at the position of anchor A if it is not given."""
        a, b = self._ends(body_a, body_b, where)
        at_a = pair("anchor_a", anchor_a, where)
        if anchor_b is not None:
            return a, b, (at_a, pair("anchor_b", anchor_b, where))
        (x, y), row = self._point(a, at_a), self._bodies.row(b)
        c, s = math.cos(row[_ANGLE]), math.sin(row[_ANGLE])
        x, y = x - row[_X], y - row[_Y]
        return a, b, (at_a, (c * x + s * y, c * y - s * x))

    def _point(self, body: int, anchor: tuple[float, float]) -> tuple[float, float]:
        """Return the present position of an anchor in the world [m]."""
        row, (x, y) = self._bodies.row(body), anchor
        c, s = math.cos(row[_ANGLE]), math.sin(row[_ANGLE])
        return row[_X] + c * x - s * y, row[_Y] + s * x + c * y

    def _distance(self, bodies: tuple[int, int], anchors: tuple[tuple[float, float], tuple[float, float]]) -> float:
        """Return the present distance of the anchors [m]."""
        return math.dist(self._point(bodies[0], anchors[0]), self._point(bodies[1], anchors[1]))

    def _reference(self, a: int, b: int, angle: float | None, where: str) -> float:
        """Return the angle of B minus that of A at which the joint's angle is 0 [rad]."""
        if angle is None:
            return float(self._bodies.row(b)[_ANGLE] - self._bodies.row(a)[_ANGLE])
        return number("reference_angle", angle, where)

    def _limits(
        self, lower: float | None, upper: float | None, where: str, least: float = -UNBOUNDED
    ) -> tuple[float, float, bool]:
        """Return both limits, ``least`` and unbounded if not given, and whether any is given."""
        low = least if lower is None else number("lower", lower, where)
        high = UNBOUNDED if upper is None else number("upper", upper, where)
        if low < least:
            raise ValueError(f"lower of {where} is {low:g}; it must be at least {least:g}")
        if low > high:
            raise ValueError(f"lower of {where} is {low:g}; it must be at most upper, {high:g}")
        return low, high, lower is not None or upper is not None

    def _driven(
        self, lower: float | None, upper: float | None, speed: float, strength: float | None, name: str, where: str
    ) -> tuple[JointPart, dict[str, Any]]:
        """Return the parts and the numbers of limits and motor."""
        low, high, limited = self._limits(lower, upper, where)
        more = {"lower": low, "upper": high, "speed": number("motor_speed", speed, where)}
        parts = JointPart.LIMIT if limited else JointPart.NONE
        if strength is None and more["speed"] != 0.0:
            raise ValueError(f"{name} of {where} is missing; a motor needs one")
        if strength is not None:
            parts |= JointPart.MOTOR
            more["strength"] = number(name, strength, where)
        return parts, more

    def _add_joint(
        self,
        kind: JointKind,
        bodies: tuple[int, int],
        anchors: Any,
        where: str,
        options: JointOptions,
        parts: int = JointPart.HOLD,
        **more: Any,
    ) -> int:
        """Append a joint to the table; fields of ``more`` are named without their prefix."""
        refuse_keyword(where, options, (*JointOptions.__annotations__,), MEANT)
        collides = truth(f"collide_connected of {where}", options.get("collide_connected", False))
        given = options.get("break_force")
        strength = UNBOUNDED if given is None else number("break_force", given, where)
        values = {"body_a": bodies[0], "body_b": bodies[1], "anchor_a": anchors[0], "anchor_b": anchors[1]}
        values |= {"kind": int(kind), "parts": int(parts), "axis": (1.0, 0.0), "break_force": strength}
        values |= {"collides": int(collides), **more}
        row = [0.0] * WIDTH
        for name, value in values.items():
            at = COLUMNS[f"joint_{name}"]
            row[at] = value if isinstance(value, tuple) else (value,)
        return self._joints.append(*row)
