"""Losses, the parts of a training loop, trainings on a small data set, and starts from what they made."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
from dataclasses import fields, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

torch = pytest.importorskip("torch")
torch.set_num_threads(1)
import safetensors.torch  # noqa: E402

import dc_kernels as dc  # noqa: E402
from dc_kernels.grid.grid import Grid  # noqa: E402
from dc_kernels.learn.differentiable import ContactProblem  # noqa: E402
from dc_kernels.measure import contact_slots  # noqa: E402
from pipeline.cli import main  # noqa: E402
from pipeline.data import dataset  # noqa: E402
from pipeline.data.generate import generate  # noqa: E402
from pipeline.data.recipe import GenerateOptions, Recipe  # noqa: E402
from pipeline.data.splatter import Splatter  # noqa: E402
from pipeline.networks import models  # noqa: E402
from pipeline.networks.checkpoint import load_checkpoint, save_checkpoint  # noqa: E402
from pipeline.scenes import Mixed, Thesis  # noqa: E402
from pipeline.seeds import HELD_OUT_SEED  # noqa: E402
from pipeline.starts.grid_network import GridNetworkStart  # noqa: E402
from pipeline.starts.registry import maker  # noqa: E402
from pipeline.training import grid as grid_training  # noqa: E402
from pipeline.training import losses  # noqa: E402
from pipeline.training.grid import train_grid_network  # noqa: E402
from pipeline.training.log import Log  # noqa: E402
from pipeline.training.optimizer import (  # noqa: E402
    check_loss,
    clip_gradients,
    make_optimizer,
    make_schedule,
)
from pipeline.training.options import TrainOptions  # noqa: E402
from pipeline.training.processes import Processes, seed_everything  # noqa: E402
from pipeline.training.rate import find_rate  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]
SCENE = Thesis(bodies=6)
PNG = b"\x89PNG"


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    """Eight worlds of six discs that fall and settle."""
    out = tmp_path_factory.mktemp("data")
    generate(Recipe(scene=SCENE, options=GenerateOptions(worlds=8, steps=70)), out, threads=1, progress=False)
    return out


@pytest.fixture(scope="module")
def batch(data):
    """States of several worlds, in a batch."""
    return next(iter(dataset.loader(data, batch_size=12, seed=1)))


@pytest.fixture
def undrawn(monkeypatch) -> None:
    """Trainings without their pictures, which take longer than they do."""
    monkeypatch.setattr(grid_training, "save_figure", lambda figure, path: path.write_bytes(PNG))


def options(data: Path, out: Path, **changes) -> TrainOptions:
    """A training of a second or two."""
    small = {"width": 0.25, "nodes": 17, "stride": 8, "batch_size": 8, "epochs": 2, "log_every": 2}
    return TrainOptions(data=data, out=out, **{**small, **changes})


def settled(scene, worlds: int = 3, steps: int = 60, dtype: str = "float32") -> dc.Simulation:
    """A simulation between collide and solve."""
    sim = dc.Simulation(*scene.build(worlds, 0).finalize(dtype))
    sim.run(steps, 0.01)
    sim.collide(0.01)
    return sim


def as_batch(sim: dc.Simulation) -> SimpleNamespace:
    """The step in flight as the losses read it from a batch."""
    slots, world = contact_slots(sim.contacts)
    contacts, model, state = sim.contacts, sim.model, sim.state
    shown = {name: contacts.numpy(name)[slots] for name in ("normal", "gap", "friction", "restitution", "color")}
    shown |= {name: contacts.numpy(name)[slots].astype(np.int64) for name in ("body_a", "body_b")}
    shown["point"] = state.numpy("position")[shown["body_a"]] + contacts.numpy("arm_a")[slots]
    shown |= {name: state.numpy(name).copy() for name in ("position", "velocity", "angular_velocity")}
    shown |= {name: model.numpy(name) for name in ("mass", "inertia", "gravity")}
    shown["body_start"] = model.numpy("body_start").astype(np.int64)
    shown["contact_start"] = np.searchsorted(world, np.arange(model.world_count + 1))
    shown["dt"] = np.full(model.world_count, 0.01, model.dtype)
    return SimpleNamespace(**{name: torch.from_numpy(np.array(values)) for name, values in shown.items()})


# ---------------------------------------------------------------------- losses


@pytest.mark.parametrize("scene", [Thesis(bodies=20), Thesis(bodies=20, restitution=0.4), Mixed(bodies=15)])
def test_a_batch_is_the_problem_that_the_solver_solves(scene):
    """Rows, their order and their biases, with and without bounces."""
    sim = settled(scene, steps=90)
    slop = sim.config.slop * float(sim.model.numpy("length_scale")[0])
    if isinstance(scene, Mixed):  # each world has a typical length of its own
        sim = settled(scene, worlds=1, steps=90)
    wanted = ContactProblem.from_simulation(sim)
    found, order = losses.contact_problem(as_batch(sim), slop)
    assert torch.equal(torch.from_numpy(contact_slots(sim.contacts)[0])[order], wanted.slot)
    assert len(order) > 20
    assert len(wanted.bias.unique()) > 5
    for name in ("body_a", "body_b", "normal", "arm_a", "arm_b", "friction", "inv_mass", "inv_inertia", "velocity"):
        torch.testing.assert_close(getattr(found, name), getattr(wanted, name), rtol=1e-5, atol=1e-6, check_dtype=False)
    torch.testing.assert_close(found.bias, wanted.bias, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize(("bins", "reverse"), [(1, True), (1, False), (4, True)])
def test_the_decoder_reads_what_the_simulation_reads(bins, reverse):
    sim = settled(Thesis(bodies=30), steps=110)
    images = dc.Images(sim, Grid.thesis(), bodies=(), bins=bins)
    image = torch.randn(3, 2 * bins, 61, 61, generator=torch.Generator().manual_seed(0))
    decode = losses.Decoder(grid=Grid.thesis(), bins=bins, reverse=reverse)
    found = decode(image, as_batch(sim))
    images.start_from(image, reverse=reverse)
    wanted = sim.contacts.numpy("impulse")[contact_slots(sim.contacts)[0]]
    np.testing.assert_allclose(found, wanted, atol=1e-6)
    assert np.abs(wanted).max() > 0.1


def make_loss(name: str, **changes) -> losses.Loss:
    decode = losses.Decoder(grid=GRID, reverse=False)
    scales = {"grid_scale": torch.tensor([1.0, 2.0]), "contact_scale": torch.tensor([1.0, 4.0])}
    return losses.Loss(name=name, decode=decode, **{**scales, **changes})


GRID = Grid.from_box((0.0, 0.0), (SCENE.side, SCENE.side), SCENE.side / 20)


def test_losses_have_their_formulas(batch):
    shape = (len(batch), 2, *GRID.shape)
    output, target = (torch.randn(shape, generator=torch.Generator().manual_seed(i)) for i in range(2))
    error = (output - target) / torch.tensor([1.0, 2.0])[:, None, None]
    for name, wanted in (("grid_mse", error.square().mean()), ("grid_mae", error.abs().mean())):
        total, weight = make_loss(name)(output, target, batch)
        torch.testing.assert_close(total / weight, wanted)
    loss = make_loss("contact_mse")
    impulse = loss.decode(output, batch)
    total, weight = loss(output, target, batch)
    torch.testing.assert_close(total / weight, ((impulse - batch.label) / torch.tensor([1.0, 4.0])).square().mean())
    problem, order = losses.contact_problem(batch)
    total, weight = make_loss("energy")(output, target, batch)
    torch.testing.assert_close(total, problem.energy((impulse - batch.label)[order].contiguous()).sum())
    torch.testing.assert_close(weight, problem.energy(batch.label[order]).sum())


@pytest.mark.parametrize("name", ["contact_mse", "energy", "sweeps"])
def test_at_the_labels_a_loss_on_contacts_vanishes(batch, name):
    """For "sweeps" nearly: the label is not solved to round-off, and sweeps go on."""
    total, weight = make_loss(name).of_impulses(batch.label, batch)
    zero, _ = make_loss(name).of_impulses(torch.zeros_like(batch.label), batch)
    assert float(total) <= (1e-4 * float(zero) if name == "sweeps" else 0.0)
    assert weight > 0


def test_more_sweeps_leave_less(batch):
    zero = torch.zeros_like(batch.label)
    left = [float(make_loss("sweeps", sweeps=k).of_impulses(zero, batch)[0]) for k in (0, 5, 50)]
    assert left[0] > 2.0 * left[1] > 4.0 * left[2] > 0.0
    assert left[0] == pytest.approx(float(batch.label.square().sum()))


@pytest.mark.parametrize("name", ["grid_mse", "grid_mae", "contact_mse", "energy", "sweeps"])
def test_the_gradient_is_the_slope_of_the_loss(batch, name):
    """Along itself, in float64, by central differences."""
    batch = double(batch)
    generator = torch.Generator().manual_seed(0)
    shape = (len(batch.dt), 2, *GRID.shape)
    output = (0.1 * torch.randn(shape, generator=generator, dtype=torch.float64)).requires_grad_()
    target = torch.randn(shape, generator=generator, dtype=torch.float64)
    loss = make_loss(name, leak=0.0, sweeps=3)

    def value(image):
        total, weight = loss(image, target, batch)
        return total / weight

    value(output).backward()
    with torch.no_grad():
        direction = output.grad / output.grad.norm()
        step = 1e-7
        slope = (value(output + step * direction) - value(output - step * direction)) / (2.0 * step)
    assert float(slope) == pytest.approx(float(output.grad.norm()), rel=1e-4)
    assert float(slope) > 0.0


def double(batch) -> SimpleNamespace:
    """A batch in float64."""
    values = {f.name: getattr(batch, f.name) for f in fields(batch)}
    return SimpleNamespace(**{n: v.double() if v.dtype == torch.float32 else v for n, v in values.items()})


@pytest.mark.parametrize("name", ["contact_mse", "energy", "sweeps"])
def test_a_batch_in_parts_has_the_loss_of_the_whole(data, name):
    states = dataset.States(data, "train", stride=5)
    loss = make_loss(name)
    whole, first, second = (states.batch(range(*part)) for part in ((0, 12), (0, 5), (5, 12)))
    totals = [loss.of_impulses(part.start, part) for part in (whole, first, second)]
    for one, two, three in zip(*totals):
        torch.testing.assert_close(two + three, one)


def test_an_unknown_loss_is_refused():
    with pytest.raises(ValueError, match=r"loss is 'mse'; it must be one of \('grid_mse', 'grid_mae', 'contact_mse'"):
        make_loss("mse")


# ---------------------------------------------------------------------- parts of the loop


def test_sgd_takes_the_steps_of_nesterov():
    """Momentum m v + g, then x - rate (g + m v) (Sutskever et al. 2013), with the seed's momentum, and a decay."""
    x = torch.tensor([1.0, -2.0], dtype=torch.float64, requires_grad=True)
    optimizer = make_optimizer([x], "sgd", 0.01)
    schedule = make_schedule(optimizer, "decay", 100, decay=1e-2)
    place, momentum = x.detach().clone(), torch.zeros(2, dtype=torch.float64)
    for step in range(4):
        optimizer.zero_grad()
        (x**3).sum().backward()
        gradient = 3.0 * place**2
        momentum = 0.9 * momentum + gradient
        place = place - 0.01 / (1.0 + 1e-2 * step) * (gradient + 0.9 * momentum)
        optimizer.step()
        schedule.step()
        torch.testing.assert_close(x.detach(), place)


