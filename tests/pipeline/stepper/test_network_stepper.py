"""A network in the solver's place: what it says is done, what is no good falls back, sweeps can make it exact."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

import dc_kernels as dc
from dc_kernels.learn.step_channels import CHANNELS
from pipeline.cli import main
from pipeline.networks import models
from pipeline.networks.checkpoint import load_checkpoint, save_checkpoint
from pipeline.options import RunOptions
from pipeline.scenes import Chain, Thesis
from pipeline.seeds import HELD_OUT_SEED
from pipeline.starts.impulses import Builtin
from pipeline.starts.registry import maker
from pipeline.stepper.choice import StepperOptions
from pipeline.stepper.registry import PRETRAINED, solve_maker
from pipeline.stepper.solve import NetworkStepper

CONFIG = dc.SolverConfig.preset("accurate")
STEPPER = {"stepper": {"dt": [0.01], "grid": None}}
SMALL = {"rounds": 2, "hidden": 4, "width": 8, "channels": (4, 4), "near": 2}


@pytest.fixture(autouse=True)
def one_thread():
    torch.set_num_threads(1)


def stepnet() -> object:
    """A StepNet without training: two damped Jacobi steps and some noise."""
    torch.manual_seed(0)
    return models.build("stepnet", SMALL)


def unet() -> tuple[object, dict]:
    """A network from images to images, without training, and its manifest."""
    torch.manual_seed(0)
    grid = dc.Grid.from_box((0.0, 0.0), (9.0, 9.0), 0.5)
    sizes = {"rows": grid.rows, "columns": grid.columns, "channels": len(CHANNELS), "outputs": 3, "width": 0.125}
    described = {"rows": grid.rows, "columns": grid.columns, "spacing": grid.spacing, "origin": list(grid.origin)}
    return models.build("unet", sizes), {"stepper": {"dt": [0.01], "grid": described}}


def simulation(worlds: int = 3, config: dc.SolverConfig = CONFIG, steps: int = 80) -> dc.Simulation:
    """Worlds of discs that have begun to touch."""
    sim = RunOptions(worlds=worlds, seed=3).simulation(Thesis(bodies=20), config)
    sim.run(steps, 0.01)
    return sim


def state(sim: dc.Simulation) -> dict[str, np.ndarray]:
    return {name: sim.state.numpy(name).copy() for name in ("position", "angle", "velocity", "angular_velocity")}


def same(sim: dc.Simulation, other: dc.Simulation, world: int) -> bool:
    """Whether a world has equal bits in two simulations."""
    first, last = sim.model.numpy("body_start")[world : world + 2]
    mine, theirs = state(sim), state(other)
    return all((mine[name][first:last] == theirs[name][first:last]).all() for name in mine)


def test_any_start_is_a_stepper():
    """The cached impulses as a start have the bits of the solver alone."""
    sim, plain = simulation(), simulation()
    sim.run(5, 0.01, stepper=Builtin(sim))
    plain.run(5, 0.01)
    assert all(same(sim, plain, world) for world in range(3))


def test_what_is_no_stepper_is_refused():
    sim, other = simulation(steps=0), simulation(steps=0)
    with pytest.raises(TypeError, match="stepper is 3; it must have a method solve"):
        sim.step(0.01, stepper=3)
    with pytest.raises(TypeError, match=r"start is .*; it must be callable: what has a method solve is given"):
        sim.step(0.01, start=SimpleNamespace(solve=print))
    with pytest.raises(ValueError, match="the stepper was made for another simulation"):
        sim.step(0.01, stepper=Builtin(other))


def test_without_sweeps_bodies_go_as_the_network_says():
    """Semi-implicitly: positions by the new velocities, which contacts' impulses of the network explain."""
    sim = simulation(config=replace(CONFIG, position_correction="none"))
    before = state(sim)
    sim.step(0.01, stepper=NetworkStepper(sim, stepnet(), STEPPER))
    after = state(sim)
    np.testing.assert_allclose(after["position"], before["position"] + 0.01 * after["velocity"], atol=1e-6)
    solver = simulation(config=replace(CONFIG, position_correction="none"))
    solver.step(0.01)
    difference = np.abs(after["velocity"] - state(solver)["velocity"]).max()
    assert 1e-3 < difference < 10.0
    assert float(np.abs(sim.contacts.numpy("impulse")).max()) > 1e-3


