"""Contact events and sensor events of a step, as lists of pairs over all worlds."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from dc_kernels.events.lists import PairList, roles_of
from dc_kernels.model.enums import ShapeRole
from dc_kernels.model.settings import check_choice
from dc_kernels.runtime.inputs import check_simulation

PARTS = ("model", "contacts", "pairs", "overlaps", "touches", "config")


def contact_events(sim: Any, which: Literal["all", "begun", "ended", "hit"] = "all") -> PairList:
    """Return the pairs of shapes that touch, or that began or ended to touch or hit each other in the last step.

    Args:
        sim: the simulation, with ``SolverConfig.contact_events``.
        which: "all" pairs that touch; those that have "begun" or "ended" to touch in the last step; those that "hit"
            each other, faster than ``SolverConfig.hit_speed``.

    Returns:
        Pairs, sorted by world, shape A and shape B. The arrays of ``sim.touches`` have more data of each, at ``slot``:
        ``impulse``, ``speed`` and ``blow`` of all, ``hit_speed``, ``hit_point``, ``hit_normal`` of hits.

    Raises:
        ValueError: the list is unknown, or the settings have no contact events.

    Examples:
        >>> import dc_kernels as dc
        >>> builder = dc.ModelBuilder()
        >>> world = builder.add_world()
        >>> floor = builder.add_body(type=dc.BodyType.STATIC)
        >>> shape = builder.add_box(floor, 5.0, 0.5, center=(0.0, -0.5))
        >>> ball = builder.add_discs([(0.0, 1.0)], 0.5)
        >>> sim = dc.Simulation(*builder.finalize(), config=dc.SolverConfig(contact_events=True))
        >>> hits = []
        >>> sim.run(50, 0.01, callback=lambda sim: hits.append(dc.contact_events(sim, "hit").shape_b.tolist()))
        >>> [shapes for shapes in hits if shapes], dc.contact_events(sim).shape_a.tolist()
        ([[1]], [0])
    """
    check_simulation("sim", sim, PARTS)
    which = check_choice("which", which, ("all", "begun", "ended", "hit"))
    if not sim.config.contact_events:
        raise ValueError("SolverConfig.contact_events is False; no step lists what touches")
    return sim.touches.listed(sim.contacts.numpy("contact_start"), which.replace("all", ""))


def sensor_events(sim: Any, which: Literal["all", "begun", "ended"] = "all") -> PairList:
    """Return the pairs of a sensor and an overlapping shape, or those that began or ended to overlap in the last step.

    Args:
        sim: the simulation.
        which: "all" that overlapped or touched at the beginning of the last step; those that have "begun" or "ended".

    Returns:
        Pairs, sorted by world; ``shape_a`` is the sensor, of two sensors that of the static body or of the lower index.
        Their slots are those of the arrays of ``sim.overlaps``.

    Raises:
        ValueError: the list is unknown.

    Examples:
        >>> import dc_kernels as dc
        >>> builder = dc.ModelBuilder()
        >>> world = builder.add_world(gravity=(0.0, 0.0))
        >>> gate = builder.add_body(type=dc.BodyType.STATIC)
        >>> sensor = builder.add_box(gate, 0.1, 1.0, sensor=True)
        >>> ball = builder.add_discs([(-1.0, 0.0)], 0.19, velocity=(10.0, 0.0))
        >>> sim = dc.Simulation(*builder.finalize())
        >>> seen = []
        >>> sim.run(20, 0.01, callback=lambda sim: seen.append(len(dc.sensor_events(sim).shape_b)))
        >>> seen
        [0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0]
    """
    check_simulation("sim", sim, PARTS)
    which = check_choice("which", which, ("all", "begun", "ended"))
    found = sim.overlaps.listed(sim.pairs.numpy("start"), which.replace("all", ""))
    turned = roles_of(sim.model)[found.shape_a] != ShapeRole.SENSOR
    a, b = np.where(turned, found.shape_b, found.shape_a), np.where(turned, found.shape_a, found.shape_b)
    return found._replace(shape_a=a, shape_b=b)
