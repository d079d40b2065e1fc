"""Rows of the joints of a world, by their kinds, and which of them break."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.groups import contiguous_groups, group_types
from dc_kernels._warp.solve.constraints.ends import end_functions
from dc_kernels._warp.solve.constraints.gear import gear_rows
from dc_kernels._warp.solve.constraints.general import general_rows
from dc_kernels._warp.solve.constraints.prismatic import prismatic_rows
from dc_kernels._warp.solve.constraints.revolute import revolute_rows
from dc_kernels._warp.solve.constraints.stretch import stretch_rows
from dc_kernels._warp.solve.constraints.target import target_rows
from dc_kernels._warp.solve.constraints.weld import weld_rows
from dc_kernels._warp.solve.constraints.wheel import wheel_rows
from dc_kernels.model.config import METHODS
from dc_kernels.model.enums import Flag, JointKind, JointPart
from dc_kernels.solve.joints import BRAKED, SMALL_TURN, STIFFNESS

DISTANCE = wp.constant(int(JointKind.DISTANCE))
REVOLUTE = wp.constant(int(JointKind.REVOLUTE))
PRISMATIC = wp.constant(int(JointKind.PRISMATIC))
WELD = wp.constant(int(JointKind.WELD))
WHEEL = wp.constant(int(JointKind.WHEEL))
TARGET = wp.constant(int(JointKind.TARGET))
GEAR = wp.constant(int(JointKind.GEAR))
GENERAL = wp.constant(int(JointKind.GENERAL))
DRIVES = wp.constant(int(JointPart.MOTOR))
ENDS = wp.constant(int(JointPart.LIMIT))
NONFINITE = wp.constant(int(Flag.NONFINITE))
BROKEN = wp.constant(1)
SUBSTEPS = wp.constant(METHODS["tgs_soft"])


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """``make_joint_rows`` and ``break_joints``; one thread a world."""
    t = group_types(dtype)
    real = t.real
    module = kernel_module("joints", dtype)
    contiguous = contiguous_groups(dtype)
    STIFF, small_square, heavy = real(STIFFNESS), real(SMALL_TURN * SMALL_TURN), real(BRAKED)
    ends = end_functions(dtype)
    ends_of, idle, rest = ends.ends_of, ends.idle, ends.rest
    make_stretch_rows = stretch_rows(dtype)
    make_revolute_rows = revolute_rows(dtype)
    make_prismatic_rows = prismatic_rows(dtype)
    make_weld_rows = weld_rows(dtype)
    make_wheel_rows = wheel_rows(dtype)
    make_target_rows = target_rows(dtype)
    make_gear_rows = gear_rows(dtype)
    make_general_rows = general_rows(dtype)

    @wp.func(module=module)
    def lost(x: real):
        """0 of a finite number, NaN of inf and NaN."""
        return x - x

    @wp.func(module=module)
    def unsound(j: int, kind: int, joints: t.Joints):
        """0 where the numbers of joint j are finite that no velocity follows from, as bounds are not passed; or NaN."""
        check = lost(joints.joint_length[j]) + lost(joints.joint_reference[j])
        check += lost(joints.joint_ratio[j]) + lost(joints.joint_damping_ratio[j])
        parts = joints.joint_parts[j]
        if (parts & DRIVES) != 0 or kind == TARGET or kind == GENERAL:
            check += lost(joints.joint_speed[j]) + lost(joints.joint_strength[j])
        if (parts & ENDS) != 0 or kind == GENERAL:
            check += lost(joints.joint_lower[j]) + lost(joints.joint_upper[j])
        return check

    @wp.func(module=module)
    def stiffen(j: int, e: ends.Ends, stiff: real, joints: t.Joints, rows: t.Rows):
        """What the forces of joint j turn its bodies back by, as they pull at their arms: dt^2 r . f, summed up."""
        x = real(0.0)
        y = real(0.0)
        for k in range(joints.joint_row_start[j], joints.joint_row_start[j + 1]):
            x += joints.joint_impulse[k] * rows.row_jacobian_b[k][0]
            y += joints.joint_impulse[k] * rows.row_jacobian_b[k][1]
        ra = e.d + e.ra
        along_a = -(ra[0] * x + ra[1] * y)
        along_b = e.rb[0] * x + e.rb[1] * y
        rows.stiff_inertia[e.a] += stiff * e.dt * wp.max(along_a, real(0.0))
        rows.stiff_inertia[e.b] += stiff * e.dt * wp.max(along_b, real(0.0))

    @wp.kernel(module=module, enable_backward=False)
    def make_joint_rows(
        launch: t.Launch,
        config: t.Config,
        model: t.Model,
        state: t.State,
        joints: t.Joints,
        motion: t.Motion,
        rows: t.Rows,
    ):
        """Rows of a world's joints; those of a joint that is broken, or whose bodies sleep, do nothing.

        A body that the joints pull at turns back as a pendulum does, with the stiffness r . f (Tournier et al. 2015).
        Where it would swing to and fro within a step, which explicit directions of the forces do not bear, all rows
        meet as much inertia as makes it swing in STIFF steps a radian (Andrews et al. 2017). That inertia comes and
        goes with the force, while the body keeps its spin, so the energy of what whirls to and fro would grow: of what
        is pulled at far more than it resists by itself, and turns by SMALL_TURN in a step, the spin is taken away.

        In the midst of a solve with substeps (``launch.resume``) rows are made anew, and nothing else. A world stops
        where a joint that does something has a number that is not finite.
        """
        w = wp.tid() + launch.world_offset
        contiguous(model)
        contiguous(state)
        contiguous(joints)
        contiguous(motion)
        contiguous(rows)
        if state.flags[w] != 0:
            return
        dt = motion.step_dt[w]
        stiff = STIFF
        if config.method == SUBSTEPS:  # each takes a share of the impulses
            dt = dt / real(config.substeps)
            stiff = STIFF / real(config.substeps)
        if launch.resume == 0:
            for body in range(model.body_start[w], model.body_start[w + 1]):
                rows.stiff_inertia[body] = real(0.0)
        check = real(0.0)
        for j in range(model.joint_start[w], model.joint_start[w + 1]):
            a = joints.joint_body_a[j]
            b = joints.joint_body_b[j]
            kind = joints.joint_kind[j]
            asleep = wp.min(motion.predicted[a][3], motion.predicted[b][3]) < real(0.0)
            e = ends_of(j, w, launch, config, model, state, motion, joints)
            if launch.resume == 0 and not asleep and joints.joint_broken[j] != BROKEN:
                check += unsound(j, kind, joints)
            if joints.joint_broken[j] == BROKEN:
                for k in range(joints.joint_row_start[j], joints.joint_row_start[j + 1]):
                    idle(k, e, rows)
            elif asleep:
                for k in range(joints.joint_row_start[j], joints.joint_row_start[j + 1]):
                    rest(k, e, rows)
            elif kind == DISTANCE:
                make_stretch_rows(j, e, config, model, motion, joints, rows)
            elif kind == REVOLUTE:
                make_revolute_rows(j, e, config, joints, rows)
            elif kind == PRISMATIC:
                make_prismatic_rows(j, e, config, joints, rows)
            elif kind == WELD:
                make_weld_rows(j, e, config, model, motion, joints, rows)
            elif kind == WHEEL:
                make_wheel_rows(j, e, config, model, motion, joints, rows)
            elif kind == TARGET:
                make_target_rows(j, e, model, motion, joints, rows)
            elif kind == GEAR:
                make_gear_rows(j, e, config, joints, rows)
            else:
                make_general_rows(j, e, joints, rows)
            if launch.resume == 0:
                stiffen(j, e, stiff, joints, rows)
        if check != real(0.0):
            state.flags[w] = NONFINITE
            return
        if launch.resume > 0:
            return
        for body in range(model.body_start[w], model.body_start[w + 1]):
            own = model.inertia[body]
            pulled = rows.stiff_inertia[body]
            rows.stiff_inertia[body] = wp.max(pulled - own, real(0.0))
            if own > real(0.0) and pulled > heavy * own:
                turn = dt * state.angular_velocity[body]
                share = turn * turn / small_square
                v = motion.predicted[body]
                v[2] -= wp.min(share * share, real(1.0)) * (real(1.0) - heavy * own / pulled) * v[2]
                motion.predicted[body] = v

    @wp.kernel(module=module, enable_backward=False)
    def break_joints(
        launch: t.Launch, model: t.Model, state: t.State, motion: t.Motion, rows: t.Rows, joints: t.Joints
    ):
        """A joint whose force on its bodies was above its break force in this step does nothing from the next on."""
        w = wp.tid() + launch.world_offset
        contiguous(model)
        contiguous(state)
        contiguous(motion)
        contiguous(rows)
        contiguous(joints)
        if state.flags[w] != 0:
            return
        for j in range(model.joint_start[w], model.joint_start[w + 1]):
            x = real(0.0)
            y = real(0.0)
            for k in range(joints.joint_row_start[j], joints.joint_row_start[j + 1]):
                x += joints.joint_impulse[k] * rows.row_jacobian_b[k][0]
                y += joints.joint_impulse[k] * rows.row_jacobian_b[k][1]
            if wp.sqrt(x * x + y * y) > joints.joint_break_force[j] * motion.step_dt[w]:
                joints.joint_broken[j] = BROKEN

    return {"make_joint_rows": make_joint_rows, "break_joints": break_joints}
