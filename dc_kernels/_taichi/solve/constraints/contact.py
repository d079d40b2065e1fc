"""The row of a contact: J = [-n, -r_A x n, n, r_B x n] along its normal and, with t for n, its tangent.

These are equations 2.21 and 2.22 of Wu (2018), and the effective mass, 1 / (J M^-1 J^T), is 2.24 and 2.25.
"""

from functools import cache
from typing import Any

from dc_kernels._taichi.common import cross, length, tangent
from dc_kernels._taichi.groups import group_types
from dc_kernels._taichi.runtime.compiler import ti
from dc_kernels._taichi.solve.laws import inverse_or_zero, relative_speed
from dc_kernels.model.config import POSITION_CORRECTIONS

BAUMGARTE = POSITION_CORRECTIONS["baumgarte"]
OPEN = 1e6  # a row that lets this many times the gap close within the step never acts


@cache
def contact_row(dtype: str, variant: str) -> Any:
    """The function that makes the row of a contact."""
    t = group_types(dtype)
    vec4 = t.vec4
    Row = t.Row
    discs = variant == "discs"

    @ti.func
    def make_contact_row(
        c,
        w,
        config: t.Config,
        model: t.Model,
        state: t.State,
        motion: t.Motion,
        contacts: t.Contacts,
    ):
        """The row of contact c of world w.

        Bias velocity: a gap may close within the step (gap / dt), but one below the slop counts as closed: the
        round-off of resting gaps would change the problem in each step and cost the warm start a tenth of its gain.
        A contact that hits within the step faster than the threshold, which is 0 where e is 1, leaves with -e times the
        speed that it had before the step's forces: bounces then mirror semi-implicit Euler, and an elastic ball returns
        to its height to round-off for ever. A gap of a bouncing pair that stays open is left alone: what another impact
        pushes across it bounces in the next step. A closed separating contact of such a pair may be left approaching
        with e times its speed at most (Moreau 1988), without which several impacts at once can gain energy.
        """
        dt = motion.step_dt[w]
        per_dt = 1.0 / dt
        slop = config.slop * model.length_scale[w]
        a = contacts.body_a[c]
        b = contacts.body_b[c]
        va = motion.predicted[a]
        vb = motion.predicted[b]
        ia = model.inv_inertia[a]
        ib = model.inv_inertia[b]
        n = contacts.normal[c]
        tan = tangent(n)
        rat = cross(contacts.arm_a[c], tan)
        rbt = cross(contacts.arm_b[c], tan)
        ran = 0.0
        rbn = 0.0
        if ti.static(not discs):
            ran = cross(contacts.arm_a[c], n)
            rbn = cross(contacts.arm_b[c], n)
        un = relative_speed(n, va, vb, ran, rbn)
        ut = relative_speed(tan, va, vb, rat, rbt)
        g = contacts.gap[c]
        e = contacts.restitution[c]
        bias = 0.0
        if g > slop:
            bias = g * per_dt
        elif config.position_correction == BAUMGARTE and g < -slop:
            limit = config.max_correction * model.length_scale[w]
            bias = ti.max(config.position_factor * (g + slop), -limit) * per_dt
        counted = 1.0
        if e > 0.0:
            if g > slop and g + un * dt >= 0.0:
                bias = OPEN * g * per_dt
                counted = 0.0
            else:
                v0a = vec4(state.velocity[a][0], state.velocity[a][1], state.angular_velocity[a], 0.0)
                v0b = vec4(state.velocity[b][0], state.velocity[b][1], state.angular_velocity[b], 0.0)
                before = relative_speed(n, v0a, v0b, ran, rbn)
                if before > 0.0:
                    bias = ti.max(bias, e * before)
                else:
                    threshold = 0.0
                    if e < 1.0:
                        scale = length(model.gravity[w]) * model.length_scale[w]
                        threshold = config.restitution_threshold * ti.sqrt(scale)
                    if before < -threshold:
                        bias = ti.min(bias, e * before)
        ma = va[3]
        mb = vb[3]
        en = inverse_or_zero(ma + mb + ia * ran * ran + ib * rbn * rbn)
        et = inverse_or_zero(ma + mb + ia * rat * rat + ib * rbt * rbt)
        row = Row()
        row.body_a = a
        row.body_b = b
        row.normal = n
        row.normal_arm_a = ran
        row.normal_arm_b = rbn
        row.tangent_arm_a = rat
        row.tangent_arm_b = rbt
        row.inv_inertia_a = ia
        row.inv_inertia_b = ib
        row.normal_mass = en
        row.tangent_mass = et
        row.bias = bias
        row.friction = contacts.friction[c]
        row.gap = g + slop
        row.square = counted * ((en * (un + bias)) * (en * (un + bias)) + (en * ut) * (en * ut))
        return row

    return make_contact_row
