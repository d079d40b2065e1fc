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

It needs only numpy and warp-lang. ``torch_ops`` has the torch operators,
``delassus`` contact problems in Delassus form; all other public names are here. A name is imported at its
first use, so importing the package takes next to no time; ``model/fields.py`` has the conventions and the name of
every array.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from dc_kernels.runtime.imports import lazy_names

if TYPE_CHECKING:
    from dc_kernels import delassus, func
    from dc_kernels.collide.broadphase import Broadphase
    from dc_kernels.collide.color import color
    from dc_kernels.collide.narrowphase import Narrowphase
    from dc_kernels.collide.shapes import ShapeBoxes
    from dc_kernels.driving.additions import Additions
    from dc_kernels.driving.contacts import (
        ContactEvents,
        contact_forces,
        joint_forces,
        joint_reactions,
        net_contact_forces,
    )
    from dc_kernels.driving.events import contact_events, sensor_events
    from dc_kernels.events.lists import Overlaps, PairList, Touches
    from dc_kernels.grid.grid import Grid, GridChoice, choose_grid, shared_cells
    from dc_kernels.grid.image_spec import ImageSpec
    from dc_kernels.grid.images import Images
    from dc_kernels.grid.stencil import Stencil
    from dc_kernels.grid.transfer import Transfer, gather, splat
    from dc_kernels.measure import contact_slots, kinetic_energy, overlap, potential_energy
    from dc_kernels.model.arrays import Contacts, Model, State, to_numpy, to_torch
    from dc_kernels.model.builder import ModelBuilder
    from dc_kernels.model.config import SolverConfig
    from dc_kernels.model.enums import BodyType, Flag, JointKind, JointPart, ShapeRole, ShapeType
    from dc_kernels.model.joints.groups import Joints
    from dc_kernels.neighbors.search import Neighbors, neighbor_lists, neighbor_pairs
    from dc_kernels.neighbors.stage import NeighborSearch
    from dc_kernels.queries.queries import Closest, Hits, Queries
    from dc_kernels.simulation import Simulation
    from dc_kernels.solve.contacts import ContactSolver
    from dc_kernels.solve.rows import LANES
    from dc_kernels.solve.storage import SolveStats
    from dc_kernels.sph.sums import sph_density, sph_sum

__version__ = "0.1.0"

__all__ = [
    "LANES",
    "Additions",
    "BodyType",
    "Broadphase",
    "Closest",
    "ContactEvents",
    "ContactSolver",
    "Contacts",
    "Flag",
    "Grid",
    "GridChoice",
    "Hits",
    "ImageSpec",
    "Images",
    "JointKind",
    "JointPart",
    "Joints",
    "Model",
    "ModelBuilder",
    "Narrowphase",
    "NeighborSearch",
    "Neighbors",
    "Overlaps",
    "PairList",
    "Queries",
    "ShapeBoxes",
    "ShapeRole",
    "ShapeType",
    "Simulation",
    "SolveStats",
    "SolverConfig",
    "State",
    "Stencil",
    "Touches",
    "Transfer",
    "choose_grid",
    "color",
    "contact_events",
    "contact_forces",
    "contact_slots",
    "delassus",
    "func",
    "gather",
    "joint_forces",
    "joint_reactions",
    "kinetic_energy",
    "neighbor_lists",
    "neighbor_pairs",
    "net_contact_forces",
    "overlap",
    "potential_energy",
    "sensor_events",
    "shared_cells",
    "sph_density",
    "sph_sum",
    "splat",
    "to_numpy",
    "to_torch",
]

# public names by the module that defines them
_MODULES = {
    "": ("delassus", "func"),
    "collide.broadphase": ("Broadphase",),
    "collide.color": ("color",),
    "collide.narrowphase": ("Narrowphase",),
    "collide.shapes": ("ShapeBoxes",),
    "driving.additions": ("Additions",),
    "driving.contacts": ("ContactEvents", "contact_forces", "joint_forces", "joint_reactions", "net_contact_forces"),
    "driving.events": ("contact_events", "sensor_events"),
    "events.lists": ("Overlaps", "PairList", "Touches"),
    "grid.grid": ("Grid", "GridChoice", "choose_grid", "shared_cells"),
    "grid.image_spec": ("ImageSpec",),
    "grid.images": ("Images",),
    "grid.stencil": ("Stencil",),
    "grid.transfer": ("Transfer", "gather", "splat"),
    "measure": ("contact_slots", "kinetic_energy", "overlap", "potential_energy"),
    "model.arrays": ("Contacts", "Model", "State", "to_numpy", "to_torch"),
    "model.builder": ("ModelBuilder",),
    "model.config": ("SolverConfig",),
    "model.enums": ("BodyType", "Flag", "JointKind", "JointPart", "ShapeRole", "ShapeType"),
    "model.joints.groups": ("Joints",),
    "neighbors.search": ("Neighbors", "neighbor_lists", "neighbor_pairs"),
    "neighbors.stage": ("NeighborSearch",),
    "queries.queries": ("Closest", "Hits", "Queries"),
    "simulation": ("Simulation",),
    "solve.contacts": ("ContactSolver",),
    "solve.rows": ("LANES",),
    "solve.storage": ("SolveStats",),
    "sph.sums": ("sph_density", "sph_sum"),
}
__getattr__, __dir__ = lazy_names(__name__, _MODULES)
