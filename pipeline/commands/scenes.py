"""The command ``scenes``."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Any

import dc_kernels as dc
from dc_kernels.model.settings import NotNegative
from pipeline.commands.common import Common
from pipeline.files import check_writable
from pipeline.options import RunOptions
from pipeline.plots.scenes import scenes_figure
from pipeline.plots.style import save_figure
from pipeline.process import progress_bar
from pipeline.scenes import SCENES, Scene
from pipeline.scenes.base import parameter_docs

PICTURE = "scenes.png"


@dataclass(frozen=True, kw_only=True)
class Scenes(Common):
    """List the scenes, including those of plugins, with their parameters; optionally draw each by its defaults."""

    out: Path | None = None
    """Folder of scenes.png, made if missing; without it nothing is run and drawn."""
    seconds: NotNegative = 2.0
    """Time that a scene is run before it is drawn [s]."""

    def __call__(self) -> dict[str, Any]:
        scenes = {name: described(scene) for name, scene in SCENES.items()}
        result: dict[str, Any] = {"scenes": scenes}
        if self.out is not None:
            result["path"] = str(draw(self.out, self.seconds, progress=not self.json))
        if not self.json:
            print("\n".join(f"{name:<{max(map(len, scenes))}}  {each['meaning']}" for name, each in scenes.items()))
            print(*([result["path"]] if "path" in result else []), sep="\n", end="")
        return result


def described(scene: type[Scene]) -> dict[str, Any]:
    """Say what a scene is, about how many bodies it has by default, and what its parameters are."""
    docs, values = parameter_docs(scene), {field.name: default(field) for field in fields(scene)}
    return {
        "meaning": " ".join(inspect.cleandoc(scene.__doc__ or "").partition("\n\n")[0].split()),
        "bodies": None if MISSING in values.values() else scene().count,
        "parameters": {
            name: {"default": None if value is MISSING else value, "meaning": docs[name][0], "unit": docs[name][1]}
            for name, value in values.items()
        },
    }


def default(field: Any) -> Any:
    """Return the default of a dataclass's field, or ``MISSING``."""
    return field.default if field.default_factory is MISSING else field.default_factory()


def draw(out: Path, seconds: float, progress: bool) -> Path:
    """Run the scenes that need no parameter, draw them into a folder, and return the picture's path.

    Raises:
        OSError: the folder cannot be written.
    """
    check_writable(out, PICTURE)
    names = [name for name, scene in SCENES.items() if MISSING not in map(default, fields(scene))]
    run = RunOptions()

    def simulations() -> Iterator[dc.Simulation]:
        for name in progress_bar(names, desc="scenes", unit="scene", show=progress):
            sim = run.simulation(SCENES[name](), dc.SolverConfig())
            sim.run(round(seconds / run.dt), run.dt)
            yield sim

    save_figure(scenes_figure(names, simulations()), out / PICTURE, dpi=90)
    return out / PICTURE