def rates(name: str, steps: int = 50) -> list[float]:
    optimizer = make_optimizer([torch.zeros(1, requires_grad=True)], "adamw", 0.1)
    schedule = make_schedule(optimizer, name, steps)
    found = []
    for _ in range(steps):
        found.append(optimizer.param_groups[0]["lr"])
        optimizer.step()
        schedule.step()
    return found


def test_one_cycle_goes_up_and_down():
    found = np.array(rates("onecycle"))
    top = int(found.argmax())
    assert found[top] == pytest.approx(0.1, rel=0.01)
    assert 10 <= top <= 20
    assert (np.diff(found[:top]) > 0).all()
    assert (np.diff(found[top + 1 :]) < 0).all()
    assert found[0] == pytest.approx(0.1 / 25)
    assert found[-1] < 1e-4
    assert set(rates("constant")) == {0.1}


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda p: make_optimizer(p, "adam", 1.0),
            r"optimizer is 'adam'; it must be one of \('sgd', 'adamw'\)",
        ),
        (lambda p: make_optimizer(p, "sgd", 0.0), "rate is 0.0; it must be finite and > 0"),
        (lambda p: make_optimizer(p, "sgd", math.nan), "rate is nan"),
        (lambda p: make_schedule(make_optimizer(p, "sgd", 1.0), "steps", 5), "schedule is 'steps'"),
        (lambda p: make_schedule(make_optimizer(p, "sgd", 1.0), "decay", 0), "steps is 0"),
        (lambda p: seed_everything(-1), "seed is -1"),
        (lambda p: check_loss(torch.tensor(math.inf), 17), "the loss of step 17 is inf"),
    ],
)
def test_parts_out_of_range_are_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call([torch.zeros(1, requires_grad=True)])


