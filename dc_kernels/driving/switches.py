"""Changes of single contacts between ``collide`` and ``solve``: switched off, with another friction, on a belt."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from dc_kernels.measure import contact_slots
from dc_kernels.model.arrays import ArrayGroup, to_numpy
from dc_kernels.model.checks import check_values
from dc_kernels.model.fields import CONTACTS, ROWS
from dc_kernels.model.groups import SWITCHES
from dc_kernels.model.rules import Number, refuse
from dc_kernels.model.settings import UnknownName, numeric
from dc_kernels.model.validate.arrays import check_rule
from dc_kernels.runtime.interop import host_view
from dc_kernels.runtime.threads import uninterrupted

if TYPE_CHECKING:
    from dc_kernels.simulation import Simulation

PLACES = {
    "enabled": ("switches", SWITCHES),
    "friction": ("contacts", CONTACTS),
    "restitution": ("contacts", CONTACTS),
    "surface_speed": ("rows", ROWS),
}
"""What may be changed of a contact, and the group of arrays in which it stands."""


def change(sim: Simulation, values: Mapping[str, Any]) -> None:
    """Change contacts of the step in flight, and make its rows anew.

    Args:
        sim: the simulation, after ``collide``.
        values: by name, of all contacts in the order of ``contact_slots``, (n,), or one number; none: what was written.

    Raises:
        TypeError, ValueError: naming field, index and limit; out of turn. Nothing is changed then, but what
            was written to the arrays stays.
    """
    if sim.phase != "collide":
        raise ValueError(
            "change_contacts() out of turn: contacts are changed between collide(dt) and solve(), or by a start"
        )
    slots, _ = contact_slots(sim.contacts)
    given = {name: _given(sim, name, array, len(slots)) for name, array in values.items()}
    for name, (group, table) in PLACES.items():
        rule, held = table[name].rule, _array(getattr(sim, group), name)
        if len(held) and isinstance(rule, Number):
            check_rule(name, given.get(name, held[slots]), rule)
    with uninterrupted():
        for name, array in given.items():
            group = getattr(sim, PLACES[name][0])
            held = _array(group, name)
            held[slots] = array
            if group.device != "cpu":
                group.fill(name, held)
        for shard in sim.ranges:
            if sim.config.contact_switches:
                sim.bind("switch_contacts", *shard)()
            sim.bind("pack_rows", *shard)()


def _array(group: ArrayGroup, name: str) -> np.ndarray:
    """An array to write to: the memory itself on a CPU, a copy from a GPU."""
    return to_numpy(group.array(name))


def _given(sim: Simulation, name: str, values: Any, count: int) -> np.ndarray:
    """Values of all contacts, of the dtype of their field."""
    if name not in PLACES:
        raise UnknownName(f"{name} is nothing that change_contacts() changes. It may be one of {', '.join(PLACES)}")
    if name == "enabled" and not sim.config.contact_switches:
        raise ValueError("SolverConfig.contact_switches is False; no contact of this simulation is switched off")
    if name == "surface_speed" and not sim.rows.sizes["switched contact"]:
        why = "no shape has a surface_speed or rolling_resistance"
        if sim.config.contact_switches is False:
            why = "SolverConfig.contact_switches is False"
        raise ValueError(f"{why}; no contact of this simulation has a surface speed that could be changed")
    dtype = _array(getattr(sim, PLACES[name][0]), name).dtype
    kinds = "buif" if name == "enabled" else "uif"
    array = numeric(name, host_view(name, values), f"a number, or {count} of them", kinds)
    if array.shape == ():
        array = np.full(count, array)
    if name == "enabled":
        refuse(name, array, (array != 0) & (array != 1), "in [0, 1], False or True")
    return check_values(name, array, (count,), dtype)
