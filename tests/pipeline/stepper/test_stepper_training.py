"""Training of a stepper: what it reads is the simulation's, its truth is recorded, it learns, and resumes exactly."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import dc_kernels as dc
from dc_kernels.learn.step_channels import CHANNELS
from dc_kernels.measure import contact_slots
from pipeline.data.dataset import describe
from pipeline.networks import models
from pipeline.networks.checkpoint import load_checkpoint
from pipeline.options import RunOptions
from pipeline.scenes import Thesis
from pipeline.starts.learned import grid_of
from pipeline.stepper import network as stepnet
from pipeline.stepper.answer import answer, image_of
from pipeline.stepper.motions import read_motions
from pipeline.stepper.options import StepperTrainOptions
from pipeline.stepper.replay import Replay
from pipeline.stepper.training import StepperTraining, describe_stepper_training, train_stepper
from pipeline.stepper.view import StepReader

SMALL = (("rounds", "2"), ("hidden", "4"), ("width", "8"), ("channels", "[4, 4]"), ("near", "2"))


@pytest.fixture(autouse=True)
def one_thread():
    torch.set_num_threads(1)


def options(data: Path, out: Path, **changes) -> StepperTrainOptions:
    """A training of a second."""
    small = {"steps": 6, "batch_size": 3, "every": (1, 2), "rollout": (1, 2), "log_every": 2, "save_every": 3}
    return StepperTrainOptions(**{"data": (data,), "out": out, "sizes": SMALL, **small, **changes})


def collided(worlds: int = 3, steps: int = 90) -> dc.Simulation:
    """Worlds with contacts, between collide and solve."""
    sim = RunOptions(worlds=worlds, seed=3).simulation(Thesis(bodies=20), dc.SolverConfig.preset("accurate"))
    sim.run(steps, 0.01)
    sim.collide(0.01)
    return sim


def network() -> object:
    """A small StepNet, its answers not small."""
    torch.manual_seed(0)
    model = models.build("stepnet", {name: json.loads(value) for name, value in SMALL})
    with torch.no_grad():
        for cell in model.rounds:
            cell[-1].weight[:4] *= 10.0
    return model


def test_a_view_has_the_ways_and_the_relative_velocities_of_the_solver():
    """Solved impulses applied to a view give the solver's velocities, and leave no contact closing."""
    sim = collided()
    view = StepReader(sim, grid_of(sim, 0.5)).read()
    sim.solve()
    slots, _ = contact_slots(sim.contacts)
    impulse = torch.from_numpy(sim.contacts.numpy("impulse")[slots])
    frame = view.of_contacts()
    solved = torch.from_numpy(sim.motion.numpy("solved")[: len(view.way), :3].copy())
    found = frame.pushed(view.way * view.speed, impulse[:, 0], impulse[:, 1])
    assert float((found - solved).abs().max()) < 2e-6
    closing, _ = frame.relative(solved / view.speed)
    pressing = impulse[:, 0] > 1e-3
    assert int(pressing.sum()) > 10
    assert float((closing[pressing] + view.gap[pressing]).min()) > -0.02


def test_some_worlds_are_read_as_in_a_view_of_all():
    """The worlds 2 and 0, in this order, have their bodies, contacts and walls of the whole view."""
    sim = collided()
    reader = StepReader(sim, grid_of(sim, 0.5))
    whole, some = reader.read(), reader.read(np.array([2, 0]))
    image = whole.image(whole.of_contacts(), reader.grid)
    assert image.shape[1] == len(CHANNELS)
    torch.testing.assert_close(some.image(some.of_contacts(), reader.grid), image[[2, 0]])
    model = network()
    with torch.no_grad():
        way, part = model(whole, reader.grid)[0], model(some, reader.grid)[0]
    bodies = np.split(np.arange(len(way)), whole.body_start[1:-1].tolist())
    torch.testing.assert_close(part, way[np.concatenate([bodies[2], bodies[0]])])


