"""Arrays of other libraries are read and written where they lie."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

import dc_kernels as dc
from dc_kernels.grid.grid import Grid
from dc_kernels.grid.transfer import gather, splat
from tests.lending import Dlpack


def test_arrays_of_warp_and_torch_are_read_where_they_lie():
    """Vectors of Warp, torch tensors and numpy give the same bits, and ``out`` is written in place."""
    torch = pytest.importorskip("torch")
    draw = np.random.default_rng(3)
    grid = Grid.thesis()
    points = draw.uniform(0, 15, (50, 2)).astype(np.float32)
    values = draw.normal(size=(50, 3)).astype(np.float32)
    expected = splat(points, values, grid)
    vectors = wp.array(points, dtype=wp.vec2, device="cpu")
    np.testing.assert_array_equal(splat(vectors, wp.array(values, device="cpu"), grid), expected)
    out = torch.full(expected.shape, 7.0)
    image = splat(torch.from_numpy(points), torch.from_numpy(values), grid, out=out)
    assert image.ctypes.data == out.data_ptr()
    np.testing.assert_array_equal(out.numpy(), expected)
    np.testing.assert_array_equal(gather(out, vectors, grid), gather(expected, points, grid))
    np.testing.assert_array_equal(dc.neighbor_pairs(vectors, 1.0), dc.neighbor_pairs(points, 1.0))
    with pytest.raises(ValueError, match="values requires a gradient, which would be lost"):
        splat(points, torch.from_numpy(values).requires_grad_(), grid)
    with pytest.raises(ValueError, match=r"points has strides .* it must be contiguous"):
        splat(torch.from_numpy(points)[::2], values[::2], grid)


def test_what_an_output_held_does_not_matter():
    grid = Grid.thesis()
    points = np.random.default_rng(4).uniform(0, 15, (20, 2))
    values = np.ones((20, 2))
    image = splat(points, values, grid)
    np.testing.assert_array_equal(splat(points, values, grid, out=np.full_like(image, np.nan)), image)
    found = gather(image, points, grid)
    np.testing.assert_array_equal(gather(image, points, grid, out=np.full_like(found, np.nan)), found)


def test_memory_that_numpy_cannot_show_is_named():
    torch = pytest.importorskip("torch")
    plain = torch.zeros(4, 2)
    for odd in (plain.bfloat16(), plain.to_sparse(), torch._neg_view(plain), Dlpack(plain.bfloat16())):
        with pytest.raises(TypeError, match="points is not plain numbers in memory: "):
            dc.NeighborSearch(odd, 0.1)
    with pytest.raises(TypeError, match="points is a MaskedArray; it must be a numpy array"):
        dc.NeighborSearch(np.ma.masked_array(np.zeros((4, 2)), np.eye(4, 2)), 0.1)
    assert len(dc.NeighborSearch(Dlpack(plain), 0.1).points) == 4
    early = Dlpack(wp.zeros(2, dtype=int, device="cpu"))
    with pytest.raises(ValueError, match=r"color is read-only \(by DLPack before 1\.0\? then give torch\.from_dlpack"):
        dc.color(np.zeros(2, np.int32), np.ones(2, np.int32), np.ones(2), color=early)
    color = torch.from_dlpack(early)
    color[:] = -1
    dc.color(np.zeros(2, np.int32), np.ones(2, np.int32), np.ones(2), color=color)
    np.testing.assert_array_equal(early.array.numpy(), [0, 1])
