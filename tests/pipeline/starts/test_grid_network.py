"""Starts from networks that answer images: what they read, what they write, what is refused."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")
torch.set_num_threads(1)

import dc_kernels as dc  # noqa: E402
from dc_kernels.measure import contact_slots  # noqa: E402
from pipeline.data import dataset  # noqa: E402
from pipeline.data.recipe import Recipe  # noqa: E402
from pipeline.data.splatter import Splatter  # noqa: E402
from pipeline.networks import models  # noqa: E402
from pipeline.networks.checkpoint import load_checkpoint, save_checkpoint  # noqa: E402
from pipeline.scenes import Thesis  # noqa: E402
from pipeline.starts.grid_network import GridNetworkStart  # noqa: E402
from pipeline.starts.registry import maker  # noqa: E402
from pipeline.training import grid as grid_training  # noqa: E402
from pipeline.training import losses  # noqa: E402
from pipeline.training.processes import Processes  # noqa: E402
from tests.pipeline.small import SCENE, options, settled  # noqa: E402


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
    spec = dc.ImageSpec.from_dict(manifest["images"])
    assert (spec.bins, spec.stencil.h, spec.walls) == (3, 0.7, 50.0) and start.images.spec == spec
    splatter = Splatter(spec)
    decode = losses.Decoder(images=spec, reverse=manifest["decode"]["reverse"])
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
    "images": {
        "grid": {"rows": 61, "columns": 61, "spacing": 0.25, "origin": [0.0, 0.0]},
        "body_channels": ["mass"],
        "contact_channels": ["normal_x"],
        "walls": 100.0,
    },
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
    manifest = {"decode": MANIFEST["decode"]}
    save_checkpoint(tmp_path / "a.safetensors", models.build("pressure", {"width": 0.1}), manifest)
    with pytest.raises(ValueError, match="the manifest has no 'images': the network was not trained on images"):
        maker(str(tmp_path / "a.safetensors"))(sim)
    double = settled(Thesis(bodies=5), worlds=1, steps=0, dtype="float64")
    with pytest.raises(ValueError, match=r"sim\.dtype is float64; networks answer in float32"):
        GridNetworkStart(double, Fixed(torch.zeros(1)), MANIFEST)
    start = GridNetworkStart(sim, Fixed(torch.zeros(1)), MANIFEST)
    with pytest.raises(ValueError, match="the start was made for another simulation"):
        start(double)
