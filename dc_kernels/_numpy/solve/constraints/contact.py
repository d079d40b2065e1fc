"""The row of a contact (Wu 2018, equations 2.21 and 2.22), its effective masses (2.24, 2.25) and its bias."""

from __future__ import annotations

from typing import Any

import numpy as np

from dc_kernels._numpy.common import dot, tangent
from dc_kernels._numpy.solve.constraints.rolling import slip_of
from dc_kernels._numpy.solve.laws import direction
from dc_kernels._numpy.solve.row import PackedRow, effective_mass, inverse_inertias, velocities
from dc_kernels.model.config import POSITION_CORRECTIONS
from dc_kernels.solve.rows import SURFACED

BAUMGARTE = POSITION_CORRECTIONS["baumgarte"]
OPEN = 1e6  # a row that lets this many times the gap close within the step never acts


def make_contact_row(
    c: int, w: int, variant: str, config: Any, model: Any, state: Any, motion: Any, contacts: Any, rows: Any
) -> PackedRow:
    """The row of contact c of world w."""
    dt = motion.step_dt[w]
    slop = config.slop * model.length_scale[w]
    a, b, n = contacts.body_a[c], contacts.body_b[c], contacts.normal[c]
    jn = direction(n, contacts.arm_a[c], contacts.arm_b[c])
    jt = direction(tangent(n), contacts.arm_a[c], contacts.arm_b[c])
    if variant == "discs":
        jn[[2, 5]] = 0.0  # the normal of a disc points at its centre
    v = np.concatenate([motion.predicted[a, :3], motion.predicted[b, :3]])
    un, ut = jn @ v, jt @ v
    inverse = inverse_inertias(a, b, model, rows)
    en, et = (effective_mass(j, a, b, model, motion, inverse) for j in (jn, jt))
    g, e = contacts.gap[c], contacts.restitution[c]
    bias = g.dtype.type(0)
    if g > slop:
        bias = g / dt  # the gap may close within the step; a smaller one counts as closed
    elif config.position_correction == BAUMGARTE and g < -slop:
        bias = max(config.position_factor * (g + slop), -config.max_correction * model.length_scale[w]) / dt
    counted = True
    if e > 0 and g > slop and g + un * dt >= 0:
        bias, counted = OPEN * g / dt, False  # what another impact pushes across it bounces in the next step
    elif e > 0:
        before = jn @ velocities(state, a, b)
        scale = np.sqrt(dot(model.gravity[w], model.gravity[w])) * model.length_scale[w]
        threshold = config.restitution_threshold * np.sqrt(scale) if e < 1 else 0.0
        if before > 0:
            # Moreau (1988): a separating contact may be left approaching with e times its speed at most
            bias = max(bias, e * before)
        elif before < -threshold:
            bias = min(bias, e * before)  # Newton's impact law, of the speed before the step's forces
    slip = slip_of(c, w, model, contacts, rows) if variant in SURFACED else g.dtype.type(0)
    ut = ut + slip
    square = (en * (un + bias)) ** 2 + (en * ut) ** 2 if counted else 0.0
    return PackedRow(
        a, b, n, jn, jt, en, et, bias, contacts.friction[c], g + slop, 0.0, square, slip=slip, inverse=inverse
    )
