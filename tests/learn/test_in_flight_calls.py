"""A solve in flight: corrections by a network, whose memory it is, bad input."""

from __future__ import annotations

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels.learn.channels import IMAGE, LOCAL, OUTPUT
from dc_kernels.learn.in_flight import SolveReader
from dc_kernels.model.arrays import to_numpy
from dc_kernels.runtime.program import Fed
from pipeline.scenes import Thesis
from tests.learn.flights import colliding, contact_slots, grid_over, reader_of, torch

# ---------------------------------------------------------------------- corrections


def correction(reader: SolveReader, output: np.ndarray) -> np.ndarray:
    """What an output means, by its definition: impulses before projection."""
    x = reader.sim.contacts.numpy("impulse")[contact_slots(reader)]
    scale = np.repeat(reader.scale[: reader.asked], np.diff(reader.packed_start[: reader.asked + 1]), axis=0)
    sigma, size, extrapolation, _ = (column[:, None] for column in scale.T)
    step, free, carried = output[:, 0:2], output[:, 2:4], output[:, 4:6]
    by_step = (1.0 + reader.rate[: reader.count, None]) * step * reader.step[: reader.count]
    return x + by_step + (1.0 + extrapolation) * sigma * (free + carried * x / size)


def test_a_correction_ends_on_the_cone():
    sim = colliding(acceleration="none")
    reader = reader_of(sim)
    sim.resume(pause=4)
    reader.read(np.arange(3), begin=False)
    output = np.random.default_rng(2).normal(0.0, 2.0, (reader.count, len(OUTPUT)))
    slots, wanted = contact_slots(reader), correction(reader, output)
    before, friction = sim.contacts.numpy("impulse").copy(), sim.contacts.numpy("friction")[slots]
    assert (wanted[:, 0] < 0.0).any() and (np.abs(wanted[:, 1]) > friction * wanted[:, 0]).any()
    assert reader.correct(torch.from_numpy(output)).all()
    found = sim.contacts.numpy("impulse")[slots]
    normal = np.maximum(wanted[:, 0], 0.0)
    np.testing.assert_allclose(found[:, 0], normal, atol=1e-12)
    np.testing.assert_allclose(found[:, 1], np.clip(wanted[:, 1], -friction * normal, friction * normal), atol=1e-12)
    np.testing.assert_array_equal(reader.before[slots], before[slots])
    np.testing.assert_array_equal(reader.known[slots], found)
    np.testing.assert_array_equal(sim.stats.numpy("replaced"), [1, 1, 1])


@pytest.mark.parametrize("what", [np.nan, np.inf, -np.inf, 1e30, "limit"])
@pytest.mark.parametrize("column", [0, 3, 4])
def test_what_is_not_finite_or_too_large_is_left_alone(what, column):
    """In its own world alone; of an output of the largest RMS that is taken, just more is not."""
    sim = colliding(dtype="float32", acceleration="none")
    reader = reader_of(sim, limit=7.0)
    sim.resume(pause=4)
    reader.read(np.arange(3), begin=False)
    output = np.full((reader.count, len(OUTPUT)), 0.01, np.float32)
    part = slice(reader.packed_start[1], reader.packed_start[2])
    if what == "limit":
        output[part] = 0.0
        output[part, 2] = 7.001
    else:
        output[part.start + 3, column] = what
    before = sim.contacts.numpy("impulse").copy()
    assert reader.correct(torch.from_numpy(output)).tolist() == [True, False, True]
    slots = contact_slots(reader)
    changed = (sim.contacts.numpy("impulse") != before).any(axis=1)[slots]
    assert not changed[part].any() and changed[: part.start].any() and changed[part.stop :].any()
    np.testing.assert_array_equal(reader.known[slots], sim.contacts.numpy("impulse")[slots])
    assert sim.stats.numpy("replaced").tolist() == [1, 0, 1]
    if what == "limit":
        output[part, 2] = 6.999
        sim.stats.numpy("replaced").fill(0)
        assert reader.correct(torch.from_numpy(output))[1]


