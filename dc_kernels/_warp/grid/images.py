"""What bodies and contacts show on an image: places and values of the points that are splatted."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module, rotate, tangent
from dc_kernels._warp.grid.stencil import grid_types
from dc_kernels._warp.groups import struct_type
from dc_kernels.grid.channels import BODY_CHANNELS, CONTACT_CHANNELS
from dc_kernels.grid.fields import AREA, WALLS
from dc_kernels.model.fields import CONTACTS, MODEL, STATE

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
    """``body_features``, ``contact_features``, ``add_walls``; one thread a world."""
    t = grid_types(dtype)
    real, vec2, Points, values = t.real, t.vec2, t.Points, t.values
    tables = {"model": MODEL, "state": STATE, "contacts": CONTACTS, "area": AREA, "walls": WALLS}
    Model, State, Contacts, Area, Walls = (struct_type(name, dtype, table) for name, table in tables.items())
    codes = wp.array(dtype=wp.int32)
    module = kernel_module("features", dtype)

    @wp.kernel(module=module, enable_backward=False)
    def body_features(
        world_offset: int,
        channel: codes,
        area: Area,
        model: Model,
        state: State,
        # Out:
        points: Points,
        value: values,
    ):
        """Put points at position + R(angle) area.place, with area.weight times the body's value.

        A flagged world gets none.
        """
        w = wp.tid() + world_offset
        points.count[w] = 0
        if state.flags[w] != 0:
            return
        for p in range(area.start[w], area.start[w + 1]):
            b = area.body[p]
            weight = real(1.0)
            place = state.position[b]
            if area.spread != 0:
                weight = area.weight[p]
                place += rotate(wp.cos(state.angle[b]), wp.sin(state.angle[b]), area.place[p])
            points.place[p] = place
            for c in range(channel.shape[0]):
                code = channel[c]
                x = real(0.0)
                if code == MASS:
                    x = model.mass[b]
                elif code == VELOCITY_X:
                    x = state.velocity[b][0]
                elif code == VELOCITY_Y:
                    x = state.velocity[b][1]
                elif code == OMEGA:
                    x = state.angular_velocity[b]
                elif code == INERTIA:
                    x = model.inertia[b]
                elif code == ANGLE_COS:
                    x = wp.cos(state.angle[b])
                elif code == ANGLE_SIN:
                    x = wp.sin(state.angle[b])
                else:
                    x = wp.length(state.velocity[b])
                value[p, c] = weight * x
        points.count[w] = area.start[w + 1] - area.start[w]

    @wp.func(module=module)
    def point_velocity(body: int, arm: vec2, velocity: wp.array(dtype=vec2), angular_velocity: wp.array(dtype=real)):
        """Velocity of a body's point."""
        return velocity[body] + angular_velocity[body] * vec2(-arm[1], arm[0])

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
        channel: codes,
        state: State,
        contacts: Contacts,
        # Out:
        points: Points,
        value: values,
    ):
        """Put points at position[body_a] + arm_a, with the contacts' values; a flagged world gets none."""
        w = wp.tid() + world_offset
        points.count[w] = 0
        if state.flags[w] != 0:
            return
        for p in range(contacts.contact_start[w], contacts.contact_start[w] + contacts.contact_count[w]):
            a = contacts.body_a[p]
            points.place[p] = state.position[a] + contacts.arm_a[p]
            n = contacts.normal[p]
            if bins > 1:
                points.bin[p] = direction_bin(n, bins)
            for c in range(channel.shape[0]):
                code = channel[c]
                x = real(0.0)
                if code == NORMAL_X:
                    x = n[0]
                elif code == NORMAL_Y:
                    x = n[1]
                elif code == GAP:
                    x = contacts.gap[p]
                elif code == IMPULSE_N:
                    x = contacts.impulse[p][0]
                elif code == IMPULSE_T:
                    x = contacts.impulse[p][1]
                elif code == CLOSING or code == SLIDING:
                    va = point_velocity(a, contacts.arm_a[p], state.velocity, state.angular_velocity)
                    vb = point_velocity(contacts.body_b[p], contacts.arm_b[p], state.velocity, state.angular_velocity)
                    if code == CLOSING:
                        x = -wp.dot(n, vb - va)
                    else:
                        x = wp.dot(tangent(n), vb - va)
                elif code == FRICTION:
                    x = contacts.friction[p]
                elif contacts.age[p] == 0:
                    x = real(1.0)
                value[p, c] = x
        points.count[w] = contacts.contact_count[w]

    @wp.kernel(module=module, enable_backward=False)
    def add_walls(
        world_offset: int,
        walls: Walls,
        # in, out:
        image: t.image,
    ):
        """Add the walls' value to their nodes, on top of what bodies added."""
        w = wp.tid() + world_offset
        for i in range(walls.start[w], walls.start[w + 1]):
            r = walls.row[i]
            c = walls.column[i]
            image[w, walls.channel, r, c] = image[w, walls.channel, r, c] + walls.value

    return {"body_features": body_features, "contact_features": contact_features, "add_walls": add_walls}
