"""Neighbours found by Taichi's kernels: what Warp's find, in the same order, on the caller's memory."""

import numpy as np
import pytest
import torch

import dc_kernels as dc
from dc_kernels.neighbors.search import neighbor_lists, neighbor_pairs
from dc_kernels.runtime.backends import argument_names, make_kernels

pytest.importorskip("taichi")
BACKENDS = ("warp", "taichi")


@pytest.mark.parametrize("dim", [2, 3])
def test_kernels_have_the_names_and_arguments_of_warp(dim: int) -> None:
    warp, taichi = (make_kernels(backend, "neighbors.search", "float32", dim) for backend in BACKENDS)
    assert list(taichi) == list(warp)
    assert {n: argument_names(k) for n, k in taichi.items()} == {n: argument_names(k) for n, k in warp.items()}


def clouds(dim: int, dtype: str) -> dict[str, tuple[np.ndarray, float]]:
    """Points by what is special about them, and a radius."""
    draw = np.random.default_rng(4)
    spread = draw.uniform(0.0, 1.0, (6000, dim))
    return {
        "dense": (spread.astype(dtype), 0.03 if dim == 2 else 0.1),
        "crowded": (spread[:900].astype(dtype), 0.3),  # lists too long to be ranked
        "scattered": ((spread[:5000] * draw.choice([1.0, 1e3, 1e6], (5000, 1))).astype(dtype), 0.05),
        "alone": (spread[:3].astype(dtype), 0.5),
        "nothing": (spread[:0].astype(dtype), 0.5),
        "grid": (np.array(np.argwhere(np.ones((12,) * dim)), dtype, order="C"), 1.0),  # many as far apart as the radius
    }


@pytest.mark.parametrize(("dim", "dtype"), [(2, "float32"), (3, "float64")])
def test_pairs_and_lists_are_those_of_warp(dim: int, dtype: str) -> None:
    for name, (points, radius) in clouds(dim, dtype).items():
        start = np.array([0, len(points) // 3, len(points)])
        queries = points[: start[1]]
        found = []
        for backend in BACKENDS:
            pairs = neighbor_pairs(points, radius, start=start, threads=2, backend=backend)
            same = neighbor_lists(points, points, radius, query_start=start, point_start=start, backend=backend)
            other = neighbor_lists(queries, points, radius, backend=backend)
            found.append([pairs, same.start, same.index, other.start, other.index])
        for warp, taichi in zip(*found, strict=True):
            np.testing.assert_array_equal(taichi, warp, err_msg=name)


def test_a_search_grows_as_points_move_and_tells_what_is_wrong() -> None:
    memory = torch.rand((400, 2), generator=torch.Generator().manual_seed(2))
    searches = [dc.NeighborSearch(memory, 0.2, start=[0, 150, 400], backend=backend) for backend in BACKENDS]
    for factor in (1.0, 0.2, 3.0):
        memory *= factor
        for search in searches:
            search()
        np.testing.assert_array_equal(searches[1].numpy(), searches[0].numpy())
        np.testing.assert_array_equal(searches[1].count, searches[0].count.numpy())
    assert searches[1].layout_version > 0
    memory[17, 1] = torch.nan
    with pytest.raises(ValueError, match=r"points\[17, 1\] is nan"):
        searches[1]()
    with pytest.raises(OverflowError, match=r"world 0 has .* pairs; max_pairs is 3"):
        dc.NeighborSearch(torch.zeros((10, 2)), 0.2, max_pairs=3, backend="taichi")()


def test_other_methods_are_refused() -> None:
    with pytest.raises(ValueError, match="backend is 'taichi' and method is 'tree'"):
        neighbor_pairs(np.zeros((2, 2), np.float32), 1.0, method="tree", backend="taichi")
