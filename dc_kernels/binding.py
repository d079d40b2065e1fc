"""Launches of a step's kernels, bound to the groups and settings of a simulation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from dc_kernels.model.arrays import ArrayGroup, Model
from dc_kernels.model.config import CONFIG, SolverConfig
from dc_kernels.model.dtypes import aligned_zeros, float_name
from dc_kernels.model.fields import LAUNCH, SCRATCH
from dc_kernels.model.settings import WrongType, check_choice, shown
from dc_kernels.runtime.backends import BACKENDS, Launch, bind, kernel_file, on_numpy
from dc_kernels.runtime.inputs import check_whole
from dc_kernels.runtime.stepping import Shards
from dc_kernels.solve.integrate import PADDING
from dc_kernels.solve.iteration import NEVER

UNIFORM = ("uniform_friction", "uniform_restitution")


def uniform(values: np.ndarray) -> float:
    """The value that all have in common, -1 if they differ."""
    return float(values[0]) if len(values) and (values == values[0]).all() else -1.0


class Binding:
    """Arguments of the kernels of a step by name: the groups, the settings, and the numbers of a launch.

    Attributes:
        values: groups and settings as kernels take them; made anew by ``renew``.
    """

    def __init__(
        self,
        kernels: Mapping[str, Any],
        model: Model,
        shards: Shards,
    ) -> None:
        """Prepare.

        Args:
            kernels: of the backend, by name.
            model: of the simulation.
            shards: of its worlds.
        """
        self.kernels, self.model, self._shards = kernels, model, shards
        self._cut_address = shards.cut_flag.ctypes.data if model.device == "cpu" else 0
        self._groups = kernel_file(self.model.backend, "groups")
        self.values: dict[str, Any] = {}
        self._settings: dict[str, Any] = {}
        self._past = (0, False)
        self._scratch: dict[int, np.ndarray] = {}

    def renew(self, config: SolverConfig, groups: Mapping[str, ArrayGroup], past_width: int, in_turn: bool) -> None:
        """Take settings and arrays anew.

        Args:
            config: settings of the solver.
            groups: every group by the name that kernels have for it.
            past_width: numbers that a world's accelerated solve may look back on.
            in_turn: whether the worlds of a shard are solved one after the other, and so share them.
        """
        self._past = (past_width, in_turn)
        self._settings = {**config.kernel_values(), **self._coefficients()}
        self.values = {name: self._groups.array_group(group, name) for name, group in groups.items()}
        self.values |= {
            "threads": self._shards.over_worlds,
            "deferred": True,
        }  # a step may be compiled as one kernel instead
        self.values["config"] = self._scalars("config", self._settings)

    def _coefficients(self) -> dict[str, float]:
        return {name: uniform(self.model.numpy(name.replace("uniform", "shape"))) for name in UNIFORM}

    @property
    def stale(self) -> bool:
        """Whether the shapes have other coefficients in common than when settings were last taken."""
        return any(self._settings[name] != value for name, value in self._coefficients().items())

    def _scalars(self, name: str, values: Mapping[str, Any]) -> Any:
        table = {"config": CONFIG, "launch": LAUNCH}[name]
        return self._groups.group(name, float_name(self.model.dtype), table, values)

    def launch_values(self, first: int, changed: Mapping[str, Any]) -> dict[str, Any]:
        """Arguments for the worlds from ``first`` on, with ``changed`` settings or numbers of the launch."""
        # empty lanes write zeros to a padding body: one for each shard, or threads would share its cache line
        shard = next((i for i, (a, n) in enumerate(self._shards.ranges) if a <= first < a + n), 0)
        width, in_turn = self._past
        launch = {
            "world_offset": first,
            "padding_body": self.model.body_count + PADDING * shard,
            "past_offset": width * (shard if in_turn else first),
            "past_step": 0 if in_turn else width,
            "resume": 0,
            "pause": NEVER,
            "cut": self._shards.cut_flag if on_numpy(self.model.backend) else self._cut_address,
            "team": self._shards.teams[shard] if self.model.device == "cpu" else 0,
            "scratch": self._scratch_address(first),
            **{name: value for name, value in changed.items() if name in LAUNCH},
        }
        values = {**self.values, "launch": self._scalars("launch", launch)}
        settings = {name: value for name, value in changed.items() if name not in launch}
        if settings:
            values["config"] = self._scalars("config", {**self._settings, **settings})
        return values

    def _scratch_address(self, first: int) -> int:
        """Memory of a shard, as others run at once; a recorded graph has it longer than settings keep its launches."""
        if self.model.device != "cpu" or not BACKENDS[self.model.backend].teams:
            return 0
        if first not in self._scratch:
            self._scratch[first] = aligned_zeros((SCRATCH,), np.dtype(np.uint8))
        return int(self._scratch[first].ctypes.data)

    def bind_checked(self, name: Any, first: Any, count: Any, changed: Any) -> Launch:
        """What ``bind`` returns, for arguments of a user: those of the many launches of a step need no checks.

        Raises:
            TypeError, ValueError: for another kernel, worlds that are not there, or something else to change.
        """
        check_choice("name", name, self.kernels)
        first, count, worlds = check_whole("first", first), check_whole("count", count), self.model.world_count
        if first + count > worlds:
            raise ValueError(f"first is {first} and count is {count}; their sum must be at most {worlds}, all worlds")
        if not isinstance(changed, Mapping):
            raise WrongType(f"changed is {shown(changed)}; it must be a mapping of names to values")
        for key in changed:
            check_choice("a key of changed", key, (*CONFIG, *LAUNCH))
        return self.bind(name, first, count, changed)

    def bind(self, name: str, first: int, count: int, changed: Mapping[str, Any]) -> Launch:
        """A launch of a kernel over the worlds first .. first + count, one thread each; with ``changed`` arguments."""
        launch = bind(self.kernels[name], count, self.launch_values(first, changed), self.model.device)
        if hasattr(launch, "kept"):
            launch.kept = (self._shards, self._scratch)  # whose memory it has by address
        return launch
