"""Losses of networks: their formulas, their gradients, and the problems that they solve."""

from __future__ import annotations

from dataclasses import fields, replace
from types import SimpleNamespace

import numpy as np
import pytest

torch = pytest.importorskip("torch")
torch.set_num_threads(1)

import dc_kernels as dc  # noqa: E402
from dc_kernels.grid.grid import Grid  # noqa: E402
from dc_kernels.learn.differentiable import ContactProblem  # noqa: E402
from dc_kernels.measure import contact_slots  # noqa: E402
from dc_kernels.solve.rows import read_column  # noqa: E402
from pipeline.data import dataset  # noqa: E402
from pipeline.data.generate import generate  # noqa: E402
from pipeline.data.recipe import GenerateOptions, Recipe  # noqa: E402
from pipeline.scenes import Mixed, Thesis  # noqa: E402
from pipeline.training import losses  # noqa: E402
from tests.pipeline.small import SCENE, settled  # noqa: E402


def as_batch(sim: dc.Simulation) -> SimpleNamespace:
    """The step in flight as the losses read it from a batch."""
    slots, world = contact_slots(sim.contacts)
    contacts, model, state = sim.contacts, sim.model, sim.state
    shown = {name: contacts.numpy(name)[slots] for name in ("normal", "gap", "friction", "restitution", "color")}
    shown |= {name: contacts.numpy(name)[slots].astype(np.int64) for name in ("body_a", "body_b")}
    shown["bias"] = read_column(sim.rows.numpy("column"), sim.variant, "bias", sim.rows.numpy("slot")[slots])
    shown["point"] = state.numpy("position")[shown["body_a"]] + contacts.numpy("arm_a")[slots]
    shown |= {name: state.numpy(name).copy() for name in ("position", "velocity", "angular_velocity")}
    shown |= {name: model.numpy(name) for name in ("mass", "inertia", "gravity")}
    shown["body_start"] = model.numpy("body_start").astype(np.int64)
    shown["contact_start"] = np.searchsorted(world, np.arange(model.world_count + 1))
    shown["dt"] = np.full(model.world_count, 0.01, model.dtype)
    return SimpleNamespace(**{name: torch.from_numpy(np.array(values)) for name, values in shown.items()})


@pytest.mark.parametrize("scene", [Thesis(bodies=20), Thesis(bodies=20, restitution=0.4), Mixed(bodies=15)])
def test_a_batch_is_the_problem_that_the_solver_solves(scene):
    """Rows, their order and their biases, with and without bounces."""
    sim = settled(scene, steps=90)
    wanted = ContactProblem.from_simulation(sim)
    found, order = losses.contact_problem(as_batch(sim))
    assert torch.equal(torch.from_numpy(contact_slots(sim.contacts)[0])[order], wanted.slot)
    assert len(order) > 20
    assert len(wanted.bias.unique()) > 5
    for name in ("body_a", "body_b", "normal", "arm_a", "arm_b", "friction", "inv_mass", "inv_inertia", "velocity"):
        torch.testing.assert_close(getattr(found, name), getattr(wanted, name), rtol=1e-5, atol=1e-6, check_dtype=False)
    torch.testing.assert_close(found.bias, wanted.bias, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize(("bins", "reverse"), [(1, True), (1, False), (4, True)])
def test_the_decoder_reads_what_the_simulation_reads(bins, reverse):
    sim = settled(Thesis(bodies=30), steps=110)
    images = dc.Images(sim, dc.ImageSpec(Grid.thesis(), body_channels=(), bins=bins))
    image = torch.randn(3, 2 * bins, 61, 61, generator=torch.Generator().manual_seed(0))
    decode = losses.Decoder(images=images.spec, reverse=reverse)
    found = decode(image, as_batch(sim))
    images.start_from(image, reverse=reverse)
    wanted = sim.contacts.numpy("impulse")[contact_slots(sim.contacts)[0]]
    np.testing.assert_allclose(found, wanted, atol=1e-6)
    assert np.abs(wanted).max() > 0.1


def make_loss(name: str, **changes) -> losses.Loss:
    decode = losses.Decoder(images=dc.ImageSpec(GRID), reverse=False)
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


def test_a_loss_knows_the_bias_that_overlaps_have(tmp_path):
    """Labels of a solver with velocity biases are where its sweeps stay."""
    solver = dc.SolverConfig(min_sweeps=1, position_correction="baumgarte")
    recipe = Recipe(scene=Mixed(bodies=8), options=GenerateOptions(worlds=2, steps=70, dt=0.02), solver=solver)
    generate(recipe, tmp_path / "data", threads=1, progress=False)
    states = dataset.States(tmp_path / "data", min_contacts=6)
    batch = states.batch(range(0, len(states), 5))
    assert float(batch.bias.min()) < 0.0
    loss = make_loss("sweeps")
    total, weight = loss.of_impulses(batch.label, batch)
    assert float(total) < 1e-6 * float(weight)
    without = loss.of_impulses(batch.label, replace(batch, bias=batch.bias.clamp(min=0.0)))[0]
    assert float(without) > 100.0 * float(total)


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
