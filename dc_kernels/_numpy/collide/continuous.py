"""Pairs of shapes that are followed along their way: contacts of what misses, and how far what hits may go."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dc_kernels._numpy.collide.manifold import Hull, disc_disc, hull_disc, hull_hull, length
from dc_kernels._numpy.common import Array, Kernels, cross, dot, rotate, rotation
from dc_kernels.collide.continuous import ADVANCES, ALLOWED, DEEP, HALF, NEAR, ROUNDS, SLOPS
from dc_kernels.model.enums import BodyType, ShapeType
from dc_kernels.model.fields import CONTACTS, KEY_FEATURE_BITS, KEY_SHAPE_BITS

FIELDS = tuple(name for name, field in CONTACTS.items() if field.per == "contact")
"""Fields of a contact."""


@dataclass
class Course:
    """Two shapes; what their bodies move and turn by in the step, and the share of it after which they stand still."""

    model: Any
    state: Any
    a: int
    b: int
    way_a: Array  # (x, y, turn, share)
    way_b: Array
    slack: Any  # of ``hull_hull`` [m]
    epsilon: float

    def core_of(self, shape: int) -> Hull:
        """The hull of a shape; of a segment without its neighbours, as distances don't depend on them."""
        model = self.model
        first, last = model.vertex_start[shape], model.vertex_start[shape + 1]
        if model.shape_type[shape] == ShapeType.SEGMENT:
            last = first + 2
        return Hull(model.vertices[first:last], model.vertex_normals[first:last], model.shape_radius[shape])

    def gap_at(self, time: Any) -> tuple[Array, Any]:
        """Direction from A to B and least gap along it at a time, up to 1, of the step."""
        model, state, a, b = self.model, self.state, self.a, self.b
        body_a, body_b = model.shape_body[[a, b]]
        share_a, share_b = min(time, self.way_a[3]), min(time, self.way_b[3])
        x = state.position[body_b] - state.position[body_a] + (self.way_b[:2] * share_b - self.way_a[:2] * share_a)
        turn_a = rotation(state.angle[body_a] + self.way_a[2] * share_a)
        turn_b = rotation(state.angle[body_b] + self.way_b[2] * share_b)
        center_a, center_b = rotate(turn_a, model.shape_center[a]), rotate(turn_b, model.shape_center[b])
        round_a, round_b = (model.shape_type[[a, b]] == ShapeType.DISC).tolist()
        ra, rb = model.shape_radius[[a, b]]
        if round_a and round_b:
            m = disc_disc(center_a, ra, x + center_b, rb, self.epsilon)
        elif round_a:
            m = hull_disc(self.core_of(b), rotate(turn_b.T, center_a - x), ra, self.epsilon)
            m = m.placed(turn_b, x, flip=True)
        elif round_b:
            m = hull_disc(self.core_of(a), rotate(turn_a.T, x + center_b), rb, self.epsilon).placed(turn_a, x)
        else:
            hull_b = self.core_of(b).placed(turn_a.T @ turn_b, rotate(turn_a.T, x))
            zero = type(self.slack)(0.0)
            m = hull_hull(self.core_of(a), hull_b, np.inf, self.slack, zero, self.epsilon).placed(turn_a, x)
        return m.normal, m.least_gap

    def meeting(self, allowed: Any, near: Any) -> Any:
        """When two shapes are ``near`` to an overlap that is ``allowed``; 1 or more if never in the step."""
        size_a, size_b = size_of(self.model, self.a), size_of(self.model, self.b)
        time = 0.0
        for _ in range(ADVANCES):
            n, gap = self.gap_at(time)
            room = gap + allowed
            if room <= near:
                break
            speed, until = 0.0, 1.0
            if time < self.way_a[3]:
                speed += dot(n, self.way_a[:2]) + abs(self.way_a[2]) * size_a
                until = min(until, self.way_a[3])
            if time < self.way_b[3]:
                speed += abs(self.way_b[2]) * size_b - dot(n, self.way_b[:2])
                until = min(until, self.way_b[3])
            time = until if room > speed * (until - time) else time + room / speed
            if time >= 1.0:
                break
        return time