def test_gradients_are_cut_and_a_broken_one_stops():
    weight = torch.zeros(4, requires_grad=True)
    weight.grad = torch.full((4,), 3.0)
    assert clip_gradients([weight], None, 0) == 6.0
    assert clip_gradients([weight], 1.5, 0) == 6.0
    assert float(weight.grad.norm()) == pytest.approx(1.5, rel=1e-4)
    weight.grad[1] = math.nan
    with pytest.raises(ValueError, match="the gradient of step 5 is nan"):
        clip_gradients([weight], 1.5, 5)


class Bowl(torch.nn.Module):
    """A parabola for a network, of batches that differ in height: plain SGD diverges beyond 2 / curvature."""

    CURVATURE = 50.0

    def __init__(self):
        super().__init__()
        self.x = torch.nn.Parameter(torch.tensor([1.0]))

    def loss(self, i):
        scale = 10.0 ** (i % 3)
        return scale * (1.0 + 0.5 * self.CURVATURE / scale * self.x.square().sum())


def test_the_rate_finder_stays_below_divergence_and_leaves_no_trace():
    bowl = Bowl()
    optimizer = make_optimizer(bowl.parameters(), "sgd", 1.0, momentum=0.0)
    state = torch.get_rng_state()
    search = find_rate(bowl, optimizer, bowl.loss, lowest=1e-5, highest=10.0, steps=100)
    assert float(bowl.x.detach()) == 1.0
    assert torch.equal(torch.get_rng_state(), state)
    assert 0.2 / Bowl.CURVATURE / 10.0 < search.rate < 2.0 / Bowl.CURVATURE
    assert 2.0 / Bowl.CURVATURE < search.rates[-1] < 10.0  # it saw where it diverges, and went no further
    assert search.losses[0] == pytest.approx(1.0, rel=1e-2)
    with pytest.raises(ValueError, match="the loss of batch 0 is nan before any step"):
        find_rate(bowl, optimizer, lambda i: bowl.loss(i) * math.nan)
    with pytest.raises(ValueError, match=r"rates are 1\.0 to 0\.1"):
        find_rate(bowl, optimizer, bowl.loss, lowest=1.0, highest=0.1)


