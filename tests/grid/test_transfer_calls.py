"""Transfers as they are called: places, worlds, threads, memory, refusals."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
import torch
import warp as wp

from dc_kernels.grid.grid import Grid
from dc_kernels.grid.layout import BAND, CHUNK
from dc_kernels.grid.splat import Splat, points_group
from dc_kernels.grid.stencil import Stencil
from dc_kernels.grid.transfer import Transfer, gather, splat
from dc_kernels.model.arrays import kernel_array
from dc_kernels.sph.smoothing import STENCILS
from tests.grid.places import RADIAL, SEPARABLE, SPACING, border_cloud, cloud

# ---------------------------------------------------------------------- places


def test_bilinear_weights_on_nodes_edges_and_corners():
    """Powers of two, so exact in float32 too."""
    grid = Grid(rows=3, columns=4, spacing=0.5, origin=(1.0, -1.0))
    for dtype, (at, expected) in itertools.product(
        (np.float32, np.float64),
        (
            ((1.5, -0.5), {(1, 1): 1.0}),  # a node
            ((1.75, -0.5), {(1, 1): 0.5, (1, 2): 0.5}),  # an edge
            ((1.625, -0.625), {(0, 1): 0.1875, (0, 2): 0.0625, (1, 1): 0.5625, (1, 2): 0.1875}),
            ((1.0, -1.0), {(0, 0): 1.0}),  # corners of the grid
            ((2.5, 0.0), {(2, 3): 1.0}),
            ((2.5, -0.75), {(0, 3): 0.5, (1, 3): 0.5}),  # its border
            ((9.0, -0.75), {(0, 3): 0.5, (1, 3): 0.5}),  # beyond
            ((-9.0, 9.0), {(2, 0): 1.0}),
        ),
    ):
        wanted = np.zeros((3, 4))
        for node, weight in expected.items():
            wanted[node] = weight
        image = splat(np.array([at], dtype), np.ones((1, 1), dtype), grid, Stencil("bilinear"))
        np.testing.assert_array_equal(image[0, 0], wanted)


@pytest.mark.parametrize("kernel", [name for name in RADIAL if name != "gaussian"])  # which jumps at r = h
def test_a_support_of_one_spacing_on_a_node_an_edge_and_a_cell(kernel):
    grid = Grid(rows=4, columns=4, spacing=0.5)
    for at, nodes in (
        ((0.5, 1.0), [(2, 1)]),  # its neighbours lie at r = h, where W is 0
        ((0.75, 1.0), [(2, 1), (2, 2)]),
        ((0.75, 0.75), [(1, 1), (1, 2), (2, 1), (2, 2)]),
        ((0.0, 0.0), [(0, 0)]),
        ((1.5, 1.5), [(3, 3)]),
    ):
        wanted = np.zeros((4, 4))
        for node in nodes:
            wanted[node] = 1 / len(nodes)
        image = splat(np.array([at]), np.ones((1, 1)), grid, Stencil(kernel, h=0.5))
        np.testing.assert_allclose(image[0, 0], wanted, rtol=1e-14)


@pytest.mark.parametrize("kernel", STENCILS)
def test_particles_of_one_cell_add_up(kernel):
    grid = Grid(rows=9, columns=9, spacing=SPACING)
    points = np.array([[0.52, 0.61], [0.58, 0.55], [0.52, 0.61]])
    values = np.array([[1.0, -2.0], [3.0, 0.5], [0.25, 4.0]])
    alone = sum(splat(points[i : i + 1], values[i : i + 1], grid, Stencil(kernel)) for i in range(3))
    np.testing.assert_allclose(splat(points, values, grid, Stencil(kernel)), alone, rtol=1e-13, atol=1e-15)


@pytest.mark.parametrize("backend", ["warp", "numpy"])
@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("kernel", ["poly6", *SEPARABLE])
def test_a_point_as_far_as_its_scalar_goes_has_a_nearest_node(kernel, dtype, backend):
    """In spacings of half a metre its place is beyond what the scalar holds."""
    far = 0.9 * float(np.finfo(dtype).max)
    points = np.array([[far, 1.0], [-far, far], [0.9, -far], [0.6 * far, -0.6 * far], [2.0, 2.0]], dtype)
    sizes = ((9, 11), (300, 700)) if backend == "warp" else ((9, 11),)
    for rows, columns in sizes:  # the larger image is splatted tile by tile
        grid = Grid(rows=rows, columns=columns, spacing=0.5, origin=(-0.25, 0.5))
        image = splat(points, np.ones((5, 1), dtype), grid, Stencil(kernel), backend=backend)[0, 0]
        assert image.sum() == pytest.approx(5.0, rel=1e-6)
        for row, column in ((1, -1), (-1, 0), (0, 2), (0, -1)):
            assert image[row, column] > 0.2
        plane = np.arange(float(rows * columns)).reshape(1, 1, rows, columns).astype(dtype)
        found = gather(plane, points, grid, Stencil(kernel), backend=backend)[:, 0]
        assert found[3] == columns - 1
        assert found[1] == (rows - 1) * columns


@pytest.mark.parametrize("backend", ["warp", "numpy"])
def test_what_reaches_no_node_goes_to_the_nearest_or_is_lost(backend):
    """One point in a cell's middle, one just outside, one far outside, one inside; h is a third of the spacing."""
    grid = Grid(rows=4, columns=5, spacing=0.75)
    points = np.array([[0.4, 1.1], [-0.2, 0.8], [90.0, -7.0], [1.6, 1.6]])
    values = np.array([[1.0], [2.0], [4.0], [8.0]])
    kept, lost = np.zeros((4, 5)), np.zeros((4, 5))
    kept[1, 1], kept[1, 0], kept[0, 4], kept[2, 2], lost[1, 0], lost[2, 2] = 1.0, 2.0, 4.0, 8.0, 2.0, 8.0
    for nearest, expected in ((True, kept), (False, lost)):
        transfer = Transfer(grid, Stencil(h=0.25, nearest=nearest), backend=backend).at(points)
        image = np.zeros((1, 1, 4, 5))
        bound = transfer.splat(values, image)
        bound()
        np.testing.assert_allclose(image[0, 0], expected, rtol=1e-13)
        np.testing.assert_array_equal(bound.missed, [2])
        found = np.full((4, 1), 9.0)
        transfer.gather(np.arange(20.0).reshape(1, 1, 4, 5), found)()
        wanted = [6.0, 5.0, 4.0, 12.0] if nearest else [0.0, 5.0, 0.0, 12.0]
        np.testing.assert_allclose(found[:, 0], wanted, rtol=1e-13)
    # a plain sum has no weight 1 to give
    assert splat(points[2:3], values[2:3], grid, Stencil(h=0.25, normalize="sum"), backend=backend).sum() == 0.0


