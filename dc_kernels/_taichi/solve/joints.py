"""Rows of the joints of a world, by their kinds, and which of them break."""

from functools import cache
from typing import Any

from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.runtime.kernels import kernel
from dc_kernels._taichi.solve.constraints.ends import end_functions
from dc_kernels._taichi.solve.constraints.gear import gear_rows
from dc_kernels._taichi.solve.constraints.general import general_rows
from dc_kernels._taichi.solve.constraints.prismatic import prismatic_rows
from dc_kernels._taichi.solve.constraints.revolute import revolute_rows
from dc_kernels._taichi.solve.constraints.stretch import stretch_rows
from dc_kernels._taichi.solve.constraints.target import target_rows
from dc_kernels._taichi.solve.constraints.weld import weld_rows
from dc_kernels._taichi.solve.constraints.wheel import wheel_rows
from dc_kernels.model.enums import Flag, JointKind, JointPart
from dc_kernels.solve.joints import BRAKED, SMALL_TURN, STIFFNESS

DISTANCE = int(JointKind.DISTANCE)
REVOLUTE = int(JointKind.REVOLUTE)
PRISMATIC = int(JointKind.PRISMATIC)
WELD = int(JointKind.WELD)
WHEEL = int(JointKind.WHEEL)
TARGET = int(JointKind.TARGET)
GEAR = int(JointKind.GEAR)
GENERAL = int(JointKind.GENERAL)
DRIVES = int(JointPart.MOTOR)
ENDS = int(JointPart.LIMIT)
NONFINITE = int(Flag.NONFINITE)
BROKEN = 1
SMALL_SQUARE = SMALL_TURN * SMALL_TURN


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """``make_joint_rows`` and ``break_joints``; one thread a world."""
    t = group_types(dtype)
    real = t.real
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

    @ti.func
    def lost(x):
        """0 of a finite number, NaN of inf and NaN."""
        return x - x

    @ti.func
    def unsound(j, kind, joints: t.Joints):
        """0 where the numbers of joint j are finite that no velocity follows from, as bounds are not passed; or NaN."""
        check = lost(joints.joint_length[j]) + lost(joints.joint_reference[j])
        check += lost(joints.joint_ratio[j]) + lost(joints.joint_damping_ratio[j])
        parts = joints.joint_parts[j]
        if (parts & DRIVES) != 0 or kind == TARGET or kind == GENERAL:
            check += lost(joints.joint_speed[j]) + lost(joints.joint_strength[j])
        if (parts & ENDS) != 0 or kind == GENERAL:
            check += lost(joints.joint_lower[j]) + lost(joints.joint_upper[j])
        return check

    @ti.func
    def force_of(j, joints: t.Joints, rows: t.Rows):
        """Impulses of joint j on its body B, summed up."""
        x = 0.0
        y = 0.0
        for k in range(joints.joint_row_start[j], joints.joint_row_start[j + 1]):
            x += joints.joint_impulse[k] * rows.row_jacobian_b[k, 0]
            y += joints.joint_impulse[k] * rows.row_jacobian_b[k, 1]
        return x, y

    @ti.func
    def stiffen(j, e, joints: t.Joints, rows: t.Rows):
        """What the forces of joint j turn its bodies back by, as they pull at their arms: dt^2 r . f, summed up."""
        x, y = force_of(j, joints, rows)
        ra = e.d + e.ra
        along_a = 0.0 - (ra[0] * x + ra[1] * y)
        along_b = e.rb[0] * x + e.rb[1] * y
        rows.stiff_inertia[e.a] = rows.stiff_inertia[e.a] + STIFFNESS * e.dt * ti.max(along_a, 0.0)
        rows.stiff_inertia[e.b] = rows.stiff_inertia[e.b] + STIFFNESS * e.dt * ti.max(along_b, 0.0)

    @kernel
    def make_joint_rows(
        tid,
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
        meet as much inertia as makes it swing in STIFF steps a radian (Andrews et al. 2017); what is pulled at far more
        than it resists by itself, and turns by SMALL_TURN in a step, is braked. A world stops where a joint that does
        something has a number that is not finite.
        """
        w = tid + launch.world_offset
        if state.flags[w] == 0:
            for body in range(model.body_start[w], model.body_start[w + 1]):
                rows.stiff_inertia[body] = 0.0
            check = real(0.0)
            for j in range(model.joint_start[w], model.joint_start[w + 1]):
                a = joints.joint_body_a[j]
                b = joints.joint_body_b[j]
                kind = joints.joint_kind[j]
                asleep = ti.min(motion.predicted[a][3], motion.predicted[b][3]) < 0.0
                e = ends_of(j, w, config, model, state, motion, joints)
                if not asleep and joints.joint_broken[j] != BROKEN:
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
                    make_prismatic_rows(j, e, config, state, joints, rows)
                elif kind == WELD:
                    make_weld_rows(j, e, config, model, motion, joints, rows)
                elif kind == WHEEL:
                    make_wheel_rows(j, e, config, model, state, motion, joints, rows)
                elif kind == TARGET:
                    make_target_rows(j, e, model, motion, joints, rows)
                elif kind == GEAR:
                    make_gear_rows(j, e, config, state, joints, rows)
                else:
                    make_general_rows(j, e, joints, rows)
                stiffen(j, e, joints, rows)
            if not (check == 0.0):
                state.flags[w] = NONFINITE
            for body in range(model.body_start[w], model.body_start[w + 1]):
                own = model.inertia[body]
                pulled = rows.stiff_inertia[body]
                rows.stiff_inertia[body] = ti.max(pulled - own, 0.0)
                if own > 0.0 and pulled > BRAKED * own:
                    turn = motion.step_dt[w] * state.angular_velocity[body]
                    share = turn * turn / SMALL_SQUARE
                    v = motion.predicted[body]
                    v[2] -= ti.min(share * share, 1.0) * (1.0 - BRAKED * own / pulled) * v[2]
                    motion.predicted[body] = v

    @kernel
    def break_joints(
        tid, launch: t.Launch, model: t.Model, state: t.State, motion: t.Motion, rows: t.Rows, joints: t.Joints
    ):
        """A joint whose force on its bodies was above its break force in this step does nothing from the next on."""
        w = tid + launch.world_offset
        if state.flags[w] == 0:
            for j in range(model.joint_start[w], model.joint_start[w + 1]):
                x, y = force_of(j, joints, rows)
                if ti.sqrt(x * x + y * y) > joints.joint_break_force[j] * motion.step_dt[w]:
                    joints.joint_broken[j] = BROKEN

    return {"make_joint_rows": make_joint_rows, "break_joints": break_joints}
