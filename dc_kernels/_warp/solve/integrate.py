"""Semi-implicit Euler (Wu 2018, chapter 2.1): velocities before the contacts, positions after them."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.groups import contiguous_groups, group_types
from dc_kernels._warp.solve.ranges import ranges_code
from dc_kernels.model.enums import BodyType, Flag

NONFINITE = wp.constant(int(Flag.NONFINITE))


@cache
def kernels(dtype: str, traits: bool = False) -> dict[str, Any]:
    """``predict``, ``displace`` and ``commit``; one thread a world; ``traits``: bodies have damping, gravity scales."""
    t = group_types(dtype)
    real = t.real
    module = kernel_module("integrate", dtype, *(["traits"] if traits else []))
    contiguous = contiguous_groups(dtype)

    kinds = {"STATIC": int(BodyType.STATIC), "DYNAMIC": int(BodyType.DYNAMIC), "TRAITS": traits}

    @wp.func_native(ranges_code(dtype, "integrate/predict.h", **kinds))
    def accelerate_bodies(
        w: wp.int32,
        b0: wp.int32,
        b1: wp.int32,
        config: t.Config,
        model: t.Model,
        state: t.State,
        motion: t.Motion,
        team: wp.uint64,
    ) -> wp.bool: ...

    @wp.func_native(ranges_code(dtype, "integrate/displace.h"))
    def displace_bodies(b0: wp.int32, b1: wp.int32, dt: real, motion: t.Motion, team: wp.uint64): ...

    @wp.func_native(ranges_code(dtype, "integrate/move.h", **kinds))
    def move_bodies(
        b0: wp.int32, b1: wp.int32, model: t.Model, state: t.State, motion: t.Motion, team: wp.uint64
    ) -> wp.bool: ...

    @wp.func_native(ranges_code(dtype, "collide/copy_contacts.h"))
    def copy_contacts(contacts: t.Contacts, cache: t.Cache, i0: wp.int32, i1: wp.int32, team: wp.uint64): ...

    @wp.kernel(module=module, enable_backward=False)
    def predict(
        launch: t.Launch,
        config: t.Config,
        model: t.Model,
        state: t.State,
        motion: t.Motion,
    ):
        """Velocities with forces and gravity applied; the fourth component is the inverse mass.

        ``reach`` is the speculative distance of the step: what the fastest body covers, for whatever it hits may leave
        as fast, within limits; in a world where most bodies rest, four times what they cover in the mean square. With a
        fixed 0.02 instead of up to 0.1 diameters, overlaps at impact reach 65 mm, not 1.
        """
        w = wp.tid() + launch.world_offset
        contiguous(model)
        contiguous(state)
        contiguous(motion)
        if state.flags[w] != 0:
            return
        last = model.body_start[w + 1] - motion.empty_bodies[w]
        if not accelerate_bodies(w, model.body_start[w], last, config, model, state, motion, launch.team):
            state.flags[w] = NONFINITE

    @wp.kernel(module=module, enable_backward=False)
    def displace(
        launch: t.Launch,
        model: t.Model,
        state: t.State,
        motion: t.Motion,
    ):
        """What the solved velocities move the bodies by in this step; position correction adds to it."""
        w = wp.tid() + launch.world_offset
        contiguous(model)
        contiguous(state)
        contiguous(motion)
        if state.flags[w] != 0:
            return
        last = model.body_start[w + 1] - motion.empty_bodies[w]
        displace_bodies(model.body_start[w], last, motion.step_dt[w], motion, launch.team)

    @wp.kernel(module=module, enable_backward=False)
    def commit(
        launch: t.Launch,
        model: t.Model,
        state: t.State,
        joints: t.Joints,
        motion: t.Motion,
        contacts: t.Contacts,
        cache: t.Cache,
    ):
        """New state and contact cache of a world, or a NONFINITE flag and nothing changed."""
        w = wp.tid() + launch.world_offset
        contiguous(model)
        contiguous(state)
        contiguous(joints)
        contiguous(motion)
        contiguous(contacts)
        contiguous(cache)
        if state.flags[w] != 0:
            return
        first = model.body_start[w]
        last = model.body_start[w + 1] - motion.empty_bodies[w]
        if not move_bodies(first, last, model, state, motion, launch.team):
            state.flags[w] = NONFINITE
            return
        state.time[w] = state.time[w] + wp.float64(motion.step_dt[w])
        start = contacts.contact_start[w]
        n = contacts.contact_count[w]
        copy_contacts(contacts, cache, start, start + n, launch.team)
        joint = model.joint_start[w]
        last_joint = model.joint_start[w + 1]
        if joint < last_joint:  # two loads less in a world without joints
            for k in range(joints.joint_row_start[joint], joints.joint_row_start[last_joint]):
                cache.joint_impulse[k] = joints.joint_impulse[k]
        cache.count[w] = n
        contacts.contact_dt[w] = motion.step_dt[w]

    return {"predict": predict, "displace": displace, "commit": commit}