@pytest.mark.parametrize("kernel", STENCILS)
def test_points_that_ceased_to_be_finite_contribute_nothing(kernel):
    """Values are checked when bound; what blows up afterwards must not spoil the image or crash."""
    grid = Grid(rows=8, columns=8, spacing=SPACING)
    points = cloud(grid, 4)
    image, values = np.zeros((1, 1, 8, 8)), np.ones((4, 1))
    transfer = Transfer(grid, Stencil(kernel)).at(points)
    bound, back = transfer.splat(values, image), transfer.gather(image, values)
    points[0], points[2, 1] = np.nan, -np.inf
    bound()
    assert image.sum() == pytest.approx(2.0)
    assert bound.missed[0] == 2
    back()
    assert values[0] == 0.0 and values[2] == 0.0 and values[1] > 0.0


# ---------------------------------------------------------------------- worlds, threads, memory


def test_nothing_to_splat():
    grid = Grid(rows=5, columns=6, spacing=SPACING)
    none, empty = np.zeros((0, 2), np.float32), np.zeros((0, 3), np.float32)
    assert splat(none, empty, grid).shape == (1, 3, 5, 6)
    assert splat(none, empty, grid, start=[0]).shape == (0, 3, 5, 6)
    image = splat(none, empty, grid, start=[0, 0, 0])
    assert image.shape == (2, 3, 5, 6) and not image.any()
    assert gather(image, none, grid, start=[0, 0, 0]).shape == (0, 3)
    point = np.array([[0.5, 0.5]], np.float32)
    image = splat(point, np.ones((1, 1), np.float32), grid, start=[0, 0, 1, 1])
    np.testing.assert_allclose(image.sum(axis=(1, 2, 3)), [0.0, 1.0, 0.0], rtol=1e-6)