def kernels(dtype: str) -> Kernels:
    """``drop_missed`` and ``stop_short``.

    Args:
        dtype: "float32" or "float64": what counts as zero distance.
    """
    epsilon = 1e-9 if dtype == "float32" else 1e-15

    def drop_missed(tid: int, launch: Any, config: Any, model: Any, state: Any, motion: Any, contacts: Any) -> None:
        """Contacts of a world without those that would act across a gap which the step's motion does not close."""
        w = tid + launch.world_offset
        if state.flags[w]:
            return
        dt, scale, start = motion.step_dt[w], model.length_scale[w], contacts.contact_start[w]
        misses: dict[int, bool] = {}

        def is_missed(c: int) -> bool:
            va, vb = motion.predicted[contacts.body_a[c]], motion.predicted[contacts.body_b[c]]
            n, gap = contacts.normal[c], contacts.gap[c]
            speed = dot(n, vb - va) + cross(contacts.arm_b[c], n) * vb[2] - cross(contacts.arm_a[c], n) * va[2]
            if gap <= SLOPS * config.slop * scale or -speed * dt <= gap:
                return False
            pair = int(contacts.key[c]) >> KEY_FEATURE_BITS
            if pair not in misses:
                a, b = (int(model.shape_start[w]) + k for k in (pair >> KEY_SHAPE_BITS, pair % 2**KEY_SHAPE_BITS))
                ways = (np.array([*v[:3] * dt, 1.0], v.dtype) for v in (va, vb))
                course = Course(model, state, a, b, *ways, slack=config.slack * scale, epsilon=epsilon)
                misses[pair] = bool(course.meeting(0.0, NEAR * config.slop * scale) >= 1.0)
            return misses[pair]

        kept = [c for c in range(start, start + contacts.contact_count[w]) if not is_missed(c)]
        for name in FIELDS:
            array = getattr(contacts, name)
            array[start : start + len(kept)] = array[kept].copy()
        contacts.contact_count[w] = len(kept)

    def stop_short(
        tid: int,
        launch: Any,
        config: Any,
        model: Any,
        state: Any,
        joints: Any,
        motion: Any,
        contacts: Any,
        pairs: Any,
        rows: Any,
    ) -> None:
        """Shorten the motion of bodies of a world that would get too deep into others in this step."""
        w = tid + launch.world_offset
        if state.flags[w]:
            return
        scale, ways = model.length_scale[w], motion.displacement
        deep, near = DEEP * config.slop * scale, NEAR * config.slop * scale
        shapes = range(model.shape_start[w], model.shape_start[w + 1])
        bodies = slice(model.body_start[w], model.body_start[w + 1])
        of_shapes = ways[model.shape_body[shapes]]
        covered = np.hypot(*of_shapes[:, :2].T) + abs(of_shapes[:, 2]) * [size_of(model, shape) for shape in shapes]
        if not np.isfinite(covered).all() or 2.0 * covered.max(initial=0.0) <= HALF * deep:
            return

        def stop(body: int, time: Any) -> None:
            if model.body_type[body] == BodyType.DYNAMIC:
                shares[body] = min(shares[body], time)

        def stop_pair(one: int, other: int, first: bool) -> None:
            a, b = min(one, other), max(one, other)
            if (a, b) in off:
                return
            if not may_meet(a, b, model, joints, rows):
                return
            body_a, body_b = model.shape_body[[a, b]]
            if not first and BodyType.KINEMATIC in (model.body_type[body_a], model.body_type[body_b]):
                return
            way_a, way_b = ways[body_a].copy(), ways[body_b].copy()
            size_a, size_b = size_of(model, a), size_of(model, b)
            ahead = way_a[3] - way_b[3]
            way = length((way_b - way_a)[:2]) + abs(way_a[2]) * size_a + abs(way_b[2]) * size_b
            way += ahead * length(way_a[:2]) if ahead > 0 else -ahead * length(way_b[:2])
            if way <= HALF * deep or length(state.position[body_b] - state.position[body_a]) > way + size_a + size_b:
                return
            allowed = max(deep, ALLOWED * min(inner_radius(model, a), inner_radius(model, b)))
            if way <= HALF * allowed:
                return
            course = Course(model, state, a, b, way_a, way_b, config.slack * scale, epsilon)
            time = course.meeting(max(allowed, HALF * allowed - course.gap_at(0.0)[1]), near)
            stop(body_a, time)
            stop(body_b, time)

        def leaves(shape: int) -> bool:
            body, swept, box = model.shape_body[shape], pairs.swept[shape], pairs.box[shape]
            other = abs(ways[body, :3] - motion.predicted[body, :3] * motion.step_dt[w])
            more = other[:2] + other[2] * size_of(model, shape)
            return not ((swept[:2] - more >= box[:2]).all() and (swept[2:] + more <= box[2:]).all())

        def stop_joined() -> None:
            again = True
            while again:
                again = False
                for joint in range(model.joint_start[w], model.joint_start[w + 1]):
                    both = [joints.joint_body_a[joint], joints.joint_body_b[joint]]
                    if not joints.joint_broken[joint] and (model.body_type[both] == BodyType.DYNAMIC).all():
                        again = again or shares[both[0]] != shares[both[1]]
                        shares[both] = shares[both].min()

        off = pairs_off(w, model, contacts)
        # the share of its way after which each body stands still: now, and from the next round on
        ways[bodies, 3] = 1.0
        shares = ways[:, 3].copy()
        found_by_boxes = range(pairs.start[w], pairs.start[w] + pairs.near_count[w])
        for round in range(ROUNDS):
            for pair in found_by_boxes:
                stop_pair(int(pairs.near_a[pair]), int(pairs.near_b[pair]), round == 0)
            for shape in shapes:
                if leaves(shape):
                    for other in shapes:
                        stop_pair(shape, other, round == 0)
            stop_joined()
            if (shares[bodies] == ways[bodies, 3]).all():
                break
            ways[bodies, 3] = shares[bodies]
        ways[bodies, :3] *= ways[bodies, 3:]
        ways[bodies, 3] = motion.predicted[bodies, 3]

    return {"drop_missed": drop_missed, "stop_short": stop_short}


