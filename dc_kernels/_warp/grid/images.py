"""What bodies and contacts show on an image: places and values of the points that are splatted."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module, rotate, scalar_types, tangent
from dc_kernels.grid.channels import BODY_CHANNELS, CONTACT_CHANNELS

MASS = wp.constant(BODY_CHANNELS["mass"].code)
VELOCITY_X = wp.constant(BODY_CHANNELS["velocity_x"].code)
VELOCITY_Y = wp.constant(BODY_CHANNELS["velocity_y"].code)
OMEGA = wp.constant(BODY_CHANNELS["omega"].code)
INERTIA = wp.constant(BODY_CHANNELS["inertia"].code)
ANGLE_COS = wp.constant(BODY_CHANNELS["angle_cos"].code)
ANGLE_SIN = wp.constant(BODY_CHANNELS["angle_sin"].code)
NORMAL_X = wp.constant(CONTACT_CHANNELS["normal_x"].code)
NORMAL_Y = wp.constant(CONTACT_CHANNELS["normal_y"].code)
GAP = wp.constant(CONTACT_CHANNELS["gap"].code)
IMPULSE_N = wp.constant(CONTACT_CHANNELS["impulse_n"].code)
IMPULSE_T = wp.constant(CONTACT_CHANNELS["impulse_t"].code)
CLOSING = wp.constant(CONTACT_CHANNELS["closing_speed"].code)
SLIDING = wp.constant(CONTACT_CHANNELS["sliding_speed"].code)
FRICTION = wp.constant(CONTACT_CHANNELS["friction"].code)


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """``body_features``, ``contact_features``, ``mark_walls``, ``add_walls``; one thread a world."""
    t = scalar_types(dtype)
    real, vec2 = t.real, t.vec2
    module = kernel_module("features", dtype)

    @wp.kernel(module=module, enable_backward=False)
    def body_features(
        world_offset: int,
        area: int,
        body_channel: wp.array(dtype=wp.int32),
        flags: wp.array(dtype=wp.int32),
        # Points of the bodies:
        area_start: wp.array(dtype=wp.int32),
        area_body: wp.array(dtype=wp.int32),
        area_point: wp.array(dtype=vec2),
        area_weight: wp.array(dtype=real),
        # Model and state in:
        mass: wp.array(dtype=real),
        inertia: wp.array(dtype=real),
        position: wp.array(dtype=vec2),
        angle: wp.array(dtype=real),
        velocity: wp.array(dtype=vec2),
        angular_velocity: wp.array(dtype=real),
        # out:
        point_count: wp.array(dtype=wp.int32),
        point: wp.array(dtype=vec2),
        value: wp.array(dtype=real, ndim=2),
    ):
        """Points at position + R(angle) area_point with area_weight times the body's value; none in a flagged world."""
        w = wp.tid() + world_offset
        point_count[w] = 0
        if flags[w] != 0:
            return
        for p in range(area_start[w], area_start[w + 1]):
            b = area_body[p]
            weight = real(1.0)
            place = position[b]
            if area != 0:
                weight = area_weight[p]
                place += rotate(wp.cos(angle[b]), wp.sin(angle[b]), area_point[p])
            point[p] = place
            for c in range(body_channel.shape[0]):
                code = body_channel[c]
                x = real(0.0)
                if code == MASS:
                    x = mass[b]
                elif code == VELOCITY_X:
                    x = velocity[b][0]
                elif code == VELOCITY_Y:
                    x = velocity[b][1]
                elif code == OMEGA:
                    x = angular_velocity[b]
                elif code == INERTIA:
                    x = inertia[b]
                elif code == ANGLE_COS:
                    x = wp.cos(angle[b])
                elif code == ANGLE_SIN:
                    x = wp.sin(angle[b])
                else:
                    x = wp.length(velocity[b])
                value[p, c] = weight * x
        point_count[w] = area_start[w + 1] - area_start[w]

    @wp.func(module=module)
    def relative_velocity(
        a: int,
        b: int,
        arm_a: vec2,
        arm_b: vec2,
        velocity: wp.array(dtype=vec2),
        angular_velocity: wp.array(dtype=real),
    ):
        """Of B against A at the contact."""
        va = velocity[a] + angular_velocity[a] * vec2(-arm_a[1], arm_a[0])
        vb = velocity[b] + angular_velocity[b] * vec2(-arm_b[1], arm_b[0])
        return vb - va

    @wp.func(module=module)
    def direction_bin(n: vec2, bins: int):
        """Bin of the direction modulo pi; the first is centred on the x axis, so axis-parallel normals lie inside."""
        # n and -n must give the same bits
        u = n
        if n[1] < real(0.0) or (n[1] == real(0.0) and n[0] < real(0.0)):
            u = -n
        turn = wp.atan2(u[1], u[0]) * real(0.3183098861837907)
        return int(turn * real(bins) + real(0.5)) % bins

    @wp.kernel(module=module, enable_backward=False)
    def contact_features(
        world_offset: int,
        bins: int,
        contact_channel: wp.array(dtype=wp.int32),
        flags: wp.array(dtype=wp.int32),
        # Contacts in:
        contact_start: wp.array(dtype=wp.int32),
        contact_count: wp.array(dtype=wp.int32),
        body_a: wp.array(dtype=wp.int32),
        body_b: wp.array(dtype=wp.int32),
        normal: wp.array(dtype=vec2),
        arm_a: wp.array(dtype=vec2),
        arm_b: wp.array(dtype=vec2),
        gap: wp.array(dtype=real),
        friction: wp.array(dtype=real),
        impulse: wp.array(dtype=vec2),
        age: wp.array(dtype=wp.int32),
        # State in:
        position: wp.array(dtype=vec2),
        velocity: wp.array(dtype=vec2),
        angular_velocity: wp.array(dtype=real),
        # out:
        point_count: wp.array(dtype=wp.int32),
        point: wp.array(dtype=vec2),
        point_bin: wp.array(dtype=wp.int32),
        value: wp.array(dtype=real, ndim=2),
    ):
        """Points at position[body_a] + arm_a with the contacts' values; none in a flagged world."""
        w = wp.tid() + world_offset
        point_count[w] = 0
        if flags[w] != 0:
            return
        for p in range(contact_start[w], contact_start[w] + contact_count[w]):
            a = body_a[p]
            point[p] = position[a] + arm_a[p]
            n = normal[p]
            if bins > 1:
                point_bin[p] = direction_bin(n, bins)
            for c in range(contact_channel.shape[0]):
                code = contact_channel[c]
                x = real(0.0)
                if code == NORMAL_X:
                    x = n[0]
                elif code == NORMAL_Y:
                    x = n[1]
                elif code == GAP:
                    x = gap[p]
                elif code == IMPULSE_N:
                    x = impulse[p][0]
                elif code == IMPULSE_T:
                    x = impulse[p][1]
                elif code == CLOSING:
                    x = -wp.dot(n, relative_velocity(a, body_b[p], arm_a[p], arm_b[p], velocity, angular_velocity))
                elif code == SLIDING:
                    x = wp.dot(
                        tangent(n), relative_velocity(a, body_b[p], arm_a[p], arm_b[p], velocity, angular_velocity)
                    )
                elif code == FRICTION:
                    x = friction[p]
                elif age[p] == 0:
                    x = real(1.0)
                value[p, c] = x
        point_count[w] = contact_count[w]

    @wp.kernel(module=module, enable_backward=False)
    def mark_walls(
        world_offset: int,
        wall_band: wp.array(dtype=wp.int32, ndim=2),
        # in, out:
        touched: wp.array(dtype=wp.int32, ndim=2),
    ):
        """Bands with walls are cleared by the splat that follows, so that each gets its walls once."""
        w = wp.tid() + world_offset
        for b in range(touched.shape[1]):
            if wall_band[w, b] != 0:
                touched[w, b] = 1

    @wp.kernel(module=module, enable_backward=False)
    def add_walls(
        world_offset: int,
        wall_value: real,
        wall_channel: int,
        wall_start: wp.array(dtype=wp.int32),
        wall_row: wp.array(dtype=wp.int32),
        wall_column: wp.array(dtype=wp.int32),
        # in, out:
        image: wp.array(dtype=real, ndim=4),
    ):
        """The walls' value on their nodes, on top of what bodies added."""
        w = wp.tid() + world_offset
        for i in range(wall_start[w], wall_start[w + 1]):
            r = wall_row[i]
            c = wall_column[i]
            image[w, wall_channel, r, c] = image[w, wall_channel, r, c] + wall_value

    return {
        "body_features": body_features,
        "contact_features": contact_features,
        "mark_walls": mark_walls,
        "add_walls": add_walls,
    }
