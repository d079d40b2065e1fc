"""What every scene has: a material, gravity, and one world for each seed."""

from __future__ import annotations

import ast
import inspect
import itertools
import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Annotated, Any, ClassVar, cast

import numpy as np

import dc_kernels as dc
from dc_kernels.model.settings import Limits, NotNegative, Positive, Settings
from dc_kernels.runtime.inputs import check_count
from dc_kernels.runtime.memory import check_memory
from pipeline.seeds import check_seed, check_seeds

WORLD, BODY = 3e3, 1e3  # memory of a world and of a body while they are built, about [B]


def parameter_docs(scene: type[Scene]) -> dict[str, tuple[str, str]]:
    """Return what each parameter of a scene is and its unit, from the strings that stand below the fields.

    A parameter whose class has no source, or whose string ends without a unit in brackets, has the unit "not stated".
    """
    docs = {field.name: ("parameter of the scene", "not stated") for field in fields(scene)}
    for cls in reversed(scene.__mro__):
        if not issubclass(cls, Scene):
            continue
        try:
            tree = ast.parse(textwrap.dedent(inspect.getsource(cls)))
        except (OSError, TypeError, SyntaxError):
            continue
        for item, text in itertools.pairwise(cast(ast.ClassDef, tree.body[0]).body):
            if not (isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name)):
                continue
            if isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant) and item.target.id in docs:
                found = re.fullmatch(r"(.*?)\.?(?: \[([^\[\]]+)\]\.?)?", " ".join(str(text.value.value).split()))
                meaning, unit = found.groups() if found else ("parameter of the scene", None)
                docs[item.target.id] = meaning, unit or "not stated"
    return docs


@dataclass(frozen=True, kw_only=True)
class Scene(Settings):
    """Options that every scene has, and the worlds that it builds."""

    name: ClassVar[str]

    def __init_subclass__(cls) -> None:
        """Let errors name the scene."""
        cls.settings_prefix = f"{getattr(cls, 'name', cls.__name__)}."

    friction: NotNegative = 0.5
    """Coulomb coefficient of all shapes [1]."""
    restitution: Annotated[float, Limits(least=0.0, most=1.0)] = 0.0
    """Coefficient of restitution of all shapes, 0 to 1 [1]."""
    density: Positive = 1.0
    """Mass per area of all shapes [kg/m^2]."""
    gravity: float = 9.8
    """Downward acceleration [m/s^2]."""

    @property
    def count(self) -> int:
        """About how many bodies a world has [1]."""
        return int(getattr(self, "bodies", 1))

    @property
    def material(self) -> dict[str, Any]:
        """Keywords of ``ModelBuilder.add_*`` for the shapes' material."""
        return {"friction": self.friction, "restitution": self.restitution, "density": self.density}

    def build(self, worlds: int = 1, seed: int = 0) -> dc.ModelBuilder:
        """Build one world for each of the seeds ``seed .. seed + worlds - 1``.

        Raises:
            TypeError, ValueError: for ``worlds`` < 1, or ``seed`` < 0.
        """
        worlds, seed = check_count("worlds", worlds), check_seed("seed", seed)
        check_seeds(seed, worlds)
        check_memory(f"worlds is {worlds}, of {self.count} bodies each: they", worlds * (WORLD + BODY * self.count))
        builder = dc.ModelBuilder()
        self.add_worlds(builder, [np.random.Generator(np.random.PCG64(seed + i)) for i in range(worlds)])
        return builder

    def add_worlds(self, builder: dc.ModelBuilder, streams: Sequence[np.random.Generator]) -> None:
        """Add one world for each random stream."""
        for stream in streams:
            builder.add_world(gravity=(0.0, -self.gravity))
            self.add_bodies(builder, stream)

    def add_bodies(self, builder: dc.ModelBuilder, stream: np.random.Generator) -> None:
        """Fill the world just begun."""
        raise NotImplementedError

    def add_static_chain(self, builder: dc.ModelBuilder, vertices: Sequence[tuple[float, float]]) -> int:
        """Add a static body with a chain of segments; returns the body."""
        body = builder.add_body(type=dc.BodyType.STATIC)
        material = self.material
        del material["density"]
        builder.add_chain(body, vertices, **material)
        return body

    def add_open_box(self, builder: dc.ModelBuilder, width: float, height: float) -> int:
        """Add left wall, floor and right wall as a static body, which is returned; the floor begins at (0, 0)."""
        return self.add_static_chain(builder, [(0.0, height), (0.0, 0.0), (width, 0.0), (width, height)])