@pytest.mark.parametrize("kernel", ["poly6", "bspline"])
def test_worlds_and_threads_do_not_change_a_bit(kernel):
    grid = Grid(rows=30, columns=30, spacing=SPACING)
    start = np.array([0, 700, 700, 5600, 6000])  # the third world gathers in two chunks
    assert start[3] - start[2] > CHUNK
    points = border_cloud(grid, 6000, dtype=np.float32)
    values = np.random.default_rng(0).normal(size=(6000, 3)).astype(np.float32)
    bins = np.random.default_rng(1).integers(0, 2, 6000)
    options: dict[str, Any] = {"stencil": Stencil(kernel), "bins": 2}
    together = splat(points, values, grid, start=start, point_bin=bins, **options)
    back = gather(together, points, grid, start=start, point_bin=bins, **options)
    for w, (a, b) in enumerate(itertools.pairwise(start)):
        alone = splat(points[a:b], values[a:b], grid, point_bin=bins[a:b], **options)
        np.testing.assert_array_equal(alone[0], together[w])
        np.testing.assert_array_equal(gather(alone, points[a:b], grid, point_bin=bins[a:b], **options), back[a:b])
    for threads in (2, 3):
        again = splat(points, values, grid, start=start, point_bin=bins, threads=threads, **options)
        np.testing.assert_array_equal(again, together)
        again = gather(together, points, grid, start=start, point_bin=bins, threads=threads, **options)
        np.testing.assert_array_equal(again, back)


@pytest.mark.parametrize("kernel", STENCILS)
def test_tiles_do_not_change_a_bit(kernel):
    """Large images go tile by tile; points beyond the border and supports over several tiles included."""
    grid = Grid(rows=300, columns=700, spacing=SPACING)
    for bins, support, normalize in ((1, 2.0, "particle"), (2, 9.0, "sum"), (1, 0.4, "particle")):
        points = border_cloud(grid, 2000, dtype=np.float32)
        stencil = Stencil(kernel, h=support * SPACING, normalize=normalize)
        given = {
            "start": np.array([0, 900, 900], np.int32),
            "count": np.array([900, 0, 1100], np.int32),
            "place": points,
            "bin": np.random.default_rng(1).integers(0, bins, 2000).astype(np.int32),
        }
        group = points_group(grid, 3, "warp", "float32", **given)
        values = np.random.default_rng(0).normal(size=(2000, 2)).astype(np.float32)
        found = []
        for tiled, threads in ((False, 1), (True, 1), (True, 3)):
            image = np.zeros((3, 2 * bins, *grid.shape), np.float32)
            arrays = kernel_array(values, "warp"), kernel_array(image, "warp")
            bound = Splat(stencil, grid, group, *arrays, bins=bins, threads=threads, tiled=tiled)
            assert bound.tiled == tiled
            bound()
            bound()  # clears what the first call left
            found.append((image, bound.missed))
        for image, missed in found[1:]:
            np.testing.assert_array_equal(image, found[0][0])
            np.testing.assert_array_equal(missed, found[0][1])


@pytest.mark.parametrize("backend", ["warp", "numpy"])
def test_only_the_bands_that_points_reach_are_written(backend):
    """A mark in the other bands stays, and what the call before left is cleared."""
    grid = Grid(rows=5 * BAND + 3, columns=12, spacing=SPACING)
    points = np.array([[1.0, 4 * SPACING], [2.0, 4.4 * SPACING]])
    image = np.zeros((1, 2, *grid.shape))
    bound = Transfer(grid, backend=backend).at(points).splat(np.ones((2, 2)), image)
    image[:, :, BAND:] = 7.0
    bound()
    assert image[0, 0, :BAND].sum() == pytest.approx(2.0)
    assert (image[:, :, BAND:] == 7.0).all()
    image[:, :, 3 * BAND :] = 0.0
    points[:, 1] += 4 * BAND * SPACING  # into the fifth band, rows 34 to 38
    bound()
    assert not image[:, :, :BAND].any()
    assert (image[:, :, BAND : 3 * BAND] == 7.0).all()
    assert image[0, 1, 4 * BAND :].sum() == pytest.approx(2.0)