def test_stepnet_keeps_momentum_between_bodies_and_impulses_on_their_cones():
    """Whatever its weights: without static bodies nothing else can change the momentum."""
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0.0, -9.8))
    builder.add_discs([(0.9 * i, 0.95 * j) for i in range(4) for j in range(3)], radius=0.5)
    sim = dc.Simulation(*builder.finalize())
    stream = np.random.default_rng(0)
    sim.state.assign("velocity", stream.normal(size=(12, 2)))
    sim.state.assign("angular_velocity", stream.normal(size=12))
    sim.collide(0.01)
    grid = grid_of(sim, 0.5)
    view = StepReader(sim, grid).read()
    with torch.no_grad():
        way, impulse = network()(view, grid)
    mass, inertia = view.mass, view.mass * view.inv_mass / view.inv_inertia
    change = way - view.way
    assert float(change.abs().max()) > 0.1
    scale = float((mass[:, None] * change).abs().sum())
    assert float((mass[:, None] * change[:, :2]).sum(dim=0).abs().max()) < 1e-5 * scale
    x, y = view.position.T
    spin = (mass * (x * change[:, 1] - y * change[:, 0]) + inertia * change[:, 2]).sum()
    assert abs(float(spin)) < 1e-4 * scale
    assert float(impulse[:, 0].min()) >= 0.0
    assert bool((impulse[:, 1].abs() <= view.friction * impulse[:, 0] + 1e-6).all())


def test_recorded_velocities_are_those_that_the_solver_leaves(data: Path):
    """From each recorded state a step of the solver leads to the next one, the one after the last step included."""
    motions = read_motions(data, "train", 0.25, 0)
    replay = Replay(motions, describe(data)["config"])
    assert replay.shortest() == 71
    for time in (45, 69):
        times = np.full(len(motions), time)
        replay.place(times)
        replay.sim.collide(replay.dt)
        replay.sim.solve()
        found = replay.sim.motion.numpy("solved")[: replay.sim.model.body_count, :3]
        np.testing.assert_allclose(found, replay.velocities(times + 1), atol=2e-3)


def test_the_gradient_of_an_answer_is_its_slope(monkeypatch):
    """Splat, U-Net, gather and head together, along one direction of the weights; without the leak of the cone."""
    monkeypatch.setattr(stepnet, "LEAK", 0.0)
    sim = collided()
    grid = grid_of(sim, 0.5)
    view = StepReader(sim, grid).read()
    model = network()
    weight = torch.randn(view.way.shape, generator=torch.Generator().manual_seed(2), dtype=torch.float64)

    def loss() -> torch.Tensor:
        return (weight * answer(model, view, grid).way).sum()

    loss().backward()
    torch.manual_seed(1)
    direction = {name: torch.randn_like(p) * p.abs().mean() for name, p in model.named_parameters()}
    slope = sum(float((p.grad * direction[name]).sum().detach()) for name, p in model.named_parameters())
    values = []
    for side in (1.0, -1.0):
        with torch.no_grad():
            for name, p in model.named_parameters():
                p += side * 1e-3 * direction[name]
            values.append(float(loss()))
            for name, p in model.named_parameters():
                p -= side * 1e-3 * direction[name]
    assert (values[0] - values[1]) / 2e-3 == pytest.approx(slope, rel=0.05)


def test_an_image_of_changes_comes_back_as_they_are_where_bodies_move_alike():
    """An average of equal values is that value, at every node near a body."""
    sim = collided()
    grid = dc.Grid.thesis()
    view = StepReader(sim, grid).read()
    change = torch.tensor([1.0, -2.0, 0.5]) * view.dynamic
    image, there = image_of(view, view.way + change, grid)
    wanted = torch.tensor([1.0, -2.0, 0.5])[None, :, None, None] * there
    torch.testing.assert_close(image * there, wanted, rtol=0.0, atol=1e-4)
    assert 0.0 < float(there.mean()) < 1.0


