"""What a data set is made from: scene, ranges, solver, label; as options, TOML and the configuration in its files."""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

import dc_kernels as dc
from dc_kernels.grid.splat import TILED_BYTES
from dc_kernels.model.settings import Count, Positive, Seed, Settings, WrongType, field_checks, shown
from dc_kernels.runtime.imports import require
from pipeline.scenes import SCENES, Scene, Thesis
from pipeline.scenes import scene as named_scene
from pipeline.seeds import check_seeds

IMAGE_CHANNELS = 6
"""Channels of stored images, those that ``dc.Images`` has by default [1]."""
SOLVER = dc.SolverConfig.preset("accurate", min_sweeps=1)
"""Settings of the solver unless told otherwise: states are solved, and their sweeps counted, to its tolerance."""
DRAW_STREAM = 2
"""Number of the random stream of a world's seed that draws parameters; others place bodies and make random starts."""


@dataclass(frozen=True, kw_only=True)
class GenerateOptions(Settings):
    """Options of a data set other than its scene and solver."""

    worlds: Count = 1000
    """Number of worlds, with the seeds seed, seed + 1, ... [1]."""
    seed: Seed = 0
    """Seed of the first world; those from 100000 on are for tests only [1]."""
    steps: Count = 250
    """Steps of each world [1]."""
    dt: Positive = 0.01
    """Time step [s]."""
    ranges: tuple[tuple[str, float, float], ...] = ()
    """Parameters of the scene, or dt, drawn uniformly for each world from its own seed: name, low, high."""
    label_tolerance: Positive = 1e-5
    """Tolerance of the label, a further solve from the run's solution; of the same kind as the solver's tolerance [N
    s or 1]."""
    label_sweeps: Count = 1000
    """Largest number of further sweeps, after which a label is stored and marked [1]."""
    shard_worlds: Count = 25
    """Worlds of a shard [1]."""
    grids: bool = False
    """Also store images of the bodies and contacts, and of the label; otherwise they are made when they are read."""
    grid_size: tuple[float, float] = (15.0, 15.0)
    """Width and height of the region that stored images show, from (0, 0) [m]."""
    grid_spacing: Positive = 0.25
    """Distance of the nodes of stored images; the support of the kernel is twice that [m]."""

    def check(self) -> None:
        """Raise a ``ValueError`` for seeds beyond those that files hold."""
        check_seeds(self.seed, self.worlds)

    @property
    def shard_count(self) -> int:
        """Number of shards [1]."""
        return -(-self.worlds // self.shard_worlds)

    def seeds(self, number: int) -> range:
        """Return the seeds of a shard's worlds."""
        first = self.seed + number * self.shard_worlds
        return range(first, min(first + self.shard_worlds, self.seed + self.worlds))

    @property
    def grid(self) -> dc.Grid:
        """Grid of the stored images."""
        return dc.Grid.from_box((0.0, 0.0), self.grid_size, self.grid_spacing)


@dataclass(frozen=True, kw_only=True)
class Recipe(Settings):
    """All that a data set depends on."""

    scene: Scene = field(default_factory=Thesis)
    options: GenerateOptions = field(default_factory=GenerateOptions)
    solver: dc.SolverConfig = SOLVER

    def config(self) -> dict[str, Any]:
        """Return the configuration as it stands in TOML and in the files."""
        scene = {"name": self.scene.name, **asdict(self.scene)}
        ranges = {name: [low, high] for name, low, high in self.options.ranges}
        whole = {**asdict(self.options), "ranges": ranges, "scene": scene, "solver": self.solver.to_dict()}
        return json.loads(json.dumps(whole))

    @property
    def label_config(self) -> dc.SolverConfig:
        """Settings of the solver for the solves to the label."""
        options = self.options
        return replace(self.solver, tolerance=options.label_tolerance, max_sweeps=options.label_sweeps)

    def check(self) -> None:
        """Raise a ``ValueError`` that names the setting which is out of its range."""
        options, solver = self.options, self.solver
        if solver.history:
            raise ValueError("solver.history is True; a data set does not keep the history")
        if solver.sleep:
            raise ValueError(
                "solver.sleep is True; a data set holds the solves of all contacts, and sleepers have none"
            )
        if solver.soft:
            raise ValueError("solver.method is 'tgs_soft'; a data set holds solutions, and soft contacts have none")
        if solver.substeps > 1:
            raise ValueError(f"solver.substeps is {solver.substeps}; a data set holds every step: give a smaller dt")
        if solver.stop == "motion":
            raise ValueError("solver.stop is 'motion'; a data set is solved to a tolerance: 'change' or 'residual'")
        # said in full, so that the file does, too; without a stop the tolerance is the change's
        _, tolerance, relative = solver.ends_at
        stop = solver.stop or "change"
        told = replace(solver, stop=stop, tolerance=tolerance, relative_tolerance=relative)
        object.__setattr__(self, "solver", told)
        if options.label_tolerance > tolerance:
            raise ValueError(
                f"label_tolerance is {options.label_tolerance}; it must not exceed solver.tolerance {tolerance}"
            )
        known = [f.name for f in fields(self.scene) if isinstance(getattr(self.scene, f.name), int | float)]
        names = [name for name, _, _ in options.ranges]
        for name, low, high in options.ranges:
            if names.count(name) > 1:
                raise ValueError(f"ranges.{name} is given twice")
            if name not in (*known, "dt"):
                raise ValueError(f"ranges.{name}: {self.scene.name} has {(*known, 'dt')} to draw from")
            if not (np.isfinite([low, high]).all() and low <= high):
                raise ValueError(f"ranges.{name} is ({low}, {high}); it must be finite and ascend")
            if self.is_whole(name) and (low != int(low) or high != int(high)):
                raise ValueError(f"ranges.{name} is ({low}, {high}); it must be integers")
        for end in (0, 1):  # both ends of each range
            ends: dict[str, Any] = {name: self._typed(name, limits[end]) for name, *limits in options.ranges}
            replace(options, dt=ends.pop("dt", options.dt))
            replace(self.scene, **ends)
        if options.grids:
            rows, columns = options.grid.shape
            most = TILED_BYTES // (
                4 * IMAGE_CHANNELS
            )  # larger ones are splatted tile by tile, by launches of their own
            if rows * columns > most:
                raise ValueError(
                    f"grid_spacing is {options.grid_spacing}: {rows * columns} nodes; {most} can be stored"
                )

    def draw(self, seed: int) -> dict[str, float | int]:
        """Draw the parameters of the world of a seed; returns them by name."""
        drawn: dict[str, float | int] = {}
        for name, low, high in self.options.ranges:
            # a stream for each, so that another range changes nothing in those that were there
            stream = np.random.Generator(np.random.PCG64([seed, DRAW_STREAM, zlib.crc32(name.encode())]))
            whole = self.is_whole(name)
            drawn[name] = int(stream.integers(int(low), int(high) + 1)) if whole else float(stream.uniform(low, high))
        return drawn

    def is_whole(self, name: str) -> bool:
        """Tell whether a parameter that is drawn is an integer."""
        return name != "dt" and isinstance(getattr(self.scene, name), int)

    def _typed(self, name: str, value: float) -> float | int:
        """Return a value of a parameter in the type of that parameter."""
        return int(value) if self.is_whole(name) else float(value)


