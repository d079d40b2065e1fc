"""The scenes by name. A new one is a class in a file of its own and its name in ``AnyScene``."""

from __future__ import annotations

from dataclasses import fields
from typing import Any, get_args

from dc_kernels.model.settings import check_choice
from pipeline.scenes.base import Scene
from pipeline.scenes.boxes import Pyramid, Stack
from pipeline.scenes.chain import Chain
from pipeline.scenes.discs import Settled, Thesis, ThesisClustered
from pipeline.scenes.incline import Incline
from pipeline.scenes.mixed import Mixed

AnyScene = Thesis | ThesisClustered | Settled | Stack | Pyramid | Incline | Mixed | Chain
SCENES: dict[str, type[Scene]] = {scene.name: scene for scene in get_args(AnyScene)}


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
