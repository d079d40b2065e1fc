"""A ContactNet in lanes: against the oracle and torch, on grids of odd and even size, of any widths; refusals."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels.learn.channels import OUTPUT, SHARE
from dc_kernels.learn.in_flight import SolveReader
from dc_kernels.learn.network import NetworkInLanes
from dc_kernels.runtime.backends import argument_names, bind, make_kernels
from pipeline.options import RunOptions
from pipeline.scenes import Thesis

torch = pytest.importorskip("torch")
torch.set_num_threads(1)

from pipeline.contactnet.network import ContactNet, ContactNetConfig  # noqa: E402

DT = 0.01
WIDTHS = {
    "as shipped": {},
    "one scale": {"channels": (8,), "near": 3, "hidden": (16,)},
    "odd widths": {"channels": (5, 20, 9, 3), "near": 11, "hidden": (7, 30, 25)},
}


def colliding(worlds: int = 3, threads: int = 1) -> dc.Simulation:
    """Worlds in which discs have fallen onto each other, their solve begun."""
    config = dc.SolverConfig.preset("accurate", acceleration="none")
    sim = RunOptions(worlds=worlds, seed=3, threads=threads).simulation(Thesis(bodies=30), config)
    sim.run(100, DT)
    sim.collide(DT)
    sim.solve(pause=0)
    return sim


SIM: list[dc.Simulation] = []


def paused() -> dc.Simulation:
    """A solve that has paused after some sweeps, made once: nothing here goes on with it."""
    if not SIM:
        SIM.append(colliding())
        SIM[0].resume(pause=7)
    SIM[0].stats.numpy("replaced").fill(0)  # as after a resume
    return SIM[0]


def reader_of(sim: dc.Simulation, spacing: float, rows: int, columns: int) -> SolveReader:
    """A reader whose grid has so many nodes from a little below the lowest body on."""
    low = sim.state.numpy("position").min(axis=0) - 0.4 * spacing
    return SolveReader(sim, dc.Grid(rows=rows, columns=columns, spacing=spacing, origin=tuple(low.tolist())))


def network(seed: int = 0, **config: Any) -> ContactNet:
    """A network with random weights everywhere, gains that differ, and answers of order 1."""
    torch.manual_seed(seed)
    model = ContactNet(ContactNetConfig(**config)).eval()
    with torch.no_grad():
        for layer in (*model.down, *model.up, model.near, model.own, *model.layers, model.last):
            layer.bias.normal_(0.0, 0.3)
        model.last.weight.mul_(10.0)
        model.gain.copy_(torch.tensor([0.7, 0.4]))
    return model


def by_torch(reader: SolveReader, model: Any) -> np.ndarray:
    """The answer of the module itself to what is read, with its images."""
    with torch.inference_mode():
        near = reader.gather(model.trunk(reader.images()).contiguous())
        return model.head(reader.features(), near).numpy().copy()


def by_oracle(reader: SolveReader, net: NetworkInLanes, begin: bool) -> np.ndarray:
    """The answer of the oracle to what is read."""
    names = ("weight", "width", "hidden")
    given = dict(zip(names, (net._weight, net._widths, net._hidden)))
    grid = reader.grid
    values = {
        "network": SimpleNamespace(
            **given, share=0.0 if begin else SHARE, spacing=grid.spacing, rows=grid.rows, columns=grid.columns
        ),
        "reading": SimpleNamespace(**{name: reader.reading.numpy(name) for name in reader.reading.table}),
        "output": np.zeros((reader.count, len(OUTPUT))),
        "world_offset": 0,
    }
    bind(make_kernels("numpy", "learn.network", "float32")["answer_contacts"], reader.asked, values, "cpu")()
    return values["output"]


def test_backends_have_the_same_kernel():
    warp, oracle = (make_kernels(backend, "learn.network", "float32") for backend in ("warp", "numpy"))
    assert list(warp) == list(oracle)
    for name in warp:
        assert argument_names(warp[name]) == argument_names(oracle[name])


@pytest.mark.parametrize("shape", [(9, 11), (8, 12), (5, 2), (23, 30)])
@pytest.mark.parametrize("widths", list(WIDTHS))
def test_lanes_answer_as_torch_and_as_the_oracle(widths, shape):
    sim = paused()
    spacing = 1.0 if shape[0] > 5 else 2.5
    reader = reader_of(sim, spacing, *shape)
    model = network(**WIDTHS[widths])
    net = NetworkInLanes(reader, model.in_lanes(accelerated=False))
    impulse = sim.contacts.numpy("impulse").copy()
    for begin, worlds in ((False, [0, 1, 2]), (True, [1])):
        reader.read(np.array(worlds), begin=begin)
        wanted = by_torch(reader, model)
        net(begin=begin)
        sim.contacts.assign("impulse", impulse)
        assert 0.5 < np.abs(wanted).max() < 50.0 and reader.count > 5
        size = np.abs(wanted).max()
        np.testing.assert_allclose(net.output[: reader.count], wanted, rtol=0, atol=1e-6 * max(size, 1.0))
        if shape == (9, 11):
            found = by_oracle(reader, net, begin)
            np.testing.assert_allclose(net.output[: reader.count], found, rtol=0, atol=2e-6 * max(size, 1.0))


def test_what_is_answered_corrects_as_the_reader_does():
    sim = paused()
    reader = reader_of(sim, 1.0, 9, 11)
    model = network()
    net = NetworkInLanes(reader, model.in_lanes(accelerated=False))
    impulse = sim.contacts.numpy("impulse").copy()
    reader.read(np.array([0, 2]), begin=False, what="features")
    reader.reading.numpy("least")[2] = 0.0
    assert net(begin=False).tolist() == [True, False]
    first, count = (sim.contacts.numpy(name) for name in ("contact_start", "contact_count"))
    corrected = sim.contacts.numpy("impulse").copy()
    sim.contacts.assign("impulse", impulse)
    sim.stats.numpy("replaced").fill(0)
    reader.read(np.array([0]), begin=False)
    assert reader.correct(torch.from_numpy(net.output[: reader.count].copy())).tolist() == [True]
    np.testing.assert_array_equal(corrected, sim.contacts.numpy("impulse"))
    changed = np.flatnonzero((corrected != impulse).any(axis=1))
    assert len(changed) and changed[0] >= first[0] and changed[-1] < first[0] + count[0]
    sim.contacts.assign("impulse", impulse)


def test_an_even_share_moves_contacts_by_their_steps():
    sim = paused()
    reader = reader_of(sim, 1.0, 9, 11)
    even = NetworkInLanes(reader, None)
    impulse = sim.contacts.numpy("impulse").copy()
    reader.read(np.arange(3), begin=False)
    wanted = torch.zeros(reader.count, len(OUTPUT))
    wanted[:, :2] = SHARE
    reader.correct(wanted)
    corrected = sim.contacts.numpy("impulse").copy()
    assert (corrected != impulse).any()
    sim.contacts.assign("impulse", impulse)
    reader.local.fill(np.nan)
    reader.read(np.arange(3), begin=False, what="steps")
    assert np.isnan(reader.local).all()
    assert even(begin=False).all()
    np.testing.assert_array_equal(sim.contacts.numpy("impulse"), corrected)
    sim.contacts.assign("impulse", impulse)
    reader.read(np.arange(3), begin=True, what="steps")
    even(begin=True)  # there is no step to go on with
    np.testing.assert_array_equal(sim.contacts.numpy("impulse"), impulse)


def test_not_a_number_is_not_taken():
    sim = paused()
    reader = reader_of(sim, 1.0, 9, 11)
    impulse = sim.contacts.numpy("impulse").copy()
    reader.begin()
    for name in ("down.1", "up.0", "own", "last"):
        model = network()
        with torch.no_grad():
            model.get_submodule(name).bias[0] = np.nan
        net = NetworkInLanes(reader, model.in_lanes(accelerated=False))
        reader.read(np.arange(3), begin=False)
        assert not net(begin=False).any(), name
        np.testing.assert_array_equal(sim.contacts.numpy("impulse"), impulse)


def test_worlds_threads_and_new_weights():
    """An answer has the bits of the world alone, on any number of threads; weights are taken anew."""
    sim = paused()
    answers = []
    for threads, worlds in ((1, [0, 1, 2]), (3, [0, 1, 2]), (1, [1])):
        grid = reader_of(sim, 1.0, 9, 11).grid
        reader = SolveReader(sim, grid, threads=threads)
        net = NetworkInLanes(reader, network(5).in_lanes(accelerated=False))
        net.load(network(0).in_lanes(accelerated=False))
        impulse = sim.contacts.numpy("impulse").copy()
        reader.read(np.array(worlds), begin=False)
        net(begin=False)
        sim.contacts.assign("impulse", impulse)
        answers.append(np.split(net.output[: reader.count].copy(), reader.packed_start[1 : len(worlds)]))
    for a, b in zip(answers[0], answers[1], strict=True):
        np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(answers[0][1], answers[2][0])
    wanted = NetworkInLanes(reader, network(0).in_lanes(accelerated=False))
    np.testing.assert_array_equal(wanted._weight, net._weight)


def test_a_gain_for_each_kind_of_solver():
    model = network()
    plain, accelerated = (model.in_lanes(accelerated=kind).last[0] for kind in (False, True))
    np.testing.assert_allclose(plain / accelerated, 0.7 / 0.4, rtol=1e-6)

    class Other(ContactNet):
        def head(self, local: Any, near: Any) -> Any:
            return local

    assert Other().in_lanes(accelerated=False) is None


def test_what_cannot_be_is_refused():
    reader = reader_of(paused(), 1.0, 9, 11)
    with pytest.raises(ValueError, match="the trunk has 9 scales; there may be 8"):
        NetworkInLanes(reader, network(channels=(4,) * 9).in_lanes(accelerated=False))
    with pytest.raises(ValueError, match="what is 'all'; it must be one of"):
        reader.read(np.arange(3), begin=False, what="all")