def test_only_the_worlds_asked_for_change():
    sim = colliding()
    reader = reader_of(sim)
    before = sim.contacts.numpy("impulse").copy()
    reader.read(np.array([1]), begin=True)
    assert reader.correct(torch.full((reader.count, len(OUTPUT)), 0.1, dtype=torch.float64)).tolist() == [True]
    rows = np.flatnonzero((sim.contacts.numpy("impulse") != before).any(axis=1))
    assert len(rows) and set(rows) <= set(contact_slots(reader))
    assert sim.stats.numpy("replaced").tolist() == [0, 1, 0]


def test_the_solve_takes_a_correction_up():
    """Impulses moved to the solution end the solve at once, in their world alone."""
    sim = colliding(acceleration="none", max_sweeps=5000, min_sweeps=1)
    reader = reader_of(sim)
    start = sim.contacts.numpy("impulse").copy()
    sim.resume()
    solution, sweeps = sim.contacts.numpy("impulse").copy(), sim.stats.numpy("sweeps").copy()
    sim.contacts.assign("impulse", start)
    sim.solve(pause=0)
    sim.resume(pause=5)
    reader.read(np.array([1]), begin=False)
    slots = contact_slots(reader)
    output = np.zeros((reader.count, len(OUTPUT)))
    change = solution[slots] - sim.contacts.numpy("impulse")[slots]
    output[:, 2:4] = change / (reader.scale[0, 0] * (1.0 + reader.scale[0, 2]))
    assert reader.correct(torch.from_numpy(output)).all()
    sim.resume()
    found = sim.stats.numpy("sweeps")
    assert found[1] < 10 < sweeps[1]
    assert found[[0, 2]].tolist() == sweeps[[0, 2]].tolist()


# ---------------------------------------------------------------------- whose memory it is


def test_nothing_is_copied():
    sim = colliding(dtype="float32")
    reader = reader_of(sim)
    count = reader.read(np.array([0, 2]), begin=True)
    images, local = reader.images(), reader.features()
    assert images.shape == (2, len(IMAGE), *reader.grid.shape) and local.shape == (count, len(LOCAL))
    assert images.data_ptr() == reader.image.ctypes.data
    assert local.data_ptr() == to_numpy(reader.reading.array("local")).ctypes.data
    sim.resume(pause=5)
    reader.read(np.array([0, 2]), begin=False)
    assert not local[:, LOCAL.index("begin")].any()  # the tensors of before show what is read now
    trunk = torch.rand(2, 3, *reader.grid.shape)
    near = reader.gather(trunk)
    assert [tuple(value.shape) for value in near] == [(count, 3)] * 3
    assert [a.data_ptr() for a in near] == [b.data_ptr() for b in reader.gather(trunk)]
    first = near[1].clone()
    trunk.mul_(2.0)  # read where it lies, as it is at the time of the call
    torch.testing.assert_close(reader.gather(trunk)[1], 2.0 * first)
    torch.testing.assert_close(reader.gather(3.0 * trunk)[1], 6.0 * first)
    impulse = sim.contacts.numpy("impulse")
    before, output = impulse.copy(), torch.zeros(count, len(OUTPUT))
    output[:, 2] = 1.0
    reader.correct(output)
    assert (impulse != before).any()


def test_what_is_given_is_handed_to_the_kernels_at_its_address(monkeypatch):
    """Neither the network's image nor its output is copied on the way."""
    sim = colliding(dtype="float32")
    reader = reader_of(sim)
    count = reader.read(np.arange(3), begin=True)
    image, output = torch.rand(3, 2, *reader.grid.shape), torch.zeros(count, len(OUTPUT))
    seen = []
    call = Fed.__call__
    monkeypatch.setattr(Fed, "__call__", lambda self, array, at: (seen.append(at), call(self, array, at)))
    reader.gather(image)
    reader.correct(output)
    assert seen == [image.data_ptr()] * 3 + [output.data_ptr()]


