"""Arrays and numbers of a first-order solve, as its kernels take them: the problem, what is asked, what is in flight.

Numbers are those of the problem in its own units (``DelassusProblem.units``), in which the diagonal of W is about 1 and
|q| = 1, so that no constant of a kernel depends on units.
"""

from __future__ import annotations

import functools
from enum import IntEnum
from typing import Any

from dc_kernels.model.arrays import ArrayGroup
from dc_kernels.model.fields import field_table
from dc_kernels.runtime.backends import kernel_file


class Acceleration(IntEnum):
    """What is done between two sweeps."""

    NONE = 0
    AITKEN = 1
    NNCG = 2
    ANDERSON = 3
    HYBRID = 4


class Reason(IntEnum):
    """Why a solve ended."""

    SWEEPS = 0
    CONVERGED = 1
    STALLED = 2


PROBLEM = field_table(
    ("row_start", "contact+1", "int32", "1", "first block of each contact's row of W"),
    ("column", "block", "int32", "1", "contact whose impulse a block takes"),
    ("block", "block", "vec4", "1", "nn, nt, tn, tt of each block of W"),
    ("q", "contact", "vec2", "1", "normal and tangential velocity without impulses"),
    ("mu", "contact", "real", "1", "Coulomb coefficient"),
    ("low", "contact", "real", "1", "least normal impulse: 0, or FREE where there is no bound"),
    ("inverse", "contact", "vec2", "1", "1 over the diagonal of W; 0 for a tangent without friction"),
    ("couple", "contact", "real", "1", "tn of the diagonal of W"),
)

SEARCH = field_table(
    ("impulse", "contact", "vec2", "1", "normal and tangential impulses, from the start on"),
    ("best", "contact", "vec2", "1", "impulses of the least natural map at any look"),
    ("step", "contact", "vec2", "1", "what the last sweep changed the impulses by"),
    ("direction", "contact", "vec2", "1", "conjugate direction; of momentum: impulses after the sweep before"),
    ("history", "look", "vec2", "1", "natural map and scaled map at each look, as far as there is room"),
)

# What Anderson's acceleration looks back on; other methods have none.
MEMORY = field_table(
    ("end", "contact", "vec2", "1", "impulses at the end of the sweep before"),
    ("end_step", "contact", "vec2", "1", "its step"),
    ("end_change", "remembered contact", "vec2", "1", "changes of the ends of sweeps"),
    ("step_change", "remembered contact", "vec2", "1", "changes of their steps"),
    ("product", "window,window", "real", "1", "scalar products of the changes of steps"),
    ("factor", "window,window", "real", "1", "Cholesky factor of the products"),
    ("weight", "window", "real", "1", "of each change in the combination"),
)

SETTINGS = field_table(
    ("scale", "launch", "real", "1", "what makes an impulse one of the problem as given, with its velocity in |q|"),
    ("method", "launch", "int32", "1", "Acceleration"),
    ("max_sweeps", "launch", "int32", "1", "sweeps at most"),
    ("every", "launch", "int32", "1", "sweeps between two looks at the natural maps"),
    ("patience", "launch", "int32", "1", "looks without gain that end the solve; 0: none do"),
    ("gain", "launch", "real", "1", "share that a map falls to where it gains"),
    ("tolerance", "launch", "real", "1", "of the natural map"),
    ("scaled_tolerance", "launch", "real", "1", "of the scaled map"),
    ("omega", "launch", "real", "1", "relaxation of a sweep"),
    ("aitken_period", "launch", "int32", "1", "least sweeps of an Aitken period"),
    ("aitken_period_max", "launch", "int32", "1", "most sweeps of an Aitken period"),
    ("aitken_cap", "launch", "real", "1", "largest multiple of a step that an extrapolation adds"),
    ("aitken_threshold", "launch", "real", "1", "ratio of two periods' steps above which the next is longer"),
    ("window", "launch", "int32", "1", "earlier sweeps that Anderson's combination takes"),
    ("growth", "launch", "real", "1", "of the squared step, at which Anderson's last combination is taken back"),
    ("cut", "launch", "uint64", "1", "address of an int32: not 0 ends the solve; 0 for none"),
)

PROGRESS = field_table(
    ("sweeps", "solve", "int32", "1", "sweeps done"),
    ("looks", "solve", "int32", "1", "looks at the natural maps"),
    ("reason", "solve", "int32", "1", "Reason"),
    ("least", "solve", "real", "1", "least map over its tolerance"),
    ("mark", "solve", "real", "1", "map over its tolerance at the last gain"),
    ("marked", "solve", "int32", "1", "look of the last gain"),
    # Aitken's extrapolation:
    ("period", "solve", "int32", "1", "sweeps of the present period"),
    ("inside", "solve", "int32", "1", "sweeps done in it"),
    ("before_end", "solve", "real", "1", "squared step of the sweep before the period's last"),
    ("at_end", "solve", "real", "1", "squared step at the end of the period before"),
    # nonlinear conjugate gradients:
    ("last_step", "solve", "real", "1", "squared step of the sweep before"),
    # Anderson's acceleration:
    ("filled", "solve", "int32", "1", "changes remembered"),
    ("newest", "solve", "int32", "1", "place of the latest of them; -1: none"),
    ("fresh", "solve", "int32", "1", "1 where no sweep before is known"),
    ("kept_step", "solve", "real", "1", "squared step of the sweep that is gone back to"),
    # momentum:
    ("momentum", "solve", "real", "1", "Nesterov's t"),
    ("moved", "solve", "int32", "1", "sweeps with momentum since the last look at whether it helps"),
    ("travelled", "solve", "real", "1", "squared step at that look"),
    ("plain", "solve", "int32", "1", "sweeps without momentum to come"),
    ("next_plain", "solve", "int32", "1", "sweeps without momentum when it next does not help"),
)


class PackedProblem(ArrayGroup):
    """A problem in its own units (``PROBLEM``)."""

    table = PROBLEM
    scale: float
    """What makes an impulse one of the problem as given, with its velocity in |q|."""

    @functools.cached_property
    def idle(self) -> dict[Acceleration, list[Any]]:
        """First-order solves that nobody runs, by their acceleration (``first_order.lent``)."""
        return {}

    @functools.cached_property
    def struct(self) -> Any:
        """The arrays as kernels take them."""
        return kernel_file(self.backend, "groups").array_group(self, "delassus_problem")


class SearchState(ArrayGroup):
    """Impulses of a first-order solve and what it measures (``SEARCH``)."""

    table = SEARCH


class SearchMemory(ArrayGroup):
    """What Anderson's acceleration looks back on (``MEMORY``)."""

    table = MEMORY
