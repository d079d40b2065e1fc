"""Torch operators, networks and what the pipeline offers, and what each argument may be: for ``calls``."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator
from typing import Annotated, Any, Literal

from bench.faults.targets.simulations import Target, simulation
from bench.faults.values import Array
from dc_kernels.model.settings import Count, Limits, Positive, Seed, Whole


def torch_targets() -> Iterator[Target]:
    """Torch operators, and problems with differentiable sweeps."""
    import torch

    import dc_kernels as dc
    from dc_kernels.learn.differentiable import ContactProblem, sweeps_torch
    from dc_kernels.learn.in_flight import SolveReader
    from dc_kernels.torch_ops.sph import sph_density_torch, sph_sum_torch
    from dc_kernels.torch_ops.transfer import gather_torch, splat_torch

    grid = dc.Grid(rows=8, columns=8, spacing=1.0)
    points, values = torch.full((3, 2), 2.5), torch.ones((3, 1))
    tensor = torch.Tensor
    options = {"grid": dc.Grid, "stencil": dc.Stencil, "bins": Count, "threads": Count}
    offsets = {"start": Array(2, whole=True, optional=True), "point_bin": Array(3, whole=True, optional=True)}
    yield Target(
        "splat_torch",
        lambda: splat_torch,
        lambda: {
            "points": points,
            "values": values,
            "grid": grid,
            "bins": 2,
            "point_bin": torch.zeros(3, dtype=torch.int32),
        },
        {"points": tensor, "values": tensor, **options, **offsets},
    )
    image = torch.ones((1, 1, 8, 8))
    yield Target(
        "gather_torch",
        lambda: gather_torch,
        lambda: {"image": image, "points": points, "grid": grid},
        {"image": tensor, "points": tensor, **options, "reverse": bool, "start": offsets["start"]},
    )
    ones = torch.ones(3)
    kernel = {"h": Positive, "kernel": Literal["poly6", "spiky"], "method": Literal["hash", "tree"], "threads": Count}
    five = {"queries": tensor, "points": tensor, "values": tensor, "mass": tensor, "density": tensor}
    yield Target(
        "sph_sum_torch",
        lambda: sph_sum_torch,
        lambda: {"queries": points, "points": points, "values": values, "mass": ones, "density": ones, "h": 0.1},
        {**five, **kernel, "quantity": Literal["value", "gradient"]},
    )
    yield Target(
        "sph_density_torch",
        lambda: sph_density_torch,
        lambda: {"points": points, "mass": ones, "h": 0.1},
        {"points": tensor, "mass": tensor, **kernel},
    )

    @functools.cache
    def problem() -> Any:
        return ContactProblem.from_simulation(simulation("collide", "warp"))

    def impulse() -> dict[str, Any]:
        return {"impulse": torch.zeros((len(problem().body_a), 2)), "problem": problem(), "sweeps": 1}

    yield Target(
        "sweeps_torch",
        lambda: sweeps_torch,
        impulse,
        {
            "impulse": tensor,
            "problem": ContactProblem,
            "sweeps": Whole,
            "leak": Annotated[float, Limits(least=0.0, most=1.0)],
            "threads": Count,
        },
    )
    yield Target(
        "from_simulation",
        lambda: ContactProblem.from_simulation,
        lambda: {"sim": simulation("collide")},
        {"sim": dc.Simulation},
    )
    for name in ("energy", "natural_map", "velocities"):
        argument = "impulse_error" if name == "energy" else "impulse"
        yield Target(
            f"ContactProblem.{name}",
            functools.partial(lambda n: getattr(problem(), n), name),
            functools.partial(lambda a: {a: impulse()["impulse"]}, argument),
            {argument: tensor, "threads": Count},
            {argument: ("impulse",)},
        )
    ratio = Annotated[float, Limits(above=0.0, size=math.inf)]
    yield Target(
        "SolveReader",
        lambda: SolveReader,
        lambda: {"sim": simulation(), "grid": grid},
        {"sim": dc.Simulation, "grid": dc.Grid, "cap": ratio, "limit": ratio, "threads": Count | None},
    )


def pipeline_targets() -> Iterator[Target]:
    """Scenes, starts, recipes, data sets and networks."""
    from pipeline import scenes
    from pipeline.data.recipe import parse_recipe
    from pipeline.networks.models import build
    from pipeline.starts.registry import maker

    names = Literal[tuple(scenes.SCENES)]  # type: ignore[valid-type]
    yield Target("scene", lambda: scenes.scene, lambda: {"name": "incline"}, {"name": names}, {"name": ("scene",)})
    for name in scenes.SCENES:
        hints = {"worlds": Count, "seed": Seed}
        yield Target(f"{name}.build", functools.partial(lambda n: scenes.scene(n).build, name), dict, hints)
    yield Target("maker", lambda: maker, lambda: {"name": "none"}, {"name": str, "seed": Seed})
    tables = dict.fromkeys(("scene", "solver", "ranges"), dict)
    numbers = {"worlds": Count, "seed": Seed, "steps": Count, "dt": Positive, "shard_worlds": Count, "grids": bool}
    yield Target("recipe", lambda: lambda **config: parse_recipe(config), dict, {**numbers, **tables})
    networks = Literal["convfc", "pressure", "peak", "unet", "contactnet"]
    yield Target("build", lambda: build, lambda: {"name": "pressure"}, {"name": networks}, {"name": ("network",)})
