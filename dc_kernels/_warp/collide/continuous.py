"""Pairs of shapes that are followed along their way: contacts of what misses, and how far what hits may go."""

from functools import cache
from types import SimpleNamespace
from typing import Any

import warp as wp

from dc_kernels._warp.collide.manifold import manifold_functions
from dc_kernels._warp.collide.switches import off_functions
from dc_kernels._warp.common import cross, kernel_module, rotate, rotate_back
from dc_kernels._warp.groups import contiguous_groups, group_types
from dc_kernels._warp.native import native_code
from dc_kernels._warp.solve.laws import relative_speed
from dc_kernels.collide.continuous import ADVANCES, ALLOWED, DEEP, HALF, NEAR, ROUNDS, SLOPS
from dc_kernels.model.enums import BodyType, ShapeType
from dc_kernels.model.fields import KEY_FEATURE_BITS, KEY_SHAPE_BITS

DISC = wp.constant(int(ShapeType.DISC))
SEGMENT = wp.constant(int(ShapeType.SEGMENT))
DYNAMIC = wp.constant(int(BodyType.DYNAMIC))
KINEMATIC = wp.constant(int(BodyType.KINEMATIC))
SHIFT_A = wp.constant(wp.int64(KEY_SHAPE_BITS + KEY_FEATURE_BITS))
SHIFT_B = wp.constant(wp.int64(KEY_FEATURE_BITS))
SHAPE = wp.constant(wp.int64(2**KEY_SHAPE_BITS - 1))
N_ADVANCES = wp.constant(ADVANCES)
N_ROUNDS = wp.constant(ROUNDS)


