"""Contact problems in Delassus form, u = W r + q, and their solvers.

A problem comes from arrays (``DelassusProblem``), from contacts of any engine (``from_contacts``, or ``from_solver`` of
an existing ``ContactSolver``), or from a simulation between ``collide`` and ``advance`` (``from_world``). ``solve``
solves it; ``refine`` continues the solve of a simulation to a smaller tolerance. A name is imported from its module
when it is first used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from dc_kernels.runtime.imports import lazy_names

if TYPE_CHECKING:
    from dc_kernels.delassus.problem import DelassusProblem, assemble_blocks
    from dc_kernels.delassus.search import METHODS, DelassusSolution, Method
    from dc_kernels.delassus.solver import solve, warmup
    from dc_kernels.delassus.world import (
        from_contacts,
        from_solver,
        from_world,
        read_impulses,
        refine,
        write_impulses,
    )

__all__ = [
    "METHODS",
    "DelassusProblem",
    "DelassusSolution",
    "Method",
    "assemble_blocks",
    "from_contacts",
    "from_solver",
    "from_world",
    "read_impulses",
    "refine",
    "solve",
    "warmup",
    "write_impulses",
]

# public names by the module that defines them
_MODULES = {
    "problem": ("DelassusProblem", "assemble_blocks"),
    "search": ("METHODS", "DelassusSolution", "Method"),
    "solver": ("solve", "warmup"),
    "world": ("from_contacts", "from_solver", "from_world", "read_impulses", "refine", "write_impulses"),
}
__getattr__, __dir__ = lazy_names(__name__, _MODULES)
