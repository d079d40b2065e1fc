"""Splat, gather and their gradients: closed forms, conservation, adjointness, and the kernels against the oracle."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest

from dc_kernels.grid.grid import Grid
from dc_kernels.grid.layout import BAND
from dc_kernels.grid.splat import points_group, stencil_group, transfer_kernels
from dc_kernels.grid.stencil import Stencil
from dc_kernels.grid.transfer import gather, splat
from dc_kernels.sph.smoothing import STENCILS, smoothing
from tests.grid.places import RADIAL, SEPARABLE, SPACING, border_cloud, cloud, launch

# relative to the largest entry; in float32 a point whose support barely reaches a node has weights of few digits, and
# the derivatives of their ratio fewer
BOUND = {"float64": 1e-11, "float32": 5e-5}
GRADIENT_BOUND = {"float64": 1e-9, "float32": 2e-3}


def weights(points: np.ndarray, grid: Grid, stencil: Stencil) -> np.ndarray:
    """The matrix of the splat, (nodes, points), found by splatting one point at a time."""
    worlds = splat(points, np.ones((len(points), 1), points.dtype), grid, stencil, start=range(len(points) + 1))
    return worlds.reshape(len(points), -1).T


# ---------------------------------------------------------------------- the oracle


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("normalize", ["sum", "particle"])
@pytest.mark.parametrize("kernel", STENCILS)
def test_kernels_agree_with_the_oracle(kernel, normalize, dtype):
    """Three worlds, one without points, at channels amid others; small and narrow grids; supports of all sizes."""
    draw = np.random.default_rng(5)
    counts = np.array([9, 0, 14], np.int32)
    start, total = np.array([0, 9, 9], np.int32), 23
    world = np.repeat([0, 1, 2], counts)
    tables = {backend: transfer_kernels(backend, dtype) for backend in ("warp", "numpy")}
    shapes = (((13, 9), 2.0), ((2, 2), 0.4), ((2, 40), 8.0), ((19, 11), 1.3))
    for (shape, support), nearest, bins in itertools.product(shapes, (False, True), (1, 3)):
        channels, before = int(draw.integers(1, 7)), int(draw.integers(0, 3))
        origin = draw.normal(size=(3, 2)).astype(dtype)
        size = SPACING * np.array(shape[::-1])
        points = (draw.uniform(-0.4, 1.4, (total, 2)) * size + origin[world]).astype(dtype)
        points[4], points[11, 1], points[20, 0] = np.nan, np.inf, 1e30
        values = draw.normal(size=(total, channels)).astype(dtype)
        field = draw.normal(size=(3, before + bins * channels + 1, *shape)).astype(dtype)
        given = {
            "origin": origin,
            "start": start,
            "count": counts,
            "place": points,
            "bin": draw.integers(0, bins, total).astype(np.int32),
        }
        grid = Grid(rows=shape[0], columns=shape[1], spacing=SPACING)
        stencil = Stencil(kernel, h=support * SPACING, normalize=normalize, nearest=nearest)
        scalars = {"bins": bins, "channel_offset": before, "world_offset": 0, "chunks": 1}
        found: dict[str, list[np.ndarray]] = {}
        for backend, table in tables.items():
            scalars["stencil"] = stencil_group(stencil, grid, backend, dtype)
            scalars["points"] = points_group(grid, 3, backend, dtype, **given)
            image = np.zeros_like(field)
            touched = np.zeros((3, -(-shape[0] // BAND)), np.int32)
            missed = np.full(3, -1, np.int32)
            arrays = {"value": values, "touched": touched, "missed": missed, "image": image}
            launch(table, "splat_worlds", 3, arrays, backend, **scalars)
            value, gradient = np.full_like(values, 9.0), np.full_like(points, 9.0)
            launch(table, "gather_points", 3, {"image": field, "value": value}, backend, **scalars)
            arrays = {"image": field, "value": values, "gradient": gradient}
            launch(table, "gather_gradient", 3, arrays, backend, **scalars)
            found[backend] = [image, value, gradient, missed, touched]
        # a derivative that is 0 because one node takes all is a difference of terms that are not
        least = (1e-30, 1e-30, 1 / SPACING)
        for fast, slow, bound, scale in zip(found["warp"], found["numpy"], (BOUND, BOUND, GRADIENT_BOUND), least):
            np.testing.assert_allclose(fast, slow, rtol=0, atol=bound[dtype] * max(np.abs(slow).max(), scale))
        np.testing.assert_array_equal(found["warp"][3], found["numpy"][3])
        assert (found["warp"][4] >= found["numpy"][4]).all()  # each band that was written is marked


@pytest.mark.parametrize("backend", ["warp", "numpy"])
def test_division_by_the_weights_of_each_bin(backend):
    draw = np.random.default_rng(1)
    weight = np.maximum(draw.normal(size=(2, 3, 4, 5)), 0.0)
    image = draw.normal(size=(2, 6, 4, 5))
    by = weight.repeat(2, axis=1)
    expected = np.divide(image, by, out=np.zeros_like(image), where=by > 0)
    launch(
        transfer_kernels(backend, "float64"),
        "divide_image",
        2,
        {"weight": weight, "image": image},
        backend,
        world_offset=0,
    )
    np.testing.assert_allclose(image, expected, rtol=1e-15)


@pytest.mark.parametrize("normalize", ["sum", "particle"])
@pytest.mark.parametrize("kernel", RADIAL)
def test_radial_weights_are_those_of_all_nodes_within_the_support(kernel, normalize):
    """Against the dense matrix; supports from less than a cell to more than the grid."""
    for shape, support in (((9, 12), 0.6), ((9, 12), 2.0), ((30, 25), 8.0), ((5, 3), 20.0), ((2, 40), 5.5)):
        grid = Grid(rows=shape[0], columns=shape[1], spacing=SPACING, origin=(-1.0, 2.0))
        points = border_cloud(grid, 40)
        h = support * SPACING
        far = np.linalg.norm(grid.nodes().reshape(-1, 1, 2) - points, axis=-1)
        dense = smoothing(kernel, far, h)
        if normalize == "particle":
            dense /= np.maximum(dense.sum(axis=0), 1e-300)
        found = weights(points, grid, Stencil(kernel, h=h, normalize=normalize, nearest=False))
        np.testing.assert_allclose(found, dense, rtol=1e-9, atol=1e-13 * dense.max())


@pytest.mark.parametrize("backend", ["warp", "numpy"])
@pytest.mark.parametrize("normalize", ["sum", "particle"])
@pytest.mark.parametrize("kernel", STENCILS)
def test_gradient_is_that_of_the_gather(kernel, normalize, backend):
    """Central differences, where the derivative exists and is not huge: not on grid lines, nodes barely reached."""
    grid = Grid(rows=7, columns=9, spacing=SPACING, origin=(0.5, -0.5))
    h, step = 0.53, 1e-6
    points = cloud(grid, 60, seed=3, margin=1.5)
    offset = (points - grid.origin) / SPACING
    far = np.linalg.norm(grid.nodes().reshape(-1, 1, 2) - points, axis=-1)
    reached = far.min(axis=0) < 0.8 * h
    points = np.ascontiguousarray(points[(np.abs(offset - np.round(offset)).min(axis=1) > 1e-3) & reached])
    assert len(points) > 30
    draw = np.random.default_rng(2)
    image, values = draw.normal(size=(1, 3, 7, 9)), draw.normal(size=(len(points), 3))
    stencil = Stencil(kernel, h=h, normalize=normalize)
    expected = np.empty_like(points)
    for axis in range(2):
        shift = step * np.eye(2)[axis]
        ends = [gather(image, points + sign * shift, grid, stencil, backend=backend) for sign in (1, -1)]
        expected[:, axis] = (values * (ends[0] - ends[1])).sum(axis=1) / (2 * step)
    gradient, all_points = np.empty_like(points), np.array([len(points)], np.int32)
    groups = {
        "stencil": stencil_group(stencil, grid, backend, "float64"),
        "points": points_group(grid, 1, backend, "float64", start=0 * all_points, count=all_points, place=points),
    }
    arrays = {"image": image, "value": values, "gradient": gradient}
    scalars = {"bins": 1, "channel_offset": 0, "world_offset": 0, "chunks": 1}
    launch(transfer_kernels(backend, "float64"), "gather_gradient", 1, arrays, backend, **groups, **scalars)
    np.testing.assert_allclose(gradient, expected, rtol=0, atol=1e-7 * np.abs(expected).max())


# ---------------------------------------------------------------------- what a transfer keeps


@pytest.mark.parametrize("support", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("kernel", STENCILS)
def test_particle_weights_conserve_every_channel(kernel, support):
    grid = Grid(rows=33, columns=21, spacing=SPACING, origin=(3.0, -7.0))
    points = border_cloud(grid, 3000, dtype=np.float32)
    values = np.random.default_rng(1).uniform(0.5, 2.0, (3000, 3)).astype(np.float32)
    image = splat(points, values, grid, Stencil(kernel, h=support * SPACING))
    given = values.sum(axis=0, dtype=np.float64)
    np.testing.assert_allclose(image[0].sum(axis=(1, 2), dtype=np.float64), given, rtol=1e-6)


@pytest.mark.parametrize("kernel", STENCILS)
def test_averages_and_gathers_reproduce_constants(kernel):
    grid = Grid(rows=10, columns=17, spacing=SPACING)
    points = border_cloud(grid, 50)
    constant = np.array([1.0, -3.5])
    average = splat(points, np.tile(constant, (50, 1)), grid, Stencil(kernel, normalize="shepard"))
    reached = splat(points, np.ones((50, 1)), grid, Stencil(kernel, normalize="sum"))[0, 0] > 0
    assert reached.any() and not reached.all()
    for c, expected in enumerate(constant):
        np.testing.assert_allclose(average[0, c][reached], expected, rtol=1e-12)
        assert not average[0, c][~reached].any()
    image = np.tile(constant[:, None, None], (1, 1, 10, 17))
    np.testing.assert_allclose(gather(image, points, grid, Stencil(kernel)), np.tile(constant, (50, 1)), rtol=1e-12)


@pytest.mark.parametrize("kernel", SEPARABLE)
def test_linear_fields_are_reproduced_up_to_the_border(kernel):
    for rows, columns in ((2, 2), (2, 40), (3, 5), (20, 4)):
        grid = Grid(rows=rows, columns=columns, spacing=SPACING, origin=(-2.0, 1.0))
        points = border_cloud(grid, 60)
        image = (1.5 + grid.nodes() @ [2.0, -3.0])[None, None]
        inside = np.clip(points, grid.origin, grid.upper)  # beyond the grid the border's value holds on
        found = gather(np.ascontiguousarray(image), points, grid, Stencil(kernel))
        np.testing.assert_allclose(found[:, 0], 1.5 + inside @ [2.0, -3.0], rtol=0, atol=1e-12)


def test_reverse_gives_back_what_was_splatted():
    """The sum over the nodes always; each point's own value where no two supports overlap (reverse SPH)."""
    grid = Grid(rows=20, columns=20, spacing=SPACING)
    values = np.random.default_rng(4).normal(size=(4, 2))
    apart = np.array([[0.6, 0.7], [3.0, 0.65], [0.7, 3.1], [3.3, 3.3]])
    image = splat(apart, values, grid)
    np.testing.assert_allclose(gather(image, apart, grid, Stencil(), reverse=True), values, rtol=1e-12)
    together = cloud(grid, 4, seed=1) * 0.2 + 1.0
    image = splat(together, values, grid)
    back = gather(image, together, grid, Stencil(), reverse=True)
    np.testing.assert_allclose(back.sum(axis=0), values.sum(axis=0), rtol=1e-12)
    np.testing.assert_allclose(image, splat(together, values, grid))  # the caller's image is as it was


@pytest.mark.parametrize(("dtype", "bound"), [("float32", 2e-6), ("float64", 1e-14)])
@pytest.mark.parametrize("normalize", ["sum", "particle"])
@pytest.mark.parametrize("kernel", STENCILS)
def test_gather_is_the_transpose_of_splat(kernel, normalize, dtype, bound):
    """<S f, g> = <f, S^T g>, to the round-off of sums of such length."""
    grid = Grid(rows=11, columns=14, spacing=SPACING)
    draw = np.random.default_rng(8)
    points = border_cloud(grid, 200, dtype=dtype)
    start, bins = [0, 90, 90, 200], draw.integers(0, 2, 200)
    f = draw.normal(size=(200, 3)).astype(dtype)
    g = draw.normal(size=(3, 6, 11, 14)).astype(dtype)
    options: dict[str, Any] = {"stencil": Stencil(kernel, normalize=normalize), "start": start}
    options.update(bins=2, point_bin=bins)
    image, back = splat(points, f, grid, **options), gather(g, points, grid, **options)
    left, right = np.vdot(image.astype(float), g), np.vdot(f, back.astype(float))
    scale = np.linalg.norm(image) * np.linalg.norm(g)
    assert abs(left - right) <= bound * scale
