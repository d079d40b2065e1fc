"""Launches fed with other memory at each call: by address, by shape, on either way of packing arguments."""

from __future__ import annotations

import gc
import weakref

import numpy as np
import pytest
import warp as wp

import dc_kernels as dc
from dc_kernels.grid.grid import Grid
from dc_kernels.grid.splat import points_group, stencil_group, transfer_kernels
from dc_kernels.grid.stencil import BILINEAR
from dc_kernels.grid.transfer import Transfer
from dc_kernels.runtime import launches
from dc_kernels.runtime.backends import command
from dc_kernels.runtime.program import Fed, Kernel

GRID = Grid(rows=6, columns=7, spacing=0.5)
POINTS = np.random.default_rng(1).uniform(0.0, 3.0, (11, 2))
SCALARS = {"bins": 1, "channel_offset": 0, "chunks": 1}


@pytest.fixture(params=["packed", "by Warp"])
def packing(request, monkeypatch):
    """Arguments that stay packed, and a version of Warp that is not known to take them so."""
    assert wp.__version__.startswith(launches.PACKED)  # or every call is slower: see that the new version fits
    if request.param == "by Warp":
        monkeypatch.setattr(launches, "PACKED", ())


def gathering(images, out, start=None):
    """The kernel that gathers images, its arguments, and how many threads it takes."""
    values = {"image": wp.array(images, copy=False), "value": wp.array(out, copy=False), **SCALARS}
    arrays = point_arrays(start)
    values["stencil"] = stencil_group(BILINEAR, GRID, "warp", "float64")
    values["points"] = points_group(GRID, len(arrays["start"]), "warp", "float64", **arrays)
    return transfer_kernels("warp", "float64")["gather_points"], values


def point_arrays(start=None):
    """The points of the worlds as numpy arrays."""
    start = np.array([0, 11] if start is None else start, np.int32)
    return {"start": start[:-1], "count": np.diff(start), "place": POINTS, "bin": np.zeros(1, np.int32)}


def tensors_of(torch, start=None):
    """The same arguments with tensors, and groups of tensors and numbers."""
    arrays = point_arrays(start)
    arrays["origin"] = np.zeros((len(arrays["start"]), 2))
    points = {name: torch.from_numpy(np.ascontiguousarray(array)) for name, array in arrays.items()}
    return {**SCALARS, "stencil": BILINEAR.arguments(GRID), "points": points}


def test_a_launch_reads_what_it_is_pointed_at(packing):
    out = np.zeros((11, 2))
    kernel, values = gathering(np.zeros((1, 2, 6, 7)), out)
    bound = launches.Bound(command(kernel, 1, {**values, "world_offset": 0}, "cpu"))
    draw = np.random.default_rng(2)
    for _ in range(3):
        image = draw.normal(size=(1, 2, 6, 7))
        bound.point("image", image.ctypes.data, image.shape)
        bound()
        np.testing.assert_allclose(out, gathered(image), rtol=1e-12)
    image *= 3.0  # read where it lies
    bound()
    np.testing.assert_allclose(out, gathered(image), rtol=1e-12)


def gathered(image):
    out = np.zeros((11, image.shape[1]))
    Transfer(GRID, BILINEAR).at(POINTS).gather(image, out)()
    return out


@pytest.mark.parametrize("threads", [1, 3])
def test_a_fed_kernel_runs_over_all_worlds(packing, threads):
    start = np.array([0, 4, 4, 11])
    out = np.zeros((11, 2))
    kernel, values = gathering(np.zeros((3, 2, 6, 7)), out, start)
    fed = Fed(Kernel(kernel, values, 1), "image", 3, backend="warp", threads=threads)
    draw = np.random.default_rng(3)
    for shape in ((3, 2, 6, 7), (3, 2, 6, 7), (3, 2, 5, 7), (3, 2, 6, 7)):  # another shape, and back
        image = draw.normal(size=shape)
        fed(image, image.ctypes.data)
        wanted = np.zeros((11, 2))
        grid = Grid(rows=shape[2], columns=7, spacing=0.5)
        Transfer(grid, BILINEAR).at(POINTS, start=start).gather(image, wanted)()
        np.testing.assert_array_equal(out, wanted)