def test_gather_is_bilinear_at_three_places():
    sim = colliding()
    reader = reader_of(sim)
    reader.read(np.array([0, 2]), begin=True)
    rows, columns = reader.grid.shape
    x = reader.grid.origin[0] + reader.grid.spacing * torch.arange(columns, dtype=torch.float64)
    y = reader.grid.origin[1] + reader.grid.spacing * torch.arange(rows, dtype=torch.float64)
    plane = torch.stack([x.expand(rows, -1), y[:, None].expand(-1, columns), torch.ones(rows, columns)])
    image = torch.stack([plane, 10.0 * plane]).contiguous()  # the second world asked for
    factor = np.repeat([1.0, 10.0], np.diff(reader.packed_start[:3]))[:, None]
    for value, place in zip(reader.gather(image), (reader.place, reader.place_a, reader.place_b), strict=True):
        wanted = np.column_stack([place[: reader.count], np.ones(reader.count)])
        np.testing.assert_allclose(value.numpy(), factor * wanted, atol=1e-9)


# ---------------------------------------------------------------------- bad input


def test_bad_input_is_refused():
    sim = colliding(dtype="float32")
    reader = reader_of(sim)
    for worlds, message in (
        ([0, 3], r"worlds\[1\] is 3; it must lie in \[0, 2\], above"),
        ([-1], r"worlds\[0\] is -1; it must lie in \[0, 2\]"),
        ([2, 0], r"worlds\[1\] is 0; it must lie"),
        ([1, 1], r"worlds\[1\] is 1; it must lie in \[0, 2\], above"),
        ([0.5], r"worlds has dtype float64"),
        ([[0]], r"worlds has dtype int64, shape \(1, 1\)"),
    ):
        with pytest.raises(ValueError, match=message):
            reader.read(np.array(worlds), begin=True)
    count = reader.read(np.array([0, 1]), begin=True)
    rows, columns = reader.grid.shape
    good = torch.zeros(2, 4, rows, columns)
    for image, message in (
        (good.double(), "image has dtype float64; it must be float32"),
        (good[:1], rf"image has shape \(1, 4, {rows}, {columns}\); it must be \(2, C, {rows}, {columns}\)"),
        (good[0], "image has shape"),
        (good.transpose(2, 3), "it must be contiguous"),
        (good.to(memory_format=torch.channels_last), "it must be contiguous"),
        (good.clone().requires_grad_(), "image requires a gradient"),
        ([1.0], "image is a list"),
    ):
        with pytest.raises(ValueError, match=message):
            reader.gather(image)
    for output, message in (
        (torch.zeros(count + 1, len(OUTPUT)), rf"output has shape \({count + 1}, 6\); it must be \({count}, 6\)"),
        (torch.zeros(count, 4), "output has shape"),
        (torch.zeros(count, len(OUTPUT), dtype=torch.float64), "output has dtype float64"),
        (torch.zeros(len(OUTPUT), count).T, "it must be contiguous"),
    ):
        with pytest.raises(ValueError, match=message):
            reader.correct(output)
    assert not sim.stats.numpy("replaced").any()
    for options, message in (
        ({"cap": 0.0}, "cap is 0.0; it must be > 0"),
        ({"limit": float("nan")}, "limit is nan; it must be > 0"),
        ({"threads": 0}, "threads is 0"),
    ):
        with pytest.raises(ValueError, match=message):
            reader_of(sim, **options)


def test_a_solve_that_is_not_paused_is_refused():
    sim = colliding()
    reader = reader_of(sim)
    sim.resume()
    with pytest.raises(ValueError, match=r"worlds\[0\] is 2, whose solve is not paused"):
        reader.read(np.array([2]), begin=False)
    sim.advance()
    with pytest.raises(ValueError, match="whose solve is not paused"):
        reader.read(np.array([0]), begin=False)


def test_simulations_that_cannot_be_read_are_refused():
    sim = colliding()
    reader = reader_of(sim)
    sim.config = dc.SolverConfig(acceleration="nncg")
    sim.solve(pause=0)
    with pytest.raises(ValueError, match="acceleration is 'nncg'"):
        reader.read(np.array([0]), begin=True)
    colored = dc.Simulation(*Thesis(bodies=5).build(1, 0).finalize(), schedule="color")
    with pytest.raises(ValueError, match="it must be 'cpu' and 'world'"):
        SolveReader(colored, grid_over(colored))
