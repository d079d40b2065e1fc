"""2D rigid-body contact as Warp kernels: many worlds at once, on one core or many.

    import dc_kernels as dc

    builder = dc.ModelBuilder()
    builder.add_world()
    ground = builder.add_body(type=dc.BodyType.STATIC)
    builder.add_box(ground, half_width=10.0, half_height=0.5, center=(0.0, -0.5))
    ball = builder.add_body(position=(0.0, 1.0))
    builder.add_disc(ball, radius=0.5)
    sim = dc.Simulation(*builder.finalize())
    sim.run(steps=100, dt=0.01)

Only numpy and warp-lang are needed. ``operators``, ``sph_operators`` and ``sweep_operators`` hold the torch operators,
``delassus`` and ``delassus_world`` contact problems in Delassus form; all else is here. A name is imported when it is
first used, so importing the package costs next to nothing; ``types.py`` holds the conventions and the name of every
array.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .arrays import Contacts, Joints, Model, State, to_numpy, to_torch
    from .builder import ModelBuilder
    from .grid import Grid, GridChoice, choose_grid, shared_cells
    from .images import Images
    from .measure import kinetic_energy, overlap, potential_energy
    from .neighbors import Neighbors, neighbor_lists, neighbor_pairs
    from .solver import SolveStats
    from .sph import sph_density, sph_sum
    from .step import Simulation
    from .transfer import Transfer, gather, splat
    from .types import LANES, BodyType, Flag, ShapeType, SolverConfig

__version__ = "0.1.0"

__all__ = [
    "LANES",
    "BodyType",
    "Contacts",
    "Flag",
    "Grid",
    "GridChoice",
    "Images",
    "Joints",
    "Model",
    "ModelBuilder",
    "Neighbors",
    "ShapeType",
    "Simulation",
    "SolveStats",
    "SolverConfig",
    "State",
    "Transfer",
    "choose_grid",
    "gather",
    "kinetic_energy",
    "neighbor_lists",
    "neighbor_pairs",
    "overlap",
    "potential_energy",
    "shared_cells",
    "sph_density",
    "sph_sum",
    "splat",
    "to_numpy",
    "to_torch",
]

# public names by the module that defines them
_MODULES = {
    "arrays": ("Contacts", "Joints", "Model", "State", "to_numpy", "to_torch"),
    "builder": ("ModelBuilder",),
    "grid": ("Grid", "GridChoice", "choose_grid", "shared_cells"),
    "images": ("Images",),
    "measure": ("kinetic_energy", "overlap", "potential_energy"),
    "neighbors": ("Neighbors", "neighbor_lists", "neighbor_pairs"),
    "solver": ("SolveStats",),
    "sph": ("sph_density", "sph_sum"),
    "step": ("Simulation",),
    "transfer": ("Transfer", "gather", "splat"),
    "types": ("LANES", "BodyType", "Flag", "ShapeType", "SolverConfig"),
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