def test_calls_take_tensors_of_any_size(packing):
    torch = pytest.importorskip("torch")
    kernel, _ = gathering(np.zeros((1, 2, 6, 7)), np.zeros((11, 2)))
    values = tensors_of(torch)
    calls = launches.Calls(kernel)
    for channels in (2, 5, 2):
        image = torch.rand(1, channels, 6, 7, dtype=torch.float64)
        out = torch.zeros(11, channels, dtype=torch.float64)
        calls({**values, "image": image, "value": out}, 1, 1)
        np.testing.assert_allclose(out.numpy(), gathered(image.numpy()), rtol=1e-12)
    assert len(calls._free) == 1


def test_calls_share_worlds_and_keep_a_launch_for_each_thread(packing):
    torch = pytest.importorskip("torch")
    start = np.array([0, 4, 4, 11])
    kernel, _ = gathering(np.zeros((3, 2, 6, 7)), np.zeros((11, 2)), start)
    values = tensors_of(torch, start)
    calls, made = launches.Calls(kernel), []
    image = torch.rand(3, 2, 6, 7, dtype=torch.float64)
    for threads in (1, 2, 3, 2):
        out = torch.zeros(11, 2, dtype=torch.float64)
        calls({**values, "image": image, "value": out}, 3, threads)
        made.append(out)
    for other in made[1:]:
        torch.testing.assert_close(other, made[0], rtol=0, atol=0)
    assert made[0].any() and len(calls._free) == 3


def test_further_launches_of_a_kernel_are_as_the_first_and_refuse_what_warp_refuses(packing):
    """Warp records the first over so many threads; the others are made like it, with arguments of their own."""
    draw = np.random.default_rng(4)
    for _ in range(3):
        image, out = draw.normal(size=(1, 2, 6, 7)), np.zeros((11, 2))
        kernel, values = gathering(image, out)
        launch = command(kernel, 1, {**values, "world_offset": 0}, "cpu")
        launches.Bound(launch)()
        np.testing.assert_allclose(out, gathered(image), rtol=1e-12)
        out[:] = 0.0
        launch.launch()  # as in a graph
        np.testing.assert_allclose(out, gathered(image), rtol=1e-12)
        assert any(argument is values["image"] for argument in launch.fwd_args)  # which keeps it alive
    for name, wrong in (
        ("image", wp.array(np.zeros((1, 2, 6, 7), np.float32))),
        ("image", wp.array(np.zeros((2, 6, 7)))),
        ("image", 1.0),
        ("bins", "1"),
    ):
        with pytest.raises(RuntimeError, match=rf"Error launching kernel.*{name}"):
            command(kernel, 1, {**values, "world_offset": 0, name: wrong}, "cpu")


def test_a_launch_keeps_what_it_has_by_address():
    """A solve looks at the word that cuts it short by its address, also where its simulation is gone."""
    builder = dc.ModelBuilder()
    builder.add_world()
    builder.add_disc(builder.add_body((0.0, 0.0)), 0.5, density=1.0)
    sim = dc.Simulation(*builder.finalize())
    launch = sim.bind("solve_world", 0, 1)
    word = weakref.ref(sim._shards.cut_flag)
    del sim
    gc.collect()
    assert word() is not None
    launch()
    del launch
    gc.collect()
    assert word() is None


@pytest.mark.parametrize(
    ("arguments", "error", "words"),
    [
        (("nosuch", 0, 1), ValueError, "name is 'nosuch'"),
        (("predict", -1, 1), ValueError, "first is -1"),
        (("predict", 0.5, 1), TypeError, "first is 0.5"),
        (("predict", 0, -1), ValueError, "count is -1"),
        (("predict", 1, 2), ValueError, "first is 1 and count is 2; their sum must be at most 2"),
        (("solve_world", 0, 2, {"max_sweps": 3}), ValueError, "'max_sweps'"),
    ],
)
def test_a_launch_of_worlds_or_settings_that_are_not_there(arguments, error, words):
    builder = dc.ModelBuilder()
    for _ in range(2):
        builder.add_world()
        builder.add_disc(builder.add_body((0.0, 0.0)), 0.5, density=1.0)
    sim = dc.Simulation(*builder.finalize())
    with pytest.raises(error, match=words):
        sim.bind(*arguments)