def load_recipe(path: Path, scene: str | None = None) -> Recipe:
    """Load a recipe from TOML: options at the top, tables scene, ranges and solver; what is missing has its default.

    Args:
        path: of the file.
        scene: name of the scene that is asked for elsewhere: the file's must be that one, where it has a name.

    Raises:
        ValueError: naming file and setting, for one that is unknown or of another type, another scene than the one
            asked for, or parameters of a scene without any name.
        OSError: when the file cannot be read.
    """
    try:
        import tomllib
    except ImportError:  # Python 3.10
        tomllib = require("tomli", "pipeline")  # type: ignore[assignment]
    try:
        with open(path, "rb") as file:
            return parse_recipe(tomllib.load(file), scene)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def parse_recipe(config: Mapping[str, Any], scene: str | None = None) -> Recipe:
    """Make the recipe of a configuration, as ``Recipe.config`` gives it, or of a part of it.

    Args:
        config: options, and the tables scene, ranges and solver.
        scene: name of the scene that is asked for elsewhere; None: the configuration's, or where there is none thesis.

    Raises:
        ValueError: naming a setting that is unknown or of another type, another scene than the one asked for, or
            parameters of a scene without any name.
    """
    options = {name: value for name, value in config.items() if name not in ("scene", "solver", "ranges")}
    parameters, ranges, solver = (_table(config, name) for name in ("scene", "ranges", "solver"))
    name = parameters.pop("name", scene)
    if scene is not None and name != scene:
        raise ValueError(f"scene.name is {shown(name)}, but {scene!r} is asked for; give one of them, or no name here")
    if name is None and parameters:
        raise ValueError(f"scene.name is missing; it must say whose {tuple(parameters)} are, one of {tuple(SCENES)}")
    default = named_scene(Thesis.name if name is None else name)
    for name, limits in ranges.items():
        if not (isinstance(limits, list | tuple) and len(limits) == 2 and all(map(_is_number, limits))):
            raise ValueError(f"ranges.{name} is {limits!r}; it must be [low, high]")
    recipe = Recipe(
        scene=_updated(default, parameters, "scene."),
        options=_updated(GenerateOptions(), {**options, "ranges": tuple((n, *v) for n, v in ranges.items())}, ""),
        solver=_updated(SOLVER, solver, "solver."),
    )
    return recipe


def _table(config: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Return a table of a configuration; an empty one where it is missing.

    Raises:
        TypeError: for what is no table.
    """
    table = config.get(name, {})
    if not isinstance(table, Mapping):
        raise WrongType(f"{name} is {shown(table)}; it must be a table")
    return dict(table)


def _updated(default: Any, values: Mapping[str, Any], prefix: str) -> Any:
    """Replace fields of a dataclass by values of a file, which must be of the types of the fields."""
    known = {f.name: getattr(default, f.name) for f in fields(default)}
    changed = {}
    for name, value in values.items():
        if name not in known:
            tables = () if prefix else ("scene", "solver")
            raise ValueError(f"{prefix}{name} is unknown; there are {(*known, *tables)}")
        changed[name] = field_checks(type(default))[name](f"{prefix}{name}", value)
    return replace(default, **changed)


def _is_number(value: Any) -> bool:
    """Tell whether a value is a number, and no truth value."""
    return isinstance(value, int | float) and not isinstance(value, bool)