def test_a_log_that_goes_on_drops_what_came_after(tmp_path):
    log = Log(tmp_path)
    for step in (5, 10, 15):
        log.add(step, {"train/loss": 1.0 / step})
    log.close()
    with (tmp_path / "metrics.jsonl").open("a") as file:
        file.write('{"step": 20, "tra')  # a killed run's half line
    log = Log(tmp_path, 10)
    log.add(12, {"train/loss": 0.5})
    log.close()
    rows = [json.loads(line) for line in (tmp_path / "metrics.jsonl").read_text().splitlines()]
    assert [row["step"] for row in rows] == [5, 10, 12]
    assert log.series("train/loss") == ([5, 10, 12], [0.2, 0.1, 0.5])
    assert list((tmp_path / "tensorboard").iterdir())


# ---------------------------------------------------------------------- trainings


@pytest.mark.parametrize(("network", "rate"), [("convfc", 0.05), ("pressure", 0.02), ("peak", 5e-3), ("unet", 5e-3)])
def test_a_training_writes_whole_files_and_learns(data, tmp_path, network, rate):
    """Of the same few states, seen again and again, the network learns some."""
    chosen = options(data, tmp_path, stride=20, epochs=12, dropout=0.0, loss="contact_mse", log_every=3, rate=rate)
    summary = train_grid_network(network, chosen, progress=False)
    names = {"best.safetensors", "last.safetensors", "training.safetensors", "metrics.jsonl", "train.json"}
    pictures = {"curves.png", "predictions.png"}
    assert {path.name for path in tmp_path.iterdir()} == {*names, *pictures, "tensorboard"}
    assert set(summary["files"]) == names | pictures
    assert all((tmp_path / name).read_bytes()[:4] == PNG for name in pictures)

    def refuse(text):
        raise AssertionError(text)

    assert json.loads((tmp_path / "train.json").read_text(), parse_constant=refuse)["steps"] == summary["steps"] == 36
    rows = [json.loads(line) for line in (tmp_path / "metrics.jsonl").read_text().splitlines()]
    losses = [row["train/loss"] for row in rows if "train/loss" in row]
    assert len(losses) == 12
    assert np.mean(losses[-3:]) < 0.9 * losses[0]
    assert summary["metrics"]["loss_grid"] < 0.7 * summary["metrics"]["loss_zero"]
    model, manifest = load_checkpoint(tmp_path / "best.safetensors", network=network)
    assert manifest["data"]["seeds"] == [0, 8]
    assert manifest["data"]["config"]["scene"]["bodies"] == 6
    assert {"torch", "warp-lang", "safetensors"} <= set(manifest["versions"])
    assert manifest["metrics"]["loss"] == summary["best_loss"]
    assert float(model.input_bound) == grid_training.BOUND
    assert (model.input_scale[1:] != 1.0).all()