@pytest.mark.parametrize(("kind", "room"), [("stepnet", 0), ("unet", 8)])
def test_bodies_that_come_are_stepped(kind: str, room: int):
    """With and without room for them; a static one stands in the image."""
    model, manifest = (stepnet(), STEPPER) if kind == "stepnet" else unet()
    sim = simulation(2)
    if room:
        sim.reserve(bodies=room, shapes=room)
    stepper = NetworkStepper(sim, model, manifest)
    walls = stepper.reader.walls.sum(axis=(1, 2, 3))
    more = sim.additions(1)
    more.add_discs([(4.0, 9.0)], radius=0.5)
    more.add_disc(more.add_body(type=dc.BodyType.STATIC, position=(4.0, 8.0)), radius=0.45)
    sim.add(more)
    fresh = sim.clone()
    again = NetworkStepper(fresh, model, manifest)
    sim.run(2, 0.01, stepper=stepper)
    fresh.run(2, 0.01, stepper=again)
    assert (stepper.reader.walls.sum(axis=(1, 2, 3)) > walls).tolist() == [False, True]
    assert stepper.counts["calls"] == 4 and again.reader.grid.rows < 60
    if kind == "unet":  # whose grid is the manifest's
        assert all(same(sim, fresh, world) for world in range(2))
    assert np.isfinite(sim.state.numpy("position")).all()


def test_a_time_step_that_the_network_was_not_trained_on_is_reported():
    sim = simulation(1)
    stepper = NetworkStepper(sim, stepnet(), {"stepper": {"dt": [0.01, 0.02], "grid": None}})
    sim.step(0.01, stepper=stepper)
    assert "beyond" not in str(stepper.report().text)
    sim.step(0.1, stepper=stepper)
    assert "dt 0.1 s lies beyond 0.01 to 0.02 s, which the network was trained on" in str(stepper.report().text)
    with pytest.raises(ValueError, match="the manifest's dt is 'x'; it must be a list of time steps"):
        NetworkStepper(sim, stepnet(), {"stepper": {"dt": "x", "grid": None}})


def test_to_the_tolerance_the_step_is_the_solvers_whatever_the_network_says():
    """With images there are no impulses to begin with: equal bits. StepNet's are another start: to the tolerance."""
    plain, sim = simulation(), simulation()
    model, manifest = unet()
    sim.run(3, 0.01, stepper=NetworkStepper(sim, model, manifest, StepperOptions(project="tolerance")))
    plain.run(3, 0.01)
    assert all(same(sim, plain, world) for world in range(3))
    tight = replace(CONFIG, tolerance=1e-7, relative_tolerance=0.0, max_sweeps=5000)
    plain, sim = simulation(config=tight), simulation(config=tight)
    sim.step(0.01, stepper=NetworkStepper(sim, stepnet(), STEPPER, StepperOptions(project="tolerance")))
    plain.step(0.01)
    np.testing.assert_allclose(state(sim)["velocity"], state(plain)["velocity"], atol=2e-4)


@pytest.mark.parametrize("kind", ["stepnet", "unet"])
def test_sweeps_leave_no_contact_closing(kind: str):
    """Many of them, on velocities of an untrained network, those of images with a part that contacts don't make."""
    sim = simulation()
    model, manifest = (stepnet(), STEPPER) if kind == "stepnet" else unet()
    stepper = NetworkStepper(sim, model, manifest, StepperOptions(project=900, energy=1e6))
    sim.collide(0.01)
    predicted = sim.motion.numpy("predicted").copy()
    stepper.solve()
    view = stepper.reader.read()
    solved = torch.from_numpy(sim.motion.numpy("solved")[: len(view.way), :3]) / view.speed
    closing, _ = view.of_contacts().relative(solved)
    assert float((closing + view.gap).min()) > -0.05
    assert (sim.motion.numpy("predicted") == predicted).all()
    assert stepper.counts == {"calls": 3, "skipped": 0, "not_finite": 0, "too_fast": 0}


