"""Contact problems in Delassus form, u = W r + q, and their solvers.

A problem comes from arrays (``DelassusProblem``), or from a simulation between ``collide`` and ``advance``
(``from_world``). ``solve`` solves it; ``refine`` takes the solve of a simulation further. A name is imported from its
module when it is first used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dc_kernels.delassus.problem import DelassusProblem, assemble_blocks
    from dc_kernels.delassus.search import METHODS, DelassusSolution
    from dc_kernels.delassus.solver import Method, solve, warmup
    from dc_kernels.delassus.world import from_world, read_impulses, refine, write_impulses

__all__ = [
    "METHODS",
    "DelassusProblem",
    "DelassusSolution",
    "Method",
    "assemble_blocks",
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
    "search": ("METHODS", "DelassusSolution"),
    "solver": ("Method", "solve", "warmup"),
    "world": ("from_world", "read_impulses", "refine", "write_impulses"),
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    """Import a public name from its module on first use (PEP 562)."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(f".{_MODULE_OF[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