def trained(out: Path) -> dict[str, torch.Tensor]:
    """All that a training has come to: weights, momenta, generator."""
    return safetensors.torch.load_file(out / "training.safetensors")


def logged(out: Path) -> list[dict]:
    return [json.loads(line) for line in (out / "metrics.jsonl").read_text().splitlines()]


def assert_same_training(one: Path, two: Path) -> None:
    first, second = trained(one), trained(two)
    assert first.keys() == second.keys()
    assert len(first) > 20
    for name, tensor in first.items():
        assert torch.equal(tensor, second[name]), name
    assert logged(one) == logged(two)
    last = [safetensors.torch.load_file(out / "best.safetensors") for out in (one, two)]
    assert all(torch.equal(tensor, last[1][name]) for name, tensor in last[0].items())


RESUMED = [
    ("convfc", {}),
    ("peak", {"schedule": "decay", "optimizer": "sgd"}),
    ("unet", {"loss": "sweeps", "sweeps": 2}),
]


@pytest.mark.parametrize(("network", "changes"), RESUMED)
def test_a_training_interrupted_and_resumed_has_the_bits_of_one_that_was_not(
    data, tmp_path, monkeypatch, undrawn, network, changes
):
    """Ctrl-C in the middle of an epoch, then once more: batch norm, dropped values, schedules and order go on."""
    whole, parts = options(data, tmp_path / "whole", **changes), options(data, tmp_path / "parts", **changes)
    assert train_grid_network(network, whole, progress=False)["complete"]
    learn = grid_training.GridTraining.learn

    def interrupted(self, batch, stop=False):
        if self.step in (2, 7):
            signal.raise_signal(signal.SIGINT)
        return learn(self, batch, stop or self.step in (2, 7))

    monkeypatch.setattr(grid_training.GridTraining, "learn", interrupted)
    summary = train_grid_network(network, parts, progress=False)
    assert (summary["complete"], summary["steps"]) == (False, 3)
    assert "predictions.png" not in summary["files"]  # no epoch is over
    summary = train_grid_network(network, replace(parts, resume=True), progress=False)
    assert (summary["complete"], summary["steps"]) == (False, 8)
    monkeypatch.setattr(grid_training.GridTraining, "learn", learn)
    summary = train_grid_network(network, replace(parts, resume=True), progress=False)
    assert summary["complete"]
    assert_same_training(tmp_path / "whole", tmp_path / "parts")


def test_a_killed_training_goes_on_from_its_last_save(data, tmp_path, monkeypatch, undrawn):
    whole, parts = (options(data, tmp_path / name, find_rate=True) for name in ("whole", "parts"))
    chosen = train_grid_network("pressure", whole, progress=False)["choices"]["rate"]
    learn = grid_training.GridTraining.learn

    def killed(self, batch, stop=False):
        if self.step == 5:
            raise MemoryError
        return learn(self, batch, stop)

    monkeypatch.setattr(grid_training.GridTraining, "learn", killed)
    with pytest.raises(MemoryError):
        train_grid_network("pressure", replace(parts, save_every=3), progress=False)
    monkeypatch.setattr(grid_training.GridTraining, "learn", learn)
    summary = train_grid_network("pressure", replace(parts, resume=True), progress=False)
    assert summary["choices"]["rate"] == chosen != 1e-3
    assert (tmp_path / "parts" / "rates.png").read_bytes()[:4] == PNG
    assert_same_training(tmp_path / "whole", tmp_path / "parts")


def test_a_finished_training_stays_as_it_is(data, tmp_path, undrawn):
    chosen = options(data, tmp_path, epochs=1)
    train_grid_network("pressure", chosen, progress=False)
    before = trained(tmp_path)
    summary = train_grid_network("pressure", replace(chosen, resume=True), progress=False)
    assert summary["complete"]
    assert all(torch.equal(tensor, before[name]) for name, tensor in trained(tmp_path).items())


