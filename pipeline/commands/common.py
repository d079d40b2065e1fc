"""What the commands share."""

from __future__ import annotations

import functools
import operator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from dc_kernels.model.settings import Settings
from pipeline.scenes import SCENES, Scene


def scene_types() -> Any:
    """Return the union of the scenes that are known by now, those of plugins among them, each under its name."""
    from tyro import conf

    named = [Annotated[cls, conf.subcommand(name)] for name, cls in SCENES.items()]  # type: ignore[valid-type]
    return functools.reduce(operator.or_, named)


try:
    from tyro.conf import Positional as Positional
    from tyro.conf import UseAppendAction as Several
    from tyro.conf import arg

    SceneOption = Annotated[Scene, arg(constructor_factory=scene_types)]
except ImportError:  # cli.parse() says what is missing
    Positional = Several = Annotated  # type: ignore[assignment,misc]
    SceneOption = Scene  # type: ignore[misc]


@dataclass(frozen=True, kw_only=True)
class Common(Settings):
    """Options of every command."""

    json: bool = False
    """Print one line of JSON at the end, and no progress bar."""
    plugin: Several[tuple[Path, ...]] = ()
    """Python file that is run first and registers scenes, starts or networks."""
