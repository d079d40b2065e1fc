"""Which kernels a scene needs: decided once from its model, its joints and the settings."""

from __future__ import annotations

from typing import Any, NamedTuple

from dc_kernels.collide.switches import switch_kernels
from dc_kernels.events.lists import event_kernels
from dc_kernels.model.arrays import Model
from dc_kernels.model.config import SolverConfig
from dc_kernels.model.joints.groups import Joints
from dc_kernels.solve.joints import are_rods, joint_kernels
from dc_kernels.solve.rows import has_traits, only_centred_discs, variant_of
from dc_kernels.stages import kernel_table


class Choice(NamedTuple):
    """The kernels of a scene."""

    only_discs: bool
    """Whether all that moves are discs about their centre of mass."""
    variant: str
    """Layout of solver rows, a key of ``rows.COLUMNS``."""
    added_kernels: tuple[str, ...]
    """Those that joints and events need beside those of every step (``stages.LINKED``, ``stages.EVENTS``)."""
    kernels: dict[str, Any]
    """All by name."""


def choose_kernels(model: Model, joints: Joints, config: SolverConfig, specialize: bool) -> Choice:
    """The kernels that a scene and its settings need.

    Args:
        model: of the scene.
        joints: of the scene.
        config: settings of the solver.
        specialize: whether scenes of discs have kernels of their own.
    """
    rods, found = are_rods(joints), only_centred_discs(model)
    variant = variant_of(model, found and specialize, rods)
    added = (*joint_kernels(joints, rods), *event_kernels(model, config), *switch_kernels(model, config))
    table = kernel_table(
        model.backend,
        model.dtype.name,
        variant,
        found and specialize,
        sleep=config.sleep,
        traits=has_traits(model),
        added=added,
        soft=config.soft,
    )
    return Choice(found, variant, added, table)