def test_a_splat_clears_and_writes_its_own_channels_only():
    grid = Grid(rows=20, columns=9, spacing=SPACING)
    points = cloud(grid, 30)
    image = np.full((1, 5, 20, 9), 3.0)
    image[:, 1:3] = 0.0
    count = np.array([30], np.int32)
    group = points_group(grid, 1, "warp", "float64", start=0 * count, count=count, place=points)
    arrays = kernel_array(np.ones((30, 2)), "warp"), kernel_array(image, "warp")
    bound = Splat(Stencil(), grid, group, *arrays, channel_offset=1)
    for _ in range(2):
        bound()
        assert (image[:, [0, 3, 4]] == 3.0).all()
        np.testing.assert_allclose(image[0, 1:3].sum(axis=(1, 2)), 30.0)


def test_a_million_particles_as_numpy_adds_them():
    grid = Grid(rows=257, columns=129, spacing=SPACING, origin=(5.0, -3.0))
    points = cloud(grid, 10**6)
    mass = np.random.default_rng(2).uniform(0.5, 1.5, 10**6)
    u = (points - grid.origin) / grid.spacing
    cell = np.minimum(u.astype(int), [127, 255])
    t = u - cell
    expected = np.zeros(grid.shape)
    for i, j in itertools.product((0, 1), (0, 1)):
        part = np.where(i, t[:, 1], 1 - t[:, 1]) * np.where(j, t[:, 0], 1 - t[:, 0])
        np.add.at(expected, (cell[:, 1] + i, cell[:, 0] + j), part * mass)
    image = splat(points, mass[:, None], grid, Stencil("bilinear"))
    np.testing.assert_allclose(image[0, 0], expected, rtol=1e-10)
    assert image.sum() == pytest.approx(mass.sum(), rel=1e-13)


# ---------------------------------------------------------------------- refusals


@pytest.mark.parametrize("normalize", ["particle", "shepard", "sum"])
def test_a_transfer_is_called_again_with_other_points(normalize):
    grid, stencil = Grid(rows=12, columns=9, spacing=SPACING), Stencil("cubic", h=0.6, normalize=normalize)
    transfer = Transfer(grid, stencil, threads=2)
    for count, dtype in ((20, np.float32), (3, np.float64)):
        points, values = (
            border_cloud(grid, count, dtype=dtype) if count > 3 else cloud(grid, count),
            np.ones((count, 2)),
        )
        values = values.astype(dtype)
        image = transfer.splat(points, values)
        np.testing.assert_array_equal(image, splat(points, values, grid, stencil))
        bound, again = transfer.at(points), np.zeros_like(image)
        run = bound.splat(values, again)
        for _ in range(2):
            run()
            np.testing.assert_array_equal(again, image)
        if normalize == "shepard":
            continue
        for reverse in (False, True) if normalize == "particle" else (False,):
            found = np.zeros_like(values)
            bound.gather(image, found, reverse=reverse)()
            np.testing.assert_array_equal(found, gather(image, points, grid, stencil, reverse=reverse))


def test_out_is_written_whole_and_returned():
    grid = Grid(rows=6, columns=7, spacing=SPACING)
    points, values = cloud(grid, 5), np.ones((5, 2))
    out = np.full((1, 2, 6, 7), 9.0)
    assert splat(points, values, grid, out=out) is out
    np.testing.assert_array_equal(out, splat(points, values, grid))
    back = np.full((5, 2), 9.0)
    assert gather(out, points, grid, out=back) is back
    np.testing.assert_array_equal(back, gather(out, points, grid))