def test_training_learns_and_resumes_bit_for_bit(data: Path, tmp_path: Path):
    """Six steps at once, and three steps and then three more."""
    whole = train_stepper("stepnet", options(data, tmp_path / "whole", schedule="constant", rate=5e-3), progress=False)
    assert whole["complete"] and whole["metrics"]["velocity_10ms"] < 1.0
    assert f"stepnet: {whole['parameters']:,} weights" in describe_stepper_training(whole)
    part = options(data, tmp_path / "part", schedule="constant", rate=5e-3, steps=3)
    assert train_stepper("stepnet", part, progress=False)["step"] == 3
    more = options(data, tmp_path / "part", schedule="constant", rate=5e-3, resume=True)
    train_stepper("stepnet", more, progress=False)
    nets = [load_checkpoint(tmp_path / name / "last.safetensors")[0].state_dict() for name in ("whole", "part")]
    assert all(torch.equal(nets[0][name], nets[1][name]) for name in nets[0])
    rows = [json.loads(line) for line in (tmp_path / "whole" / "metrics.jsonl").read_text().splitlines()]
    assert [row["step"] for row in rows if "validation/loss" in row] == [3, 6]
    with pytest.raises(ValueError, match="was trained with rate = "):
        train_stepper("stepnet", options(data, tmp_path / "part", schedule="constant", resume=True), progress=False)


def test_another_cycle_of_the_rate_follows_a_finished_one(data: Path, tmp_path: Path):
    train_stepper("stepnet", options(data, tmp_path, steps=2, rollout=(1,)), progress=False)
    more = options(data, tmp_path, steps=4, rollout=(1,), resume=True)
    training = StepperTraining("stepnet", more)
    training.learn()
    training._save()
    training.log.close()
    with pytest.raises(ValueError, match=r"steps is 5; .* is within one cycle of 4: finish that first"):
        train_stepper("stepnet", replace(more, steps=5), progress=False)
    with pytest.raises(ValueError, match=r"steps is 2; .* has done 3 of 4: go on with as many or more"):
        train_stepper("stepnet", replace(more, steps=2), progress=False)
    summary = train_stepper("stepnet", more, progress=False)
    assert summary["complete"] and summary["step"] == 4


def test_a_step_of_training_lowers_its_own_loss(data: Path, tmp_path: Path):
    """The optimiser's step is down the slope, through a rollout of two steps of time."""
    training = StepperTraining("stepnet", options(data, tmp_path, optimizer="sgd", schedule="constant", rate=1e-3))
    replay = training.replays[0]
    times = np.full(len(replay.motions), 40)
    training.model.train()
    before = training.rollout(replay, times, 1, 2)
    training.optimizer.zero_grad()
    before.backward()
    training.optimizer.step()
    assert float(training.rollout(replay, times, 1, 2).detach()) < float(before.detach())
    training.log.close()


@pytest.mark.parametrize("loss", ["bodies", "grid"])
def test_a_network_of_the_theses_learns_from_images_to_images(data: Path, tmp_path: Path, loss: str):
    """Its file says on which grid; SGD as in the draft."""
    given = {"sizes": (), "width": 0.125, "nodes": 16, "optimizer": "sgd", "rate": 1e-3, "rollout": (1,), "steps": 3}
    made = train_stepper("unet", options(data, tmp_path, loss=loss, **given), progress=False)
    assert made["stepper"]["dt"] == pytest.approx([0.01, 0.02])
    model, manifest = load_checkpoint(tmp_path / "last.safetensors")
    assert manifest["stepper"]["grid"]["rows"] == model.config.rows
    assert (model.config.channels, model.config.outputs) == (len(CHANNELS), 3)


@pytest.mark.parametrize(
    ("network", "changes", "text"),
    [
        ("stepnet", {"loss": "grid"}, "loss is 'grid'; stepnet answers bodies"),
        ("contactnet", {"sizes": ()}, "network is 'contactnet', which reads no images"),
        ("stepnet", {"every": (40,)}, "has 71 states; every 40 x rollout 2 needs more"),
        ("stepnet", {"batch_size": 30}, "batch_size is 30; the data set has 7 worlds"),
        ("stepnet", {"sizes": (("depth", "3"),)}, "sizes.depth is no field of stepnet's own"),
    ],
)
def test_what_cannot_be_trained_is_said_before_anything_runs(data: Path, tmp_path: Path, network, changes, text):
    with pytest.raises(ValueError, match=text):
        train_stepper(network, options(data, tmp_path, **changes), progress=False)
