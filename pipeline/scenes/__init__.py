"""Named scenes: what stands in each world, seeded.

A scene is a frozen dataclass; ``build(worlds, seed)`` returns a ``ModelBuilder`` with one world for each of the seeds
``seed, seed + 1, ...``. A world depends on its own seed alone, not on how many are built with it.
"""

from pipeline.scenes.base import Scene
from pipeline.scenes.boxes import Pyramid, Stack
from pipeline.scenes.chain import Chain
from pipeline.scenes.discs import THESIS_BODIES, Settled, Thesis, ThesisClustered, box_side
from pipeline.scenes.incline import Incline
from pipeline.scenes.machines import BallAndChain, Bridge, Cars, Gears, JointGrid, Ragdolls
from pipeline.scenes.mixed import Mixed
from pipeline.scenes.peers import PeerWorld, to_box2d, to_pymunk
from pipeline.scenes.placement import CLEARANCE, Sampler, place_discs
from pipeline.scenes.registry import SCENES, register, scene
from pipeline.scenes.structures import Arch, CardHouse, Dominoes
from pipeline.scenes.surfaces import Conveyor, Platforms
from pipeline.scenes.tumbler import Tumbler

__all__ = [
    "CLEARANCE",
    "SCENES",
    "THESIS_BODIES",
    "Arch",
    "BallAndChain",
    "Bridge",
    "CardHouse",
    "Cars",
    "Chain",
    "Conveyor",
    "Dominoes",
    "Gears",
    "Incline",
    "JointGrid",
    "Mixed",
    "PeerWorld",
    "Platforms",
    "Pyramid",
    "Ragdolls",
    "Sampler",
    "Scene",
    "Settled",
    "Stack",
    "Thesis",
    "ThesisClustered",
    "Tumbler",
    "box_side",
    "place_discs",
    "register",
    "scene",
    "to_box2d",
    "to_pymunk",
]
