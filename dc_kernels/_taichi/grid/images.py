"""What bodies and contacts show on an image: places and values of the points that are splatted."""

from functools import cache
from typing import Any

from dc_kernels._taichi.common import rotate, tangent
from dc_kernels._taichi.grid.stencil import grid_types
from dc_kernels._taichi.groups import struct_type
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.runtime.kernels import kernel
from dc_kernels.grid.channels import BODY_CHANNELS, CONTACT_CHANNELS
from dc_kernels.grid.fields import AREA, WALLS
from dc_kernels.model.fields import CONTACTS, MODEL, STATE

MASS = BODY_CHANNELS["mass"].code
VELOCITY_X = BODY_CHANNELS["velocity_x"].code
VELOCITY_Y = BODY_CHANNELS["velocity_y"].code
OMEGA = BODY_CHANNELS["omega"].code
INERTIA = BODY_CHANNELS["inertia"].code
ANGLE_COS = BODY_CHANNELS["angle_cos"].code
ANGLE_SIN = BODY_CHANNELS["angle_sin"].code
NORMAL_X = CONTACT_CHANNELS["normal_x"].code
NORMAL_Y = CONTACT_CHANNELS["normal_y"].code
GAP = CONTACT_CHANNELS["gap"].code
IMPULSE_N = CONTACT_CHANNELS["impulse_n"].code
IMPULSE_T = CONTACT_CHANNELS["impulse_t"].code
CLOSING = CONTACT_CHANNELS["closing_speed"].code
SLIDING = CONTACT_CHANNELS["sliding_speed"].code
FRICTION = CONTACT_CHANNELS["friction"].code


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """``body_features``, ``contact_features``, ``add_walls``; one thread a world."""
    t = grid_types(dtype)
    real, vec2 = t.real, t.vec2
    tables = {"model": MODEL, "state": STATE, "contacts": CONTACTS, "area": AREA, "walls": WALLS}
    Model, State, Contacts, Area, Walls = (struct_type(name, dtype, table) for name, table in tables.items())
    codes = ti.types.ndarray(dtype=ti.i32, ndim=1)

    @kernel
    def body_features(
        tid,
        world_offset: ti.i32,
        channel: codes,
        area: Area,
        model: Model,
        state: State,
        points: t.Points,
        value: t.values,
    ):
        """Put points at position + R(angle) area.place, with area.weight times the body's value.

        A flagged world gets none.
        """
        w = tid + world_offset
        points.count[w] = 0
        if state.flags[w] == 0:
            for p in range(area.start[w], area.start[w + 1]):
                b = area.body[p]
                c = ti.cos(state.angle[b])
                s = ti.sin(state.angle[b])
                velocity = state.velocity[b]
                weight = real(1.0)
                place = state.position[b]
                if area.spread != 0:
                    weight = area.weight[p]
                    place = place + rotate(c, s, area.place[p])
                points.place[p, 0] = place[0]
                points.place[p, 1] = place[1]
                for i in range(channel.shape[0]):
                    code = channel[i]
                    x = real(0.0)
                    if code == MASS:
                        x = model.mass[b]
                    elif code == VELOCITY_X:
                        x = velocity[0]
                    elif code == VELOCITY_Y:
                        x = velocity[1]
                    elif code == OMEGA:
                        x = state.angular_velocity[b]
                    elif code == INERTIA:
                        x = model.inertia[b]
                    elif code == ANGLE_COS:
                        x = c
                    elif code == ANGLE_SIN:
                        x = s
                    else:
                        x = ti.sqrt(velocity[0] * velocity[0] + velocity[1] * velocity[1])
                    value[p, i] = weight * x
            points.count[w] = area.start[w + 1] - area.start[w]

    @ti.func
    def point_velocity(body, arm, state: State):
        """Velocity of a body's point."""
        return state.velocity[body] + state.angular_velocity[body] * vec2(arm[1] * -1.0, arm[0])

    @ti.func
    def direction_bin(n, bins):
        """Bin of the direction modulo pi; the first is centred on the x axis, so axis-parallel normals lie inside."""
        # n and -n must give the same bits
        x = n[0]
        y = n[1]
        if n[1] < 0.0 or (n[1] == 0.0 and n[0] < 0.0):
            x = n[0] * -1.0
            y = n[1] * -1.0
        turn = ti.atan2(y, x) * 0.3183098861837907
        return ti.cast(turn * ti.cast(bins, real) + 0.5, ti.i32) % bins

    @kernel
    def contact_features(
        tid,
        world_offset: ti.i32,
        bins: ti.i32,
        channel: codes,
        state: State,
        contacts: Contacts,
        points: t.Points,
        value: t.values,
    ):
        """Put points at position[body_a] + arm_a, with the contacts' values; a flagged world gets none."""
        w = tid + world_offset
        points.count[w] = 0
        if state.flags[w] == 0:
            first = contacts.contact_start[w]
            for p in range(first, first + contacts.contact_count[w]):
                a = contacts.body_a[p]
                place = state.position[a] + contacts.arm_a[p]
                points.place[p, 0] = place[0]
                points.place[p, 1] = place[1]
                n = contacts.normal[p]
                if bins > 1:
                    points.bin[p] = direction_bin(n, bins)
                for i in range(channel.shape[0]):
                    code = channel[i]
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
                        relative = point_velocity(contacts.body_b[p], contacts.arm_b[p], state)
                        relative = relative - point_velocity(a, contacts.arm_a[p], state)
                        if code == CLOSING:
                            x = (n[0] * relative[0] + n[1] * relative[1]) * -1.0
                        else:
                            along = tangent(n)
                            x = along[0] * relative[0] + along[1] * relative[1]
                    elif code == FRICTION:
                        x = contacts.friction[p]
                    elif contacts.age[p] == 0:
                        x = real(1.0)
                    value[p, i] = x
            points.count[w] = contacts.contact_count[w]

    @kernel
    def add_walls(tid, world_offset: ti.i32, walls: Walls, image: t.image):
        """Add the walls' value to their nodes, on top of what bodies added."""
        w = tid + world_offset
        for i in range(walls.start[w], walls.start[w + 1]):
            r = walls.row[i]
            c = walls.column[i]
            image[w, walls.channel, r, c] = image[w, walls.channel, r, c] + walls.value

    return {"body_features": body_features, "contact_features": contact_features, "add_walls": add_walls}
