"""A StepNet in lanes: against torch and the oracle, of any widths, on any grid; worlds that are not asked for."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels.learn.groups import STEP_NETWORK
from dc_kernels.learn.step_network import StepNetworkInLanes
from dc_kernels.runtime.backends import argument_names, bind, make_kernels
from pipeline.options import RunOptions
from pipeline.scenes import Thesis

torch = pytest.importorskip("torch")

from pipeline.stepper.network import StepNet, StepNetConfig  # noqa: E402
from pipeline.stepper.view import StepReader  # noqa: E402

DT = 0.01
WIDTHS: dict[str, dict[str, Any]] = {
    "as shipped": {},
    "one scale": {"channels": (8,), "near": 3, "hidden": 4, "width": 7, "rounds": 2},
    "odd widths": {"channels": (5, 20, 3), "near": 11, "hidden": 9, "width": 20, "rounds": 3},
}
SIM: list[dc.Simulation] = []


def colliding() -> dc.Simulation:
    """Worlds in which discs have fallen onto each other, their contacts found; made once."""
    if not SIM:
        sim = RunOptions(worlds=3, seed=3, threads=2).simulation(Thesis(bodies=30), dc.SolverConfig.preset("accurate"))
        sim.run(100, DT)
        sim.collide(DT)
        sim.solve(pause=0)
        SIM.append(sim)
    return SIM[0]


def reader_of(sim: dc.Simulation, rows: int, columns: int) -> StepReader:
    """What reads worlds for torch, on so many nodes, beyond which some bodies lie."""
    low = sim.state.numpy("position").min(axis=0) - 0.2
    return StepReader(sim, dc.Grid(rows=rows, columns=columns, spacing=0.4, origin=tuple(low.tolist())))


def network(seed: int = 0, **config: Any) -> StepNet:
    """A network with random weights everywhere."""
    torch.manual_seed(seed)
    model = StepNet(StepNetConfig(**config)).eval()
    with torch.no_grad():
        for parameter in model.parameters():
            if parameter.ndim == 1:
                parameter.normal_(0.0, 0.3)
    return model


def in_lanes(reader: StepReader, model: StepNet) -> StepNetworkInLanes:
    layers = model.in_lanes()
    assert layers is not None
    return StepNetworkInLanes(reader.sim, reader.grid, reader.walls[:, 0], layers)


def by_torch(reader: StepReader, model: StepNet) -> tuple[np.ndarray, np.ndarray]:
    """Velocities (N, 3) and impulses (M, 2) of all worlds."""
    view = reader.read()
    with torch.inference_mode():
        way, impulse = model(view, reader.grid)
        speed = view.speed[view.body_start[:-1].long(), 0].repeat_interleave(view.contact_start.diff())
        return (way * view.speed).numpy(), (impulse * speed[:, None]).numpy()


def impulses(sim: dc.Simulation) -> np.ndarray:
    """Impulses of the contacts of all worlds, one world after the other."""
    first, count = (sim.contacts.numpy(name) for name in ("contact_start", "contact_count"))
    return np.concatenate([sim.contacts.numpy("impulse")[a : a + n] for a, n in zip(first, count)])


def test_backends_have_the_same_kernel():
    warp, oracle = (make_kernels(backend, "learn.step_network", "float32") for backend in ("warp", "numpy"))
    assert list(warp) == list(oracle)
    for name in warp:
        assert argument_names(warp[name]) == argument_names(oracle[name])


@pytest.mark.parametrize("shape", [(23, 30), (9, 11), (8, 2)])
@pytest.mark.parametrize("widths", list(WIDTHS))
def test_lanes_answer_as_torch_and_as_the_oracle(widths: str, shape: tuple[int, int]):
    sim = colliding()
    reader, model = reader_of(sim, *shape), network(**WIDTHS[widths])
    lanes = in_lanes(reader, model)
    wanted = by_torch(reader, model)
    found = lanes(np.ones(3, bool)), impulses(sim)
    assert len(wanted[1]) > 60
    for mine, theirs in zip(found, wanted, strict=True):
        size = np.abs(theirs).max()
        assert size > 1e-3
        np.testing.assert_allclose(mine, theirs, rtol=0, atol=1e-6 * max(size, 1.0))
    if shape != (9, 11):
        return
    named = {name: np.array(getattr(lanes.network, name)) for name in STEP_NETWORK}
    values: dict[str, Any] = {
        "network": SimpleNamespace(**{name: value[()] for name, value in named.items()}),
        "world_offset": 0,
    }
    for name, group in (("model", sim.model), ("state", sim.state), ("motion", sim.motion), ("asking", lanes.asking)):
        values[name] = SimpleNamespace(**{field: group.numpy(field).copy() for field in group.table})
    values["contacts"] = SimpleNamespace(**{field: sim.contacts.numpy(field) for field in sim.contacts.table})
    bind(make_kernels("numpy", "learn.step_network", "float32")["answer_worlds"], 3, values, "cpu")()
    for mine, theirs in zip(found, (values["asking"].velocity, impulses(sim)), strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=0, atol=2e-6 * max(np.abs(theirs).max(), 1.0))


def test_a_world_has_its_bits_whoever_else_is_asked_and_the_others_are_left():
    sim = colliding()
    reader = reader_of(sim, 9, 11)
    lanes = in_lanes(reader, network(5, **WIDTHS["one scale"]))
    layers = network(0, **WIDTHS["one scale"]).in_lanes()
    assert layers is not None
    lanes.load(layers)
    every, by_all = lanes(np.ones(3, bool)).copy(), impulses(sim)
    lanes.velocity.fill(7.0)
    sim.contacts.numpy("impulse").fill(0.25)
    alone = lanes(np.array([False, True, False]))
    start, count = sim.model.numpy("body_start"), sim.contacts.numpy("contact_count")
    own = np.zeros(len(alone), bool)
    own[start[1] : start[2]] = True
    np.testing.assert_array_equal(alone[own], every[own])
    assert (alone[~own] == 7.0).all()
    mine = np.repeat([False, True, False], count)
    np.testing.assert_array_equal(impulses(sim)[mine], by_all[mine])
    assert (impulses(sim)[~mine] == 0.25).all()


def test_not_a_number_comes_out():
    sim = colliding()
    reader = reader_of(sim, 9, 11)
    for name in ("down.0", "near", "first", "rounds.1.0"):
        model = network(**WIDTHS["one scale"])
        with torch.no_grad():
            model.get_submodule(name).bias[0] = np.nan
        assert np.isnan(in_lanes(reader, model)(np.ones(3, bool))).any(), name


def test_another_network_is_left_to_torch():
    class Other(StepNet):
        def head(self, *arguments: Any) -> Any:
            return super().head(*arguments)

    assert Other().in_lanes() is None
    model = network()
    handle = model.near.register_forward_hook(lambda module, given, found: found * 2.0)
    assert model.in_lanes() is None
    handle.remove()
    assert model.in_lanes() is not None
    deep = network(channels=(4,) * 9).in_lanes()
    assert deep is not None
    reader = reader_of(colliding(), 9, 11)
    with pytest.raises(ValueError, match="the trunk has 9 scales; there may be 8"):
        StepNetworkInLanes(reader.sim, reader.grid, reader.walls[:, 0], deep)
