"""The files that are made hostile: a small one of each kind that is read, in a folder of its own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

DT = 0.01
NAMES = {
    "snapshot": "file.h5",
    "shard": "shard-00001.h5",
    "resumed shard": "shard-00001.h5",
    "index": "index.h5",
    "trajectory": "trajectory.h5",
    "fclib": "file.hdf5",
    "checkpoint": "file.safetensors",
    "training": "file.safetensors",
    "toml": "file.toml",
}
"""The file of each kind that is changed."""
FOLDERS = {"resumed shard": "shard"}
"""Where the original stands, if not in the folder named like the kind."""


def make_originals(folder: Path) -> None:
    """Make a small file of each kind in a folder of its own name."""
    import dc_kernels as dc
    from dc_kernels import delassus
    from pipeline.data.generate import generate
    from pipeline.data.recipe import GenerateOptions, Recipe
    from pipeline.fclib.files import FclibProblem, write_fclib
    from pipeline.options import RunOptions
    from pipeline.run.simulate import Output, simulate
    from pipeline.scenes import Thesis

    sim = scene()
    sim.run(60, DT)
    (folder / "snapshot").mkdir(parents=True)
    sim.save(folder / "snapshot" / "file.h5")
    recipe = Recipe(scene=Thesis(bodies=6), options=GenerateOptions(worlds=4, steps=8, shard_worlds=2))
    generate(recipe, folder / "shard", threads=1, progress=False)
    generate(recipe, folder / "index", threads=1, progress=False)
    simulate(Thesis(bodies=6), RunOptions(), output=Output(steps=6, out=folder / "trajectory"), progress=False)
    sim.collide(DT)
    problem = delassus.from_world(sim, 0)
    found = delassus.solve(problem).impulses
    (folder / "fclib").mkdir()
    write_fclib(
        folder / "fclib" / "file.hdf5",
        FclibProblem(problem=problem, info={"title": "a world"}, solution=found, guesses=[0.0 * found]),
    )
    (folder / "toml").mkdir()
    (folder / "toml" / "file.toml").write_text(
        "worlds = 4\nseed = 3\nsteps = 8\ndt = 0.01\nlabel_tolerance = 1e-5\nlabel_sweeps = 100\nshard_worlds = 2\n"
        "grids = false\ngrid_size = [15.0, 15.0]\ngrid_spacing = 0.25\n\n"
        '[scene]\nname = "thesis"\nbodies = 6\n\n[ranges]\nbodies = [4, 8]\n\n'
        '[solver]\nmax_sweeps = 200\ntolerance = 1e-4\nacceleration = "aitken"\n'
    )
    make_networks(folder)
    assert dc.Simulation.load(folder / "snapshot" / "file.h5").model.joint_count


def scene() -> Any:
    """Two worlds with every kind of body, shape and joint."""
    import dc_kernels as dc

    builder = dc.ModelBuilder()
    for _ in range(2):
        builder.add_world()
        ground = builder.add_body(type=dc.BodyType.STATIC)
        builder.add_chain(ground, [(0, 6), (0, 0), (6, 0), (6, 6)])
        builder.add_discs([(1.0, 0.55), (2.1, 0.55), (3.2, 0.6), (1.6, 1.6)], 0.5)
        box = builder.add_body((4.3, 0.6), velocity=(0.0, -0.5))
        builder.add_box(box, 0.4, 0.3)
        builder.add_capsule(box, (0.0, 0.0), (0.0, 0.8), 0.2)
        builder.add_box(builder.add_body((2.5, 3.0), type=dc.BodyType.KINEMATIC, velocity=(0.1, 0.0)), 0.5, 0.1)
        builder.add_distance_joint(box, ground + 1)
    return dc.Simulation(*builder.finalize())


def network() -> Any:
    """A small network with weights of its own."""
    import torch

    from pipeline.networks import models

    torch.manual_seed(0)
    model = models.build("convfc", models.GridConfig(rows=12, columns=9, channels=3, width=0.1))
    model.set_scales([1.0, 2.0, 3.0], [0.5, 0.25], bound=10.0)
    return model


def make_networks(folder: Path) -> None:
    """Save a network and the state of its training."""
    import dc_kernels as dc
    from pipeline.networks.checkpoint import save_checkpoint, save_training

    for name in ("checkpoint", "training"):
        (folder / name).mkdir()
    images = dc.ImageSpec(dc.Grid(rows=12, columns=9, spacing=0.25)).to_dict()
    model = network()
    save_checkpoint(folder / "checkpoint" / "file.safetensors", model, {"images": images, "seed": 3})
    optimizer = trained(model)
    save_training(
        folder / "training" / "file.safetensors", model, optimizer, None, {"epoch": 2, "best": 0.5}, {"seed": 3}
    )


def trained(model: Any) -> Any:
    """An optimizer that has taken a step."""
    import torch

    optimizer = torch.optim.Adam(model.parameters(), lr=1e-3)
    for parameter in model.parameters():
        parameter.grad = torch.ones_like(parameter)
    optimizer.step()
    return optimizer
