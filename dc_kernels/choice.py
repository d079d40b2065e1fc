"""Which kernels a scene needs: decided once from its model, its joints and the settings."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from dc_kernels.collide.continuous import continuous_kernels
from dc_kernels.collide.switches import switch_kernels
from dc_kernels.events.lists import event_kernels
from dc_kernels.model.arrays import Fielded, Model
from dc_kernels.model.config import SolverConfig
from dc_kernels.model.joints.groups import Joints
from dc_kernels.model.validate.known import Facts
from dc_kernels.solve.joints import are_rods, joint_kernels
from dc_kernels.solve.rows import has_traits, only_centred_discs, rolling_kernels, variant_of
from dc_kernels.stages import files_of, kernel_table


class Choice(NamedTuple):
    """The kernels of a scene."""

    only_discs: bool
    """Whether all that moves are discs about their centre of mass."""
    variant: str
    """Layout of solver rows, a key of ``rows.COLUMNS``."""
    added_kernels: tuple[str, ...]
    """Those that scene and settings need beside those of every step (``stages.ADDED``)."""
    kernels: dict[str, Any]
    """All by name."""


@dataclass(frozen=True)
class Planned:
    """Fields of a model and its joints as they are to be."""

    given: Mapping[str, np.ndarray]
    """Arrays by name."""
    others: Callable[[str], np.ndarray]
    """Gives the array of another field."""

    def numpy(self, name: str) -> np.ndarray:
        """The array of a field."""
        return self.given[name] if name in self.given else self.others(name)


class Need(NamedTuple):
    """What the kernels of a scene depend on beside its settings; see ``Choice``."""

    only_discs: bool
    variant: str
    added: tuple[str, ...]


def need_of(model: Fielded, joints: Fielded, config: SolverConfig, specialize: bool) -> Need:
    """What the kernels that a scene needs depend on; see ``choose_kernels``."""
    rods, found = are_rods(joints), only_centred_discs(model)
    added = (*joint_kernels(joints, rods), *event_kernels(model, config), *switch_kernels(model, config))
    added += (*continuous_kernels(config), *rolling_kernels(model))
    return Need(found, variant_of(model, found and specialize, rods), added)


def check_kernels(model: Fielded, joints: Fielded, config: SolverConfig, specialize: bool, backend: str) -> None:
    """Raise ValueError for a scene that a backend, or the method of the settings, has no kernels for; none is made.

    A scene is refused for one of its shapes or joints, whatever else is there, so that what comes is held to it alone.
    """
    _, variant, added = need_of(model, joints, config, specialize)
    files_of(backend, variant, sleep=config.sleep, added=added, soft=config.soft)


def choose_kernels(
    model: Model, joints: Joints, config: SolverConfig, specialize: bool, facts: Facts | None = None
) -> Choice:
    """The kernels that a scene and its settings need.

    Args:
        model: of the scene.
        joints: of the scene.
        config: settings of the solver.
        specialize: whether scenes of discs have kernels of their own.
        facts: what is known of model and joints, beside which more is noted; None: nothing.
    """
    facts = Facts() if facts is None else facts
    needed = ("need", config.choosing, specialize)
    found, variant, added = facts.recall(needed, lambda: need_of(model, joints, config, specialize))
    table = kernel_table(
        model.backend,
        model.dtype.name,
        variant,
        found and specialize,
        sleep=config.sleep,
        traits=facts.recall("traits", lambda: has_traits(model)),
        added=added,
        soft=config.soft,
    )
    return Choice(found, variant, added, table)
