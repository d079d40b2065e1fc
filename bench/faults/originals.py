"""The files that are made hostile: a small one of each kind that is read, in a folder of its own."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

DT = 0.01
NAMES = {
    "snapshot": "file.h5",
    "populated snapshot": "file.h5",
    "shard": "shard-00001.h5",
    "resumed shard": "shard-00001.h5",
    "index": "index.h5",
    "trajectory": "trajectory.h5",
    "fclib": "file.hdf5",
    "checkpoint": "file.safetensors",
    "training": "file.safetensors",
    "contactnet": "file.safetensors",
    "stepper": "file.safetensors",
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
    from pipeline.starts import registry as start_registry
    from pipeline.stepper import registry as stepper_registry

    sim = scene()
    sim.run(60, DT)
    (folder / "snapshot").mkdir(parents=True)
    sim.save(folder / "snapshot" / "file.h5")
    (folder / "populated snapshot").mkdir()
    populated().save(folder / "populated snapshot" / "file.h5")
    for name, path in (("contactnet", start_registry.PRETRAINED), ("stepper", stepper_registry.PRETRAINED)):
        (folder / name).mkdir()
        shutil.copyfile(path, folder / name / NAMES[name])
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


def populated() -> Any:
    """Two worlds with joints of all kinds, traits, roles, events, sleepers, and what came and went."""
    import dc_kernels as dc

    builder = dc.ModelBuilder()
    for _ in range(2):
        builder.add_world()
        ground = builder.add_body(type=dc.BodyType.STATIC)
        builder.add_box(ground, 8.0, 0.5, center=(0.0, -0.5), surface_speed=0.1, rolling_resistance=0.05)
        builder.add_box(ground, 0.5, 0.5, center=(3.0, 0.5), sensor=True)
        builder.add_box(ground, 0.5, 0.1, center=(-3.0, 2.0), one_way=(0.0, 1.0))
        builder.add_chain(ground, [(-8.0, 3.0), (-8.0, 0.0)], one_sided=True)
        builder.add_discs([(-2.0 + 1.1 * i, 0.5) for i in range(4)], 0.5, angular_damping=0.1)
        builder.add_discs([(3.0, 2.0)], 0.4, sensor=[False], gravity_scale=0.5)
        links = [builder.add_body((-4.0 + i, 6.0)) for i in range(9)]
        for link in links:
            builder.add_box(link, 0.3, 0.1)
        ends = iter(zip([ground, *links], links))
        builder.add_distance_joint(*next(ends), frequency=2.0, damping_ratio=0.5, lower=0.1, upper=9.0)
        builder.add_rope_joint(*next(ends), max_length=2.0)
        builder.add_revolute_joint(*next(ends), lower=-1.0, upper=1.0, motor_speed=0.5, max_motor_torque=2.0)
        builder.add_prismatic_joint(*next(ends), (1.0, 0.0), lower=-0.5, upper=0.5, break_force=1e6)
        builder.add_weld_joint(*next(ends))
        builder.add_wheel_joint(*next(ends))
        builder.add_target_joint(ground, links[6], max_force=10.0)
        builder.add_gear_joint(links[6], links[7], -2.0)
        builder.add_general_joint(links[7], links[8], (0.0, 1.0, 0.0), (0.0, -1.0, 0.0))
    config = dc.SolverConfig(sleep=True, contact_events=True, contact_switches=True)
    sim = dc.Simulation(*builder.finalize(), config=config)
    sim.run(30, DT)
    sim.remove(bodies=[1], joints=[0])
    more = sim.additions(1)
    more.add_disc(more.add_body((6.0, 0.5)), 0.5)
    sim.add(more)
    sim.reserve(bodies=3, shapes=3)
    sim.run(30, DT)
    sim.sleep([int(sim.index(bodies=2)[0])])
    sim.step(DT)
    return sim


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