def test_bad_input_is_refused_by_name_index_and_limit():
    grid = Grid(rows=6, columns=7, spacing=SPACING)
    points, values, image = cloud(grid, 4), np.ones((4, 2)), np.ones((1, 2, 6, 7))
    bad_point, bad_value, bad_image = points.copy(), values.copy(), image.copy()
    bad_point[3, 0], bad_value[1, 1], bad_image[0, 1, 2, 3] = np.nan, np.inf, np.nan
    for message, call in (
        (r"points\[3, 0\] is nan; it must be finite", lambda: splat(bad_point, values, grid)),
        (r"values\[1, 1\] is inf; it must be finite", lambda: splat(points, bad_value, grid)),
        (r"image\[0, 1, 2, 3\] is nan; it must be finite", lambda: gather(bad_image, points, grid)),
        (r"points has shape \(4, 4\); it must be \(n, 2\)", lambda: splat(np.ones((4, 4)), values, grid)),
        (r"points is a list", lambda: splat([[0.0, 0.0]], values, grid)),
        (r"points has dtype int64", lambda: splat(np.ones((4, 2), int), values, grid)),
        (r"points has strides .*; it must be contiguous", lambda: splat(np.ones((4, 4))[:, :2], values, grid)),
        (r"values has shape \(3, 2\); it must be \(4, any\)", lambda: splat(points, values[:3], grid)),
        (r"values has shape \(4, 0\)", lambda: splat(points, values[:, :0], grid)),
        (r"values has dtype float32; it must be float64", lambda: splat(points, values.astype("f"), grid)),
        (r"image has shape \(1, 2, 7, 6\)", lambda: gather(image.reshape(1, 2, 7, 6), points, grid)),
        (r"image has dtype float32", lambda: gather(image.astype("f"), points, grid)),
        (r"kernel is 'cone'", lambda: splat(points, values, grid, Stencil("cone"))),
        (r"normalize is 'all'", lambda: splat(points, values, grid, Stencil(normalize="all"))),
        (r"reverse needs 'particle'", lambda: gather(image, points, grid, Stencil(normalize="sum"), reverse=True)),
        (r"h is 0.0; it must be finite and > 0", lambda: splat(points, values, grid, Stencil(h=0.0))),
        (r"h is nan", lambda: splat(points, values, grid, Stencil(h=np.nan))),
        (r"normalize is 'shepard'", lambda: gather(image, points, grid, Stencil(normalize="shepard"))),
        (r"nearest is 1; it must be True or False", lambda: Stencil(nearest=1)),
        (
            r"h is 1000000000\.0 m, 4e\+09 spacings; it must be at most",
            lambda: splat(points, values, grid, Stencil(h=1e9)),
        ),
        (r"start\[1\] is 3; it must be the number of points, 4", lambda: splat(points, values, grid, start=[0, 3])),
        (
            r"start\[2\] is 1; it must be at least start\[1\], 2",
            lambda: splat(points, values, grid, start=[0, 2, 1, 4]),
        ),
        (r"bins is 0", lambda: splat(points, values, grid, bins=0)),
        (r"point_bin must say", lambda: splat(points, values, grid, bins=2)),
        (
            r"point_bin\[2\] is 2; it must lie in \[0, 1\]",
            lambda: splat(points, values, grid, bins=2, point_bin=[0, 1, 2, 0]),
        ),
        (r"threads is 0", lambda: splat(points, values, grid, threads=0)),
        (r"backend is 'c'", lambda: splat(points, values, grid, backend="c")),
        (r"out has shape \(1, 1, 6, 7\)", lambda: splat(points, values, grid, out=np.ones((1, 1, 6, 7)))),
        (r"out has dtype float32", lambda: gather(image, points, grid, out=np.ones((4, 2), np.float32))),
    ):
        with pytest.raises(ValueError, match=message):
            call()


