"""The scenes by name. A new one is a class in a file of its own and its name in ``SCENES``."""

from __future__ import annotations

import re
from dataclasses import fields
from typing import Any

from dc_kernels.model.settings import WrongType, check_choice, shown
from pipeline.scenes.base import Scene
from pipeline.scenes.boxes import Pyramid, Stack
from pipeline.scenes.chain import Chain
from pipeline.scenes.discs import Settled, Thesis, ThesisClustered
from pipeline.scenes.incline import Incline
from pipeline.scenes.machines import BallAndChain, Bridge, Cars, Gears, JointGrid, Ragdolls
from pipeline.scenes.mixed import Mixed
from pipeline.scenes.structures import Arch, CardHouse, Dominoes
from pipeline.scenes.surfaces import Conveyor, Platforms
from pipeline.scenes.tumbler import Tumbler

SCENES: dict[str, type[Scene]] = {
    scene.name: scene
    for scene in (
        Thesis,
        ThesisClustered,
        Settled,
        Stack,
        Pyramid,
        Incline,
        Mixed,
        Chain,
        Tumbler,
        CardHouse,
        Arch,
        Dominoes,
        Conveyor,
        Platforms,
        Bridge,
        Ragdolls,
        JointGrid,
        Gears,
        BallAndChain,
        Cars,
    )
}
"""The scenes that commands and data sets know, by name; ``register`` adds those of a plugin."""


def register(cls: type[Scene]) -> type[Scene]:
    """Make a scene known under its ``name``; a decorator of its class, which must be a dataclass.

    Raises:
        TypeError: it is no dataclass that derives from ``Scene``, or has no name.
        ValueError: another scene has its name.
    """
    if not (isinstance(cls, type) and issubclass(cls, Scene) and "__dataclass_fields__" in vars(cls)):
        raise WrongType(f"scene {shown(cls)} must be a dataclass that derives from Scene: @register above @dataclass")
    name = getattr(cls, "name", None)
    if not (isinstance(name, str) and re.fullmatch(r"[a-z][a-z0-9-]*", name)):
        raise WrongType(f"{cls.__name__}.name is {shown(name)}; it must be a word of small letters, digits and -")
    taken = SCENES.setdefault(name, cls)
    if (taken.__module__, taken.__qualname__) != (cls.__module__, cls.__qualname__):
        raise ValueError(f"scene {name!r} of {cls.__module__} is registered already, by {taken.__module__}")
    SCENES[name] = cls
    return cls


def scene(name: str, **parameters: Any) -> Scene:
    """Make the scene of a name with the given parameters.

    Raises:
        ValueError: for an unknown name or parameter.
    """
    check_choice("scene", name, SCENES)
    known = [f.name for f in fields(SCENES[name])]
    for parameter in parameters:
        if parameter not in known:
            raise ValueError(f"{name} has no parameter {parameter!r}; it has {tuple(known)}")
    return SCENES[name](**parameters)