def test_a_loss_that_is_not_finite_stops_with_the_last_save_whole(data, tmp_path, undrawn):
    chosen = options(data, tmp_path, optimizer="sgd", schedule="constant", rate=1e12, save_every=1)
    with pytest.raises(ValueError, match=r"the (loss|gradient) of step \d+ is (nan|inf|-inf)"):
        train_grid_network("pressure", chosen, progress=False)
    model, _ = load_checkpoint(tmp_path / "last.safetensors")
    assert all(torch.isfinite(weight).all() for weight in model.parameters())


def test_another_training_is_not_continued(data, tmp_path, undrawn):
    chosen = options(data, tmp_path, epochs=1)
    train_grid_network("pressure", chosen, progress=False)
    for network, changes, message in (
        ("pressure", {"batch_size": 4}, "was trained with batch_size = 8; this run has 4"),
        ("pressure", {"nodes": 15}, "was trained with rows = 17; this run has 15"),
        ("pressure", {"loss": "energy"}, "was trained with loss = 'grid_mse'; this run has 'energy'"),
        ("unet", {}, "was trained with network = 'pressure'; this run has 'unet'"),
    ):
        with pytest.raises(ValueError, match=message):
            train_grid_network(network, replace(chosen, resume=True, **changes), progress=False)
    with pytest.raises(FileNotFoundError, match=r"training\.safetensors is not there"):
        train_grid_network("pressure", replace(chosen, resume=True, out=tmp_path / "other"), progress=False)


def test_held_out_worlds_are_never_trained_on(tmp_path):
    recipe = Recipe(scene=SCENE, options=GenerateOptions(worlds=2, steps=40, seed=HELD_OUT_SEED))
    generate(recipe, tmp_path / "data", threads=1, progress=False)
    with pytest.raises(ValueError, match=f"has worlds of seeds from {HELD_OUT_SEED} on"):
        train_grid_network("pressure", options(tmp_path / "data", tmp_path / "out"), progress=False)
    assert not (tmp_path / "out").exists()


def test_a_loss_that_would_miss_the_bias_of_overlaps_is_refused(tmp_path):
    solver = dc.SolverConfig(position_correction="baumgarte")
    recipe = Recipe(scene=SCENE, options=GenerateOptions(worlds=2, steps=40), solver=solver)
    generate(recipe, tmp_path / "data", threads=1, progress=False)
    with pytest.raises(ValueError, match="loss is 'sweeps', which does not know the velocity bias that overlaps had"):
        train_grid_network("pressure", options(tmp_path / "data", tmp_path / "out", loss="sweeps"), progress=False)


@pytest.mark.parametrize(
    ("network", "changes", "message"),
    [
        ("lenet", {}, r"network is 'lenet'; it must be one of \('convfc', 'pressure', 'peak', 'unet'\)"),
        ("unet", {"epochs": 0}, "epochs is 0; it must be >= 1"),
        ("unet", {"decay": -1.0}, "decay is -1.0; it must be finite and >= 0"),
        ("unet", {"walls": math.inf}, "walls is inf"),
        ("unet", {"clip": 0.0}, "clip is 0.0; it must be > 0"),
        ("unet", {"validation": 1.0}, r"validation is 1.0; it must lie in \(0, 1\)"),
        ("unet", {"find_rate": True, "rate": 0.1}, "rate is 0.1, and find_rate asks for another one"),
        ("unet", {"batch_size": 10_000}, "has fewer training states than a batch of 10000"),
        ("unet", {"rate": 0.0}, "rate is 0.0; it must be finite and > 0"),
        ("unet", {"nodes": 1}, "nodes is 1; it must be >= 8"),
        ("unet", {"h": 0.0}, "h is 0.0"),
        ("unet", {"data": Path("nowhere")}, "nowhere has no index.h5"),
    ],
)
def test_options_out_of_range_are_refused(data, tmp_path, network, changes, message):
    with pytest.raises(ValueError, match=message):
        train_grid_network(network, options(**{"data": data, "out": tmp_path / "out", **changes}), progress=False)
    assert not (tmp_path / "out").exists()