@pytest.mark.parametrize("backend", ["warp", "numpy"])
@pytest.mark.parametrize("kernel", ["poly6", "bilinear", "bspline"])
@pytest.mark.parametrize("count", [1, 7, 60])
def test_points_in_space_have_the_images_of_those_in_the_plane(kernel, count, backend):
    """A z of any value, NaN too, is passed over, of numpy arrays, tensors and vec3 arrays, which lie as they are."""
    rng = np.random.default_rng(count)
    grid, stencil = Grid(rows=12, columns=14, spacing=0.5), Stencil(kernel)
    flat = rng.uniform(0.0, 5.0, (count, 2)).astype(np.float32)
    deep = np.full((count, 3), np.nan, np.float32)
    deep[:, :2] = flat
    values = rng.normal(size=(count, 2)).astype(np.float32)
    image = splat(flat, values, grid, stencil, backend=backend)
    back = gather(image, flat, grid, stencil, backend=backend)
    for points in (deep, wp.array(deep, dtype=wp.vec3, copy=False), torch.from_numpy(deep)):
        np.testing.assert_array_equal(splat(points, values, grid, stencil, backend=backend), image)
        np.testing.assert_array_equal(gather(image, points, grid, stencil, backend=backend), back)
    bound = Transfer(grid, stencil, backend=backend).at(deep).splat(values, moved := np.zeros_like(image))
    deep[:, 0] *= np.float32(0.5)
    bound()
    np.testing.assert_array_equal(moved, splat(deep[:, :2].copy(), values, grid, stencil, backend=backend))
    deep[count // 2, 1] = np.inf
    with pytest.raises(ValueError, match=rf"points\[{count // 2}, 1\] is inf; it must be finite"):
        splat(deep, values, grid, stencil, backend=backend)


def test_points_in_space_are_splatted_by_tiles_too():
    rng = np.random.default_rng(0)
    grid = Grid(rows=1500, columns=1500, spacing=0.5)
    deep = rng.uniform(0.0, 749.0, (500, 3)).astype(np.float32)
    values = rng.normal(size=(500, 1)).astype(np.float32)
    np.testing.assert_array_equal(splat(deep, values, grid), splat(deep[:, :2].copy(), values, grid))


def test_what_is_written_shares_no_memory_with_what_is_read():
    grid = Grid(rows=3, columns=4, spacing=1.0)
    points = np.random.default_rng(0).uniform(0.0, 3.0, (12, 2))
    with pytest.raises(ValueError, match="out shares memory with values; it is written to"):
        splat(points, (values := np.ones((12, 1))), grid, out=values.reshape(1, 1, 3, 4))
    with pytest.raises(ValueError, match="out shares memory with points; it is written to"):
        gather(np.ones((1, 2, 3, 4)), points, grid, out=points)
    with pytest.raises(ValueError, match="image shares memory with values"):
        Transfer(grid).at(points).splat(values, values.reshape(1, 1, 3, 4))
    values.flags.writeable = False
    with pytest.raises(ValueError, match="values is read-only; it must be writable"):
        Transfer(grid).at(points).gather(np.ones((1, 1, 3, 4)), values)


@pytest.mark.parametrize("threads", [1, 2])
def test_slices_between_which_an_interrupt_may_arrive_keep_the_bits(monkeypatch, threads):
    draw = np.random.default_rng(5)
    grid, stencil = Grid(rows=150, columns=170, spacing=0.1), Stencil(h=0.5)
    points = draw.uniform(-1.0, 18.0, (9000, 2)).astype(np.float32)
    values, start = draw.normal(size=(9000, 2)).astype(np.float32), [0, 10, 9000]
    options = {"stencil": stencil, "start": start, "threads": threads}
    whole = splat(points, values, grid, **options)
    back = gather(whole, points, grid, **options)
    monkeypatch.setattr("dc_kernels.runtime.threads.SLICE", 1e6)
    np.testing.assert_array_equal(splat(points, values, grid, **options), whole)
    np.testing.assert_array_equal(gather(whole, points, grid, **options), back)


@pytest.mark.parametrize("backend", ["warp", "taichi"])
@pytest.mark.parametrize("limit", [0.0, 1e8])
def test_points_that_reach_too_many_tiles_or_crowd_in_one_are_splatted_part_by_part(monkeypatch, backend, limit):
    """What the call before touched is cleared also where that was interrupted between two parts."""
    draw = np.random.default_rng(6)
    grid, stencil = Grid(rows=40, columns=70, spacing=0.1), Stencil(h=0.5)
    points = draw.uniform(-1.0, 8.0, (4000, 2)).astype(np.float32)
    values, start = draw.normal(size=(4000, 2)).astype(np.float32), [0, 10, 4000]
    whole, out = (np.zeros((2, 2, *grid.shape), np.float32) for _ in range(2))
    options = {"backend": backend}
    at_once = Transfer(grid, stencil, **options).at(points, start=start).splat(values, whole)
    at_once()
    monkeypatch.setattr("dc_kernels.runtime.threads.SLICE", 5e4)
    monkeypatch.setattr("dc_kernels.grid.splat.MOST_REACHED", limit)
    bound = Transfer(grid, stencil, **options).at(points, start=start).splat(values, out)
    assert bound.tiled == (limit > 0.0)
    calls = []

    def interrupt(launches, threads):
        calls.append(launches)
        if len(calls) == 15:
            raise KeyboardInterrupt
        for launch in launches:
            launch()

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr("dc_kernels.grid.splat.run_shards", interrupt)
        bound()
    for _ in range(2):
        bound()
        np.testing.assert_array_equal(out, whole)
    assert bound.missed.tolist() == at_once.missed.tolist() and bound.missed[1] > 0
