"""Contacts that do not act: those that a one-way shape lets through, and those that a user switches off.

``screen_contacts`` stands between the narrowphase with its matching and the colours. Where a shape is one-way, or a
segment of a one-sided chain, it asks of each of its pairs whether the contacts hold; those that do not it moves from
``contacts`` to ``switches``, so that no later stage of the step meets them. ``show_switched`` puts them back, by key,
before the cache is written: between steps ``contacts`` holds all, those that are off with the colour -1 and without
impulse, and they keep their keys and ages.

A pair holds that held in the step before: its contacts were matched with such of a colour. Else

- a one-way shape holds what the normal of a contact leads to, within 60 degrees of the direction of the shape
  (``ASIDE``), and what does not overlap it: by more than ``SLOPS`` slops, or, while it approaches, by more than the
  speculative distance. So what came from the other side, or from aside, passes, until it no longer overlaps;
- a segment of a one-sided chain holds what has its centre on the side of its normal, unless it parts from the segment
  while it overlaps it: what comes from behind is passed until it is wholly through.
"""

from __future__ import annotations

import numpy as np

from dc_kernels.model.arrays import ArrayGroup, Contacts, Fielded, Model
from dc_kernels.model.config import SolverConfig
from dc_kernels.model.enums import ShapeRole
from dc_kernels.model.groups import SWITCHES

ASIDE = 0.5
"""Sine of the angle by which a normal must lead to the side of a one-way shape: what meets its end flies past it."""
SLOPS = 2.0
"""Overlap up to which shapes touch [slop]: what rests a slop deep meets a tile a slop higher."""
SCREENING = ("screen_contacts", "show_switched")
"""Kernels that contacts which may be off add to those of a step."""


class Switches(ArrayGroup):
    """Contacts that are off (``model.groups.SWITCHES``); all axes are empty where none can be."""

    table = SWITCHES


def has_ways(model: Fielded) -> bool:
    """Whether a shape is one-way, or a segment of a one-sided chain."""
    role = model.numpy("shape_role")
    return len(role) > 0 and bool(np.isin(role, (ShapeRole.ONE_WAY, ShapeRole.ONE_SIDED)).any())


def switch_kernels(model: Fielded, config: SolverConfig) -> tuple[str, ...]:
    """Kernels that a scene and its settings need beside those of a step (``stages.SWITCHED``)."""
    return SCREENING if config.contact_switches or has_ways(model) else ()


class SwitchStorage:
    """The contacts that are off, in slots of the numbers that contacts of the step have.

    Attributes:
        switches: the contacts.
    """

    def __init__(self, model: Model) -> None:
        """Begin without any; ``allow`` allocates them."""
        memory = (model.dtype, model.device, model.backend)
        self.switches = Switches({"world": 0, "contact": 0}, *memory)

    def allow(self, model: Model, config: SolverConfig, contacts: Contacts) -> None:
        """Allocate what a scene and its settings need, or free it."""
        wanted = bool(switch_kernels(model, config))
        if wanted != (self.switches.sizes["world"] > 0):
            sizes = {"world": model.world_count, "contact": contacts.sizes["contact"]}
            self.switches.reallocate(SWITCHES, **(sizes if wanted else dict.fromkeys(sizes, 0)))

    def adopt(self, switches: Switches) -> None:
        """Take over the contacts of the same scene and settings."""
        self.switches = switches

    def groups(self) -> list[tuple[ArrayGroup, str]]:
        """The group with a slot for each contact, and the field that holds the number of those of each world."""
        return [(self.switches, "count")] if self.switches.sizes["world"] else []
