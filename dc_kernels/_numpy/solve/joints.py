"""Rows of the joints of a world, by their kinds, and which of them break."""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels._numpy.common import Kernels
from dc_kernels._numpy.solve.constraints.ends import SUBSTEPS, Ends
from dc_kernels._numpy.solve.constraints.gear import make_gear_rows
from dc_kernels._numpy.solve.constraints.general import make_general_rows
from dc_kernels._numpy.solve.constraints.prismatic import make_prismatic_rows
from dc_kernels._numpy.solve.constraints.revolute import make_revolute_rows
from dc_kernels._numpy.solve.constraints.stretch import make_stretch_rows
from dc_kernels._numpy.solve.constraints.target import make_target_rows
from dc_kernels._numpy.solve.constraints.weld import make_weld_rows
from dc_kernels._numpy.solve.constraints.wheel import make_wheel_rows
from dc_kernels.model.enums import Flag, JointKind, JointPart
from dc_kernels.solve.joints import BRAKED, SMALL_TURN, STIFFNESS

MAKERS = {
    JointKind.DISTANCE: make_stretch_rows,
    JointKind.REVOLUTE: make_revolute_rows,
    JointKind.PRISMATIC: make_prismatic_rows,
    JointKind.WELD: make_weld_rows,
    JointKind.WHEEL: make_wheel_rows,
    JointKind.TARGET: make_target_rows,
    JointKind.GEAR: make_gear_rows,
    JointKind.GENERAL: make_general_rows,
}


def numbers_of(j: int, joints: Any) -> list[Any]:
    """The numbers of a joint that no velocity need follow from: bounds that are NaN are not passed."""
    kind, parts = joints.joint_kind[j], joints.joint_parts[j]
    names = ["length", "reference", "ratio", "damping_ratio"]
    if parts & JointPart.MOTOR or kind in (JointKind.TARGET, JointKind.GENERAL):
        names += ["speed", "strength"]
    if parts & JointPart.LIMIT or kind == JointKind.GENERAL:
        names += ["lower", "upper"]
    return [getattr(joints, f"joint_{name}")[j] for name in names]


def make_joint_rows(
    tid: int, launch: Any, config: Any, model: Any, state: Any, joints: Any, motion: Any, rows: Any
) -> None:
    """Rows of a world's joints; those of a joint that is broken, or whose bodies sleep, do nothing.

    Bodies that would swing within a step, as joints pull at their arms, have more inertia (Andrews et al. 2017);
    those that turn far in it are braked. A world stops where a joint that does something has a number that is not
    finite.
    """
    w = tid + launch.world_offset
    if state.flags[w]:
        return
    bodies = slice(model.body_start[w], model.body_start[w + 1])
    if not launch.resume:
        rows.stiff_inertia[bodies] = 0.0
    for j in range(model.joint_start[w], model.joint_start[w + 1]):
        ends = Ends(j, w, launch, config, model, state, motion, joints, rows)
        asleep = motion.predicted[[ends.a, ends.b], 3].min() < 0
        if asleep or joints.joint_broken[j]:
            for _ in range(joints.joint_row_start[j], joints.joint_row_start[j + 1]):
                if joints.joint_broken[j]:
                    ends.idle()
                else:
                    ends.rest()
        else:
            if not launch.resume and not np.isfinite(numbers_of(j, joints)).all():
                state.flags[w] = Flag.NONFINITE
                return
            MAKERS[JointKind(joints.joint_kind[j])](j, joints, ends)
        if launch.resume:
            continue
        own = slice(joints.joint_row_start[j], joints.joint_row_start[j + 1])
        pull = joints.joint_impulse[own] @ rows.row_jacobian_b[own, :2]
        for body, arm, force in ((ends.a, ends.d + ends.ra, -pull), (ends.b, ends.rb, pull)):
            rows.stiff_inertia[body] += STIFFNESS * ends.dt * ends.share * max(arm @ force, 0.0)
    if launch.resume:
        return
    own, pulled, predicted = model.inertia[bodies], rows.stiff_inertia[bodies].copy(), motion.predicted[bodies]
    rows.stiff_inertia[bodies] = np.maximum(pulled - own, 0.0)
    dt = motion.step_dt[w] / config.substeps if config.method == SUBSTEPS else motion.step_dt[w]
    brake = np.minimum((dt * state.angular_velocity[bodies] / SMALL_TURN) ** 4, 1.0)
    heavy = (own > 0) & (pulled > BRAKED * own)
    predicted[heavy, 2] *= 1 - brake[heavy] * (1 - BRAKED * own[heavy] / pulled[heavy])


def break_joints(tid: int, launch: Any, model: Any, state: Any, motion: Any, rows: Any, joints: Any) -> None:
    """A joint whose force on its bodies was above its break force in this step does nothing from the next on."""
    w = tid + launch.world_offset
    if state.flags[w]:
        return
    for j in range(model.joint_start[w], model.joint_start[w + 1]):
        own = slice(joints.joint_row_start[j], joints.joint_row_start[j + 1])
        force = joints.joint_impulse[own] @ rows.row_jacobian_b[own, :2]
        if np.hypot(*force) > joints.joint_break_force[j] * motion.step_dt[w]:
            joints.joint_broken[j] = 1


def kernels(dtype: str) -> Kernels:
    """``make_joint_rows`` and ``break_joints``; the arrays bring their scalar type."""
    return {"make_joint_rows": make_joint_rows, "break_joints": break_joints}