@cache
def course_functions(dtype: str) -> SimpleNamespace:
    """``Course``, how two shapes move in a step; ``gap_at`` a time of it; ``meeting``, the time at which they meet."""
    t = group_types(dtype)
    real, vec2, vec3, vec4 = t.real, t.vec2, wp.types.vector(3, t.real), t.vec4
    module = kernel_module("continuous", dtype)
    shapes = manifold_functions(dtype, False)
    Manifold, hull_of, frame_of = shapes.Manifold, shapes.hull_of, shapes.frame_of
    disc_disc, hull_disc, hull_hull = shapes.disc_disc, shapes.hull_disc, shapes.hull_hull

    class CourseFields:
        """Two shapes; what their bodies move and turn by in the step, and the share of it after which they stand still.

        ``slack`` [m]: see ``hull_hull``.
        """

        a: wp.int32
        b: wp.int32
        way_a: vec4
        way_b: vec4
        slack: real

    Course = wp.struct(CourseFields, module=module)

    @wp.func(module=module)
    def linear(way: vec4):
        """What a body moves by, without the turn."""
        return vec2(way[0], way[1])

    @wp.func(module=module)
    def size_of(shape: int, model: t.Model):
        """The farthest point of a shape from the centre of its body [m]."""
        return wp.length(model.shape_center[shape]) + model.shape_extent[shape]

    @wp.func(module=module)
    def inner_radius(shape: int, model: t.Model):
        """How far the middle of a shape is from its border [m]."""
        radius = model.shape_radius[shape]
        if model.shape_type[shape] == DISC or model.shape_type[shape] == SEGMENT:
            return radius
        first = model.vertex_start[shape]
        last = model.vertex_start[shape + 1]
        middle = vec2(real(0.0), real(0.0))
        for i in range(first, last):
            middle += model.vertices[i]
        middle = middle / real(last - first)
        least = real(1e30)
        for i in range(first, last):
            least = wp.min(least, wp.dot(model.vertex_normals[i], model.vertices[i] - middle))
        return radius + least

    @wp.func(module=module)
    def core_of(shape: int, model: t.Model):
        """The hull of a shape; of a segment without its neighbours, as distances don't depend on them."""
        hull = hull_of(shape, model.shape_type[shape], model.shape_radius[shape], model.vertex_start)
        hull.segment = False
        return hull

    @wp.func(module=module)
    def gap_at(course: Course, time: real, model: t.Model, state: t.State):
        """Direction from A to B and least gap along it at a time, up to 1, of the step."""
        a = course.a
        b = course.b
        body_a = model.shape_body[a]
        body_b = model.shape_body[b]
        share_a = wp.min(time, course.way_a[3])
        share_b = wp.min(time, course.way_b[3])
        x = state.position[body_b] - state.position[body_a]
        x += linear(course.way_b) * share_b - linear(course.way_a) * share_a
        angle_a = state.angle[body_a] + course.way_a[2] * share_a
        angle_b = state.angle[body_b] + course.way_b[2] * share_b
        ca = wp.cos(angle_a)
        sa = wp.sin(angle_a)
        cb = wp.cos(angle_b)
        sb = wp.sin(angle_b)
        center_a = rotate(ca, sa, model.shape_center[a])
        center_b = rotate(cb, sb, model.shape_center[b])
        round_a = model.shape_type[a] == DISC
        round_b = model.shape_type[b] == DISC
        ra = model.shape_radius[a]
        rb = model.shape_radius[b]
        m = Manifold()
        normal = vec2(real(0.0), real(0.0))
        if round_a and round_b:
            m = disc_disc(center_a, ra, x + center_b, rb)
            normal = m.normal
        elif round_a:
            m = hull_disc(
                core_of(b, model), rotate_back(cb, sb, center_a - x), ra, model.vertices, model.vertex_normals
            )
            normal = -rotate(cb, sb, m.normal)
        elif round_b:
            m = hull_disc(
                core_of(a, model), rotate_back(ca, sa, x + center_b), rb, model.vertices, model.vertex_normals
            )
            normal = rotate(ca, sa, m.normal)
        else:
            frame = frame_of(ca * cb + sa * sb, ca * sb - sa * cb, rotate_back(ca, sa, x))
            m = hull_hull(
                core_of(a, model),
                core_of(b, model),
                frame,
                real(1e30),
                course.slack,
                real(0.0),
                model.vertices,
                model.vertex_normals,
            )
            normal = rotate(ca, sa, m.normal)
        gap = m.gap0
        if m.count == 2:
            gap = wp.min(gap, m.gap1)
        return vec3(normal[0], normal[1], gap)

    @wp.func(module=module)
    def meeting(course: Course, allowed: real, near: real, model: t.Model, state: t.State):
        """When two shapes are ``near`` to an overlap that is ``allowed``; 1 or more if never in the step."""
        size_a = size_of(course.a, model)
        size_b = size_of(course.b, model)
        time = real(0.0)
        advances = int(0)
        while time < real(1.0) and advances < N_ADVANCES:
            advances += 1
            at = gap_at(course, time, model, state)
            room = at[2] + allowed
            if room <= near:
                return time
            speed = real(0.0)
            until = real(1.0)
            if time < course.way_a[3]:
                speed += at[0] * course.way_a[0] + at[1] * course.way_a[1] + wp.abs(course.way_a[2]) * size_a
                until = wp.min(until, course.way_a[3])
            if time < course.way_b[3]:
                speed += wp.abs(course.way_b[2]) * size_b - at[0] * course.way_b[0] - at[1] * course.way_b[1]
                until = wp.min(until, course.way_b[3])
            if room > speed * (until - time):
                time = until
            else:
                time += room / speed
        return time

    return SimpleNamespace(
        Course=Course, linear=linear, size_of=size_of, inner_radius=inner_radius, gap_at=gap_at, meeting=meeting
    )


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """``drop_missed`` and ``stop_short``; one thread a world."""
    t = group_types(dtype)
    real, vec4 = t.real, t.vec4
    module = kernel_module("continuous", dtype)
    contiguous = contiguous_groups(dtype)
    courses = course_functions(dtype)
    Course, size_of, inner_radius = courses.Course, courses.size_of, courses.inner_radius
    off = off_functions(dtype)
    any_off, is_off = off.any_off, off.is_off
    linear, gap_at, meeting = courses.linear, courses.gap_at, courses.meeting

    @wp.func_native(native_code("sleep/move_contact.h", dtype=dtype, ROLLS=False))
    def move_contact(source: t.Contacts, i: wp.int32, target: t.Contacts, k: wp.int32): ...

    @wp.kernel(module=module, enable_backward=False)
    def drop_missed(
        launch: t.Launch, config: t.Config, model: t.Model, state: t.State, motion: t.Motion, contacts: t.Contacts
    ):
        """Contacts of a world without those that would act across a gap which the step's motion does not close."""
        w = wp.tid() + launch.world_offset
        contiguous(model)
        contiguous(state)
        contiguous(motion)
        contiguous(contacts)
        if state.flags[w] != 0:
            return
        dt = motion.step_dt[w]
        slop = config.slop * model.length_scale[w]
        shape0 = model.shape_start[w]
        start = contacts.contact_start[w]
        end = start + contacts.contact_count[w]
        last = start
        asked = wp.int64(-1)  # the pair that is known to miss or not
        missed = bool(False)
        for c in range(start, end):
            a = contacts.body_a[c]
            b = contacts.body_b[c]
            va = motion.predicted[a]
            vb = motion.predicted[b]
            n = contacts.normal[c]
            gap = contacts.gap[c]
            speed = relative_speed(n, va, vb, cross(contacts.arm_a[c], n), cross(contacts.arm_b[c], n))
            drop = bool(False)
            if gap > real(SLOPS) * slop and -speed * dt > gap:
                pair = contacts.key[c] >> SHIFT_B
                if pair != asked:
                    asked = pair
                    course = Course()
                    course.a = shape0 + int(pair >> (SHIFT_A - SHIFT_B))
                    course.b = shape0 + int(pair & SHAPE)
                    course.way_a = vec4(va[0] * dt, va[1] * dt, va[2] * dt, real(1.0))
                    course.way_b = vec4(vb[0] * dt, vb[1] * dt, vb[2] * dt, real(1.0))
                    course.slack = config.slack * model.length_scale[w]
                    missed = meeting(course, real(0.0), real(NEAR) * slop, model, state) >= real(1.0)
                drop = missed
            if not drop:
                if last < c:
                    move_contact(contacts, c, contacts, last)
                last += 1
        contacts.contact_count[w] = last - start

    @wp.func(module=module)
    def may_meet(a: int, b: int, model: t.Model, joints: t.Joints, rows: t.Rows):
        """Whether two shapes hold each other, from wherever they come: what is one-way passes as it is held or not."""
        body_a = model.shape_body[a]
        body_b = model.shape_body[b]
        if body_a == body_b or (model.body_type[body_a] != DYNAMIC and model.body_type[body_b] != DYNAMIC):
            return False
        if model.shape_type[a] == SEGMENT and model.shape_type[b] == SEGMENT:
            return False
        if (model.shape_category[a] & model.shape_mask[b]) == 0 or (model.shape_category[b] & model.shape_mask[a]) == 0:
            return False
        if model.shape_role.shape[0] > 0:
            if model.shape_role[a] != 0 or model.shape_role[b] != 0:
                return False
        if rows.apart_start.shape[0] > 1:
            for i in range(rows.apart_start[body_a], rows.apart_start[body_a + 1]):
                if rows.apart_body[i] == body_b and joints.joint_broken[rows.apart_joint[i]] == 0:
                    return False
        return True

    @wp.func(module=module)
    def stop(body: int, time: real, model: t.Model, motion: t.Motion):
        """Let a dynamic body go no farther than to a time of the step, from the next round on."""
        v = motion.solved[body]
        if model.body_type[body] == DYNAMIC and time < v[3]:
            motion.solved[body] = vec4(v[0], v[1], v[2], time)

    @wp.func(module=module)
    def stop_pair(
        one: int,
        other: int,
        round: int,
        scale: real,
        config: t.Config,
        model: t.Model,
        state: t.State,
        joints: t.Joints,
        motion: t.Motion,
        rows: t.Rows,
    ):
        """Stop the bodies of two shapes where they would get too deep into each other.

        What cannot be stopped is looked at in the first round alone, as it moves on into what was.

        Args:
            round: number of the round.
            scale: length scale of the world [m].
        """
        a = wp.min(one, other)
        b = wp.max(one, other)
        body_a = model.shape_body[a]
        body_b = model.shape_body[b]
        if round > 0 and (model.body_type[body_a] == KINEMATIC or model.body_type[body_b] == KINEMATIC):
            return
        deep = real(DEEP) * config.slop * scale
        course = Course()
        course.a = a
        course.b = b
        course.slack = config.slack * scale
        course.way_a = motion.displacement[body_a]
        course.way_b = motion.displacement[body_b]
        by_a = linear(course.way_a)
        by_b = linear(course.way_b)
        size_a = size_of(a, model)
        size_b = size_of(b, model)
        way = wp.length(by_b - by_a) + wp.abs(course.way_a[2]) * size_a + wp.abs(course.way_b[2]) * size_b
        ahead = course.way_a[3] - course.way_b[3]  # what one moves on by, while the other stands still
        way += wp.where(ahead > real(0.0), ahead * wp.length(by_a), -ahead * wp.length(by_b))
        if way <= real(HALF) * deep:
            return
        far = way + size_a + size_b
        if wp.length_sq(state.position[body_b] - state.position[body_a]) > far * far:
            return
        if not may_meet(a, b, model, joints, rows):
            return
        allowed = wp.max(deep, real(ALLOWED) * wp.min(inner_radius(a, model), inner_radius(b, model)))
        if way <= real(HALF) * allowed:
            return
        # what is deep already, as by an impact, may move on by half as much in any way, and is not held for good
        at = gap_at(course, real(0.0), model, state)
        allowed = wp.max(allowed, real(HALF) * allowed - at[2])
        time = meeting(course, allowed, real(NEAR) * config.slop * scale, model, state)
        stop(body_a, time, model, motion)
        stop(body_b, time, model, motion)

    @wp.func(module=module)
    def leaves(shape: int, dt: real, model: t.Model, motion: t.Motion, pairs: t.Pairs):
        """Whether a shape that goes another way than predicted may leave the box that its pairs were found by."""
        body = model.shape_body[shape]
        way = motion.displacement[body]
        v = motion.predicted[body]
        turned = wp.abs(way[2] - v[2] * dt) * size_of(shape, model)
        x = wp.abs(way[0] - v[0] * dt) + turned
        y = wp.abs(way[1] - v[1] * dt) + turned
        swept = pairs.swept[shape]
        box = pairs.box[shape]
        within = swept[0] - x >= box[0] and swept[1] - y >= box[1] and swept[2] + x <= box[2] and swept[3] + y <= box[3]
        return not within

    @wp.func(module=module)
    def stop_joined(w: int, model: t.Model, joints: t.Joints, motion: t.Motion):
        """Stop what joints hold to what is stopped."""
        found = int(1)
        while found > 0:
            found *= 0
            for joint in range(model.joint_start[w], model.joint_start[w + 1]):
                a = joints.joint_body_a[joint]
                b = joints.joint_body_b[joint]
                if joints.joint_broken[joint] == 0 and model.body_type[a] == DYNAMIC and model.body_type[b] == DYNAMIC:
                    of_a = motion.solved[a][3]
                    of_b = motion.solved[b][3]
                    stop(a, of_b, model, motion)
                    stop(b, of_a, model, motion)
                    if of_a != of_b:
                        found += 1

    @wp.func(module=module)
    def stopped(w: int, model: t.Model, motion: t.Motion):
        """Let what a round has stopped stand still in the next; how many bodies it was."""
        found = int(0)
        for b in range(model.body_start[w], model.body_start[w + 1]):
            way = motion.displacement[b]
            share = motion.solved[b][3]
            if share < way[3]:
                motion.displacement[b] = vec4(way[0], way[1], way[2], share)
                found += 1
        return found

    @wp.kernel(module=module, enable_backward=False)
    def stop_short(
        launch: t.Launch,
        config: t.Config,
        model: t.Model,
        state: t.State,
        joints: t.Joints,
        motion: t.Motion,
        contacts: t.Contacts,
        pairs: t.Pairs,
        rows: t.Rows,
    ):
        """Shorten the motion of bodies of a world that would get too deep into others in this step."""
        w = wp.tid() + launch.world_offset
        contiguous(model)
        contiguous(state)
        contiguous(joints)
        contiguous(motion)
        contiguous(contacts)
        contiguous(pairs)
        contiguous(rows)
        if state.flags[w] != 0:
            return
        scale = model.length_scale[w]
        first = model.shape_start[w]
        last = model.shape_start[w + 1]
        farthest = real(0.0)
        check = real(0.0)  # x - x is 0 for a finite x, NaN for inf and NaN
        for shape in range(first, last):
            way = motion.displacement[model.shape_body[shape]]
            covered = wp.length(linear(way)) + wp.abs(way[2]) * size_of(shape, model)
            farthest = wp.max(farthest, covered)
            check += covered - covered
        if check != real(0.0) or real(2.0) * farthest <= real(HALF * DEEP) * config.slop * scale:
            return
        some_off = any_off(w, contacts)
        # the share of its way after which each body stands still: now, and from the next round on
        for b in range(model.body_start[w], model.body_start[w + 1]):
            way = motion.displacement[b]
            v = motion.solved[b]
            motion.displacement[b] = vec4(way[0], way[1], way[2], real(1.0))
            motion.solved[b] = vec4(v[0], v[1], v[2], real(1.0))
        found = int(1)
        rounds = int(0)
        while found > 0 and rounds < N_ROUNDS:
            # by what all bodies do before the round, so that nothing depends on the order of the pairs
            for pair in range(pairs.start[w], pairs.start[w] + pairs.near_count[w]):
                a = pairs.near_a[pair]
                b = pairs.near_b[pair]
                if not some_off or not is_off(a, b, w, model, contacts):
                    stop_pair(a, b, rounds, scale, config, model, state, joints, motion, rows)
            for shape in range(first, last):
                if leaves(shape, motion.step_dt[w], model, motion, pairs):
                    for other in range(first, last):
                        if not some_off or not is_off(shape, other, w, model, contacts):
                            stop_pair(shape, other, rounds, scale, config, model, state, joints, motion, rows)
            stop_joined(w, model, joints, motion)
            found = stopped(w, model, motion)
            rounds += 1
        for b in range(model.body_start[w], model.body_start[w + 1]):
            way = motion.displacement[b]
            v = motion.solved[b]
            share = way[3]
            mass = motion.predicted[b][3]
            motion.displacement[b] = vec4(way[0] * share, way[1] * share, way[2] * share, mass)
            motion.solved[b] = vec4(v[0], v[1], v[2], mass)

    return {"drop_missed": drop_missed, "stop_short": stop_short}