def test_the_command_trains_and_prints(data, tmp_path, capsys, undrawn):
    arguments = ["train", "unet", "--data", str(data), "--out", str(tmp_path), "--width", "0.25", "--nodes", "17"]
    arguments += ["--stride", "20", "--epochs", "1", "--batch-size", "8", "--cached"]
    assert main(arguments) == 0
    text = capsys.readouterr().out
    assert "validation loss: last" in text
    assert "squared error of tangential impulses" in text
    manifest = load_checkpoint(tmp_path / "best.safetensors")[1]
    assert manifest["images"]["contacts"] == ["impulse_n", "impulse_t"]
    assert main([*arguments, "--json", "--resume"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["complete"]


RANKS = """
import sys
from pathlib import Path
from safetensors.torch import save_file
from pipeline.training import grid as grid_training
from pipeline.training.options import TrainOptions

train_grid_network = grid_training.train_grid_network

class Run(grid_training.GridTraining):
    def finish(self, began):
        weights = {name: tensor.contiguous() for name, tensor in self.model.state_dict().items()}
        save_file(weights, Path(sys.argv[2]) / f"rank{self.group.rank}.safetensors")
        return super().finish(began)

grid_training.GridTraining = Run
train_grid_network("pressure", TrainOptions(data=Path(sys.argv[1]), out=Path(sys.argv[2]), **SETTINGS), progress=False)
"""


def test_two_processes_train_as_one(data, tmp_path, undrawn):
    """Contacts differ from share to share, and the mean over the whole batch's is what counts."""
    settings = {"width": 0.5, "nodes": 17, "stride": 8, "batch_size": 8, "epochs": 2, "loss": "contact_mse"}
    settings.update(optimizer="sgd", schedule="decay", rate=0.02)
    out = tmp_path / "two"
    out.mkdir()
    script = tmp_path / "ranks.py"
    script.write_text(RANKS.replace("SETTINGS", repr(settings)))
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2", str(script)]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
    run = subprocess.run([*command, str(data), str(out)], env=environment, capture_output=True, text=True, timeout=120)
    assert run.returncode == 0, run.stderr
    first, second = (safetensors.torch.load_file(out / f"rank{rank}.safetensors") for rank in range(2))
    for name, tensor in first.items():
        assert torch.equal(tensor, second[name]), name
    alone = TrainOptions(data=data, out=tmp_path / "one", **settings)
    summary = train_grid_network("pressure", alone, progress=False)
    assert json.loads((out / "train.json").read_text())["steps"] == summary["steps"]
    fresh = models.build("pressure", load_checkpoint(out / "last.safetensors")[0].config).state_dict()
    for name, tensor in load_checkpoint(tmp_path / "one" / "last.safetensors")[0].state_dict().items():
        torch.testing.assert_close(
            first[name], tensor, rtol=1e-4, atol=1e-6, msg=lambda text, name=name: f"{name}: {text}"
        )
        if name.endswith("weight"):
            assert (fresh[name] - tensor).abs().max() > 1e-3  # round-off is not all that was compared
    with pytest.raises(ValueError, match="batch_size is 7; 2 processes cannot share it evenly"):
        grid_training.GridTraining("pressure", replace(alone, batch_size=7), Processes(0, 2))


# ---------------------------------------------------------------------- starts


@pytest.fixture(scope="module")
def checkpoint(data, tmp_path_factory) -> Path:
    """A network at the beginning of its training."""
    out = tmp_path_factory.mktemp("begun")
    chosen = options(data, out, bins=3, h=0.7, walls=50.0)
    begun = grid_training.GridTraining("pressure", chosen, Processes())
    begun.log.close()
    save_checkpoint(out / "begun.safetensors", begun.model, begun.manifest())
    return out / "begun.safetensors"


def test_in_a_simulation_a_network_reads_and_writes_what_it_was_trained_on(data, checkpoint):
    """The same worlds simulated anew: pixels of ``Images``, answer and start impulses are those of the data set."""
    model, manifest = load_checkpoint(checkpoint)
    step = 50
    sim = dc.Simulation(*SCENE.build(8, 0).finalize(), config=Recipe().solver)
    sim.run(step, 0.01)
    sim.collide(0.01)
    start = GridNetworkStart(sim, model, manifest)
    start.write()
    found = sim.contacts.numpy("impulse")[contact_slots(sim.contacts)[0]]
    states = dataset.States(data, min_contacts=0)
    batch = states.batch([70 * world + step for world in range(8)])
    grid = start.images.grid
    splatter = Splatter(grid, **manifest["images"])
    decode = losses.Decoder(grid=grid, reverse=manifest["decode"]["reverse"], h=0.7, bins=3)
    with torch.inference_mode():
        wanted = decode(model(splatter(batch)[0]), batch)
    assert len(wanted) > 30
    np.testing.assert_allclose(found, wanted, rtol=1e-4, atol=1e-5)


class Fixed(torch.nn.Module):
    """Answers the same to whatever it is shown, and remembers where that lay."""

    def __init__(self, answer):
        super().__init__()
        self.answer, self.seen = answer, []

    def forward(self, images):
        self.seen.append((images.data_ptr(), len(images)))
        return self.answer[: len(images)]


MANIFEST = {
    "grid": {"rows": 61, "columns": 61, "spacing": 0.25, "origin": [0.0, 0.0]},
    "images": {"bodies": ["mass"], "contacts": ["normal_x"], "walls": 100.0},
    "decode": {"reverse": True},
}


def test_the_network_sees_the_images_where_they_lie_and_no_world_without_contacts():
    builder = dc.ModelBuilder()
    for height in (0.5, 8.0, 0.5):
        builder.add_world(gravity=(0.0, -9.8))
        builder.add_chain(builder.add_body(type=dc.BodyType.STATIC), [(0, 15), (0, 0), (15, 0), (15, 15)])
        builder.add_discs([(7.5, height), (3.0, height)], radius=0.5)
    sim = dc.Simulation(*builder.finalize())
    model = Fixed(torch.ones(3, 2, 61, 61))
    start = GridNetworkStart(sim, model, MANIFEST)
    sim.step(0.01, start=start)
    assert [count for _, count in model.seen] == [2]
    assert (start.calls, start.skipped, start.dropped) == (2, 1, 0)
    sim.run(150, 0.01, start=start)
    model.seen.clear()
    sim.step(0.01, start=start)  # by now all have landed
    assert model.seen == [(start.images.tensor().data_ptr(), 3)]
    calls = start.calls
    lifted = sim.state.numpy("position").copy()
    lifted[sim.model.numpy("body_type") == dc.BodyType.DYNAMIC] += (0.0, 5.0)
    sim.state.assign("position", lifted)
    sim.step(0.01, start=start)
    assert start.calls == calls


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_world_whose_answer_is_not_finite_starts_from_its_cache(bad):
    sim = settled(Thesis(bodies=20), steps=90)
    slots, world = contact_slots(sim.contacts)
    cached = sim.contacts.numpy("impulse")[slots].copy()
    answer = torch.zeros(3, 2, 61, 61)
    answer[1, 0, :30] = bad
    start = GridNetworkStart(sim, Fixed(answer), MANIFEST)
    start.write()
    found = sim.contacts.numpy("impulse")[slots]
    np.testing.assert_array_equal(found, np.where(world[:, None] == 1, cached, 0.0))
    assert start.dropped == 1
    assert np.abs(cached[world == 1]).max() > 0.01


def test_a_start_changes_the_sweeps_but_not_the_answer(checkpoint):
    config = dc.SolverConfig(tolerance=1e-7, max_sweeps=5000)
    sims = [dc.Simulation(*SCENE.build(4, 50).finalize(), config=config) for _ in range(2)]
    start = maker(str(checkpoint))(sims[0])
    for _ in range(60):
        sims[0].step(0.01, start=start)
        sims[1].step(0.01)
    assert start.calls > 10
    for name in ("position", "velocity"):
        np.testing.assert_allclose(sims[0].state.numpy(name), sims[1].state.numpy(name), atol=2e-3)


def test_what_cannot_start_a_simulation_is_refused(tmp_path):
    sim = settled(Thesis(bodies=5), worlds=1, steps=0)
    save_checkpoint(tmp_path / "a.safetensors", models.build("pressure", {"width": 0.1}), {"grid": MANIFEST["grid"]})
    with pytest.raises(ValueError, match="the manifest has no 'images': the network was not trained on images"):
        maker(str(tmp_path / "a.safetensors"))(sim)
    double = settled(Thesis(bodies=5), worlds=1, steps=0, dtype="float64")
    with pytest.raises(ValueError, match=r"sim\.dtype is float64; networks answer in float32"):
        GridNetworkStart(double, Fixed(torch.zeros(1)), MANIFEST)
    start = GridNetworkStart(sim, Fixed(torch.zeros(1)), MANIFEST)
    with pytest.raises(ValueError, match="the start was made for another simulation"):
        start(double)