class Spoilt(torch.nn.Module):
    """Spoils the answers of a StepNet in two of three worlds: NaN in the first, ten times the speed in the second."""

    def __init__(self) -> None:
        super().__init__()
        self.model, self.network_name = stepnet(), "stepnet"
        self.config = self.model.config

    def forward(self, view, grid):
        way, impulse = self.model(view, grid)
        first, second = view.body_start[1:3].tolist()
        way[first // 2] = torch.nan
        way[first:second] *= 10.0
        return way, impulse


@pytest.mark.parametrize("project", [0, 3])
def test_worlds_whose_answer_is_no_good_fall_back_to_the_solver(project: int):
    """They have the bits of the solver's step, for two steps, the third world those of the network's."""
    sim, plain, good = simulation(), simulation(), simulation()
    stepper = NetworkStepper(sim, Spoilt(), STEPPER, StepperOptions(project=project))
    sim.run(2, 0.01, stepper=stepper)
    plain.run(2, 0.01)
    good.run(2, 0.01, stepper=NetworkStepper(good, stepnet(), STEPPER, StepperOptions(project=project)))
    assert [same(sim, plain, world) for world in range(3)] == [True, True, False]
    np.testing.assert_allclose(state(sim)["velocity"][-20:], state(good)["velocity"][-20:], atol=1e-4)
    assert (stepper.counts["not_finite"], stepper.counts["too_fast"]) == (2, 2)
    report = stepper.report()
    assert report.counts["dropped"] == 4 and "4 fell back to the solver: 2 not finite, 2 with" in report.text


def test_a_changed_model_is_read_as_it_is():
    """Masses and gravity as they are in the step, in the worlds that are asked for."""
    sim = simulation(steps=0)
    reader = NetworkStepper(sim, stepnet(), STEPPER).reader
    mass = sim.model.numpy("mass").copy()
    mass[-1] *= 2.0
    sim.change_model(mass=mass, gravity=np.tile([0.0, -4.9], (3, 1)))
    sim.collide(0.01)
    view = reader.read(np.array([2]))
    assert float(view.inv_mass[-1]) == pytest.approx(1.0 / mass[-1])
    assert float(view.mass[-1]) == pytest.approx(2.0 * float(view.mass[-2]))
    assert float(view.speed[-1, 0]) == pytest.approx(0.049)


def test_worlds_without_contacts_are_not_asked():
    """In free fall the step is the solver's, to the bit."""
    builder = dc.ModelBuilder()
    for height in (5.0, 0.5):
        builder.add_world(gravity=(0.0, -9.8))
        ground = builder.add_body(type=dc.BodyType.STATIC)
        builder.add_chain(ground, [(-5.0, 0.0), (5.0, 0.0)])
        builder.add_discs([(0.0, height)], radius=0.5)
    arrays = builder.finalize()
    sim = dc.Simulation(*arrays)
    stepper = NetworkStepper(sim, stepnet(), STEPPER)
    sim.step(0.01, stepper=stepper)
    assert (stepper.counts["calls"], stepper.counts["skipped"]) == (1, 1)
    assert sim.state.numpy("velocity")[1, 1] == np.float32(-0.098)
    assert sim.state.numpy("velocity")[3, 1] > -0.098


def test_what_a_network_cannot_step_is_refused(tmp_path: Path):
    sim = RunOptions().simulation(Chain(), CONFIG)
    with pytest.raises(ValueError, match="joints; a network steps bodies with contacts alone"):
        NetworkStepper(sim, stepnet(), STEPPER)
    with pytest.raises(ValueError, match=r"sim\.dtype is float64"):
        NetworkStepper(RunOptions(dtype="float64").simulation(Thesis(bodies=2), CONFIG), stepnet(), STEPPER)
    with pytest.raises(ValueError, match="the manifest has no 'stepper'"):
        NetworkStepper(simulation(1, steps=0), stepnet(), {})
    model, manifest = unet()
    manifest["stepper"]["grid"]["rows"] += 1
    with pytest.raises(ValueError, match="the network reads"):
        NetworkStepper(simulation(1, steps=0), model, manifest)
    with pytest.raises(TypeError, match="manifest is a NoneType; it must be the mapping"):
        NetworkStepper(simulation(1, steps=0), stepnet(), None)
    with pytest.raises(ValueError, match=r"StepNetConfig\.rounds is 1000000000; .* \[1, 1024\]"):
        models.build("stepnet", {**SMALL, "rounds": 10**9})
    fine = models.build("stepnet", {**SMALL, "spacing": 1e-5})
    with pytest.raises(MemoryError, match=r"the images of 1 worlds on a grid of \d+ x \d+ would take"):
        NetworkStepper(simulation(1, steps=0), fine, STEPPER)


@pytest.mark.parametrize(
    ("spoil", "error", "message"),
    [
        (lambda way, impulse: (way[:-1], impulse), ValueError, r"ways of shape \(\d+, 3\); it must be"),
        (lambda way, impulse: (way, impulse[1:]), ValueError, r"impulses of shape \(\d+, 2\); it must be"),
        (lambda way, impulse: (way.long(), impulse), TypeError, r"torch\.int64 for ways"),
        (lambda way, impulse: way, TypeError, "two tensors, ways and impulses"),
    ],
)
def test_what_is_no_answer_is_named(spoil, error, message, monkeypatch):
    model, sim = stepnet(), simulation(1)
    monkeypatch.setattr(model, "forward", lambda view, grid, forward=model.forward: spoil(*forward(view, grid)))
    stepper = NetworkStepper(sim, model, STEPPER)
    with pytest.raises(error, match=message):
        sim.step(0.01, stepper=stepper)


def test_an_image_of_another_shape_is_named(monkeypatch):
    (model, manifest), sim = unet(), simulation(1)
    monkeypatch.setattr(model, "forward", lambda image, forward=model.forward: forward(image)[:, :2])
    with pytest.raises(ValueError, match=r"an image of shape \(1, 2, 19, 19\); it must be \(1, 3, 19, 19\)"):
        sim.step(0.01, stepper=NetworkStepper(sim, model, manifest))


def test_a_scene_runs_with_a_network_from_the_command_line(tmp_path: Path, capsys):
    """The summary counts what it did."""
    path = tmp_path / "net.safetensors"
    save_checkpoint(path, stepnet(), STEPPER)
    command = f"simulate thesis --bodies 6 --steps 60 --out {tmp_path / 'out'} --stepper network --weights {path}"
    assert main([*command.split(), "--project", "3"]) == 0
    assert "network in the solver's place" in capsys.readouterr().out
    assert (tmp_path / "out" / "summary.png").exists()
    for more, text in (("--start cnn", "has no start"), ("--project -1", "project"), ("--energy 0.5", "energy")):
        with pytest.raises(SystemExit):
            main([*command.split(), *more.split()])
        assert text in capsys.readouterr().err
    explained = f"explain thesis --bodies 6 --stepper network --weights {path} --project tolerance --steps 60"
    assert main(explained.split()) == 0
    found = capsys.readouterr().out
    assert "rows: discs" in found and "then the solver to its tolerance\n  skipped: " in found


def test_a_stepper_is_no_start_and_its_options_are_not_the_solvers(tmp_path: Path):
    path = tmp_path / "net.safetensors"
    for model, manifest in ((stepnet(), STEPPER), unet()):
        save_checkpoint(path, model, manifest)
        with pytest.raises(
            ValueError, match=r"takes the place of the solver.* --stepper network --weights .*/net.safe"
        ):
            maker(str(path))
    for name, value in (("project", 3), ("weights", path), ("energy", 2.0)):
        with pytest.raises(ValueError, match=rf"{name} is '.*', and stepper 'solver'; .* --stepper network"):
            solve_maker(StepperOptions(**{name: value}), "builtin", 0)


def test_the_network_of_the_package_lowers_the_error_of_no_contacts_by_four_fifths():
    """One step of 0.01 s in held-out worlds, from states while discs fall and come to rest."""
    assert PRETRAINED.stat().st_size < 2e6
    model, manifest = load_checkpoint(PRETRAINED)
    assert {"stepper", "options", "data", "metrics", "commit", "versions"} <= manifest.keys()
    config = replace(CONFIG, tolerance=1e-5, relative_tolerance=0.0)
    sim = RunOptions(worlds=2, seed=HELD_OUT_SEED).simulation(Thesis(bodies=100), config)
    stepper = NetworkStepper(sim, model, manifest)
    sim.run(60, 0.01)
    square = np.zeros(2)
    for _ in range(8):
        sim.collide(0.01)
        predicted = sim.motion.numpy("predicted")[:, :2].astype(float)
        stepper.solve()
        found = sim.motion.numpy("solved")[:, :2].astype(float)
        sim.solve()
        truth = sim.motion.numpy("solved")[:, :2]
        square += ((found - truth) ** 2).sum(), ((predicted - truth) ** 2).sum()
        sim.advance()
        sim.run(22, 0.01)
    assert np.sqrt(square[0] / square[1]) < 0.2
    assert stepper.report().counts["dropped"] == 0


def test_a_pile_rests_on_three_sweeps_after_the_network():
    """100 discs at rest stay so, with overlaps below 1 mm in the mean."""
    sim = RunOptions(seed=HELD_OUT_SEED).simulation(Thesis(bodies=100), CONFIG)
    sim.run(350, 0.01)
    before = sim.state.numpy("position").copy()
    model, manifest = load_checkpoint(PRETRAINED)
    sim.run(60, 0.01, stepper=NetworkStepper(sim, model, manifest, StepperOptions(project=3)))
    assert np.abs(sim.state.numpy("position") - before).mean() < 0.03
    assert dc.kinetic_energy(sim)[0] < 5.0
    assert dc.overlap(sim, recollide=0.01).mean[0] < 1e-3