def pairs_off(w: int, model: Any, contacts: Any) -> set[tuple[int, int]]:
    """Shapes, the lower one first, that have contacts of which none acts in this step."""
    own = slice(contacts.contact_start[w], contacts.contact_start[w] + contacts.contact_count[w])
    pair, acts = contacts.key[own] >> KEY_FEATURE_BITS, contacts.color[own] >= 0
    off = set(pair[~acts].tolist()) - set(pair[acts].tolist())
    shape0 = int(model.shape_start[w])
    sides = ((shape0 + (one >> KEY_SHAPE_BITS), shape0 + one % 2**KEY_SHAPE_BITS) for one in off)
    return {(min(two), max(two)) for two in sides}


def size_of(model: Any, shape: int) -> Any:
    """The farthest point of a shape from the centre of its body [m]."""
    return length(model.shape_center[shape]) + model.shape_extent[shape]


def inner_radius(model: Any, shape: int) -> Any:
    """How far the middle of a shape is from its border [m]."""
    if model.shape_type[shape] != ShapeType.POLYGON:
        return model.shape_radius[shape]
    corners = slice(model.vertex_start[shape], model.vertex_start[shape + 1])
    vertices = model.vertices[corners]
    return model.shape_radius[shape] + dot(model.vertex_normals[corners], vertices - vertices.mean(axis=0)).min()


def may_meet(a: int, b: int, model: Any, joints: Any, rows: Any) -> bool:
    """Whether two shapes hold each other, from wherever they come: what is one-way passes as it is held or not."""
    body_a, body_b = model.shape_body[[a, b]]
    if body_a == body_b or BodyType.DYNAMIC not in (model.body_type[body_a], model.body_type[body_b]):
        return False
    if (model.shape_type[[a, b]] == ShapeType.SEGMENT).all():
        return False
    if not (model.shape_category[a] & model.shape_mask[b] and model.shape_category[b] & model.shape_mask[a]):
        return False
    if len(model.shape_role) and model.shape_role[[a, b]].any():
        return False
    if len(rows.apart_start) > 1:
        own = slice(rows.apart_start[body_a], rows.apart_start[body_a + 1])
        return bool(joints.joint_broken[rows.apart_joint[own][rows.apart_body[own] == body_b]].all())
    return True
