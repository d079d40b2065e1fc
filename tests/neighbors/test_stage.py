"""A bound search finds what ``neighbor_pairs`` does, in the memory of its owner, call after call and in a graph."""

import numpy as np
import pytest
import torch
import warp as wp

import dc_kernels as dc


def worlds(count, dim=2, dtype=np.float32, seed=0, empty=True):
    """Points of several worlds, one of them empty, and where each begins."""
    rng = np.random.default_rng(seed)
    sizes = rng.multinomial(count, (0.1, 0.6, 0.3))
    start = np.concatenate([[0], np.cumsum(np.insert(sizes, 1, 0) if empty else sizes)])
    return rng.uniform(-3.0, 3.0, (count, dim)).astype(dtype), start


def in_order(pairs):
    return pairs[np.lexsort(pairs.T[::-1])]


def check(search, points, radius, start):
    """The pairs in the order of ``neighbor_pairs``, and world by world where the fields say."""
    wanted = dc.neighbor_pairs(points, radius, start=start)
    np.testing.assert_array_equal(search.numpy(), wanted)
    owner = np.searchsorted(start, wanted[:, 0], side="right") - 1
    pairs, count, first = (np.asarray(getattr(search, name)) for name in ("pairs", "count", "pair_start"))
    for w in range(len(start) - 1):
        np.testing.assert_array_equal(pairs[first[w] : first[w] + count[w]], wanted[owner == w])


@pytest.mark.parametrize("backend", ["warp", "numpy"])
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_pairs_follow_the_points(dim, dtype, backend):
    points, start = worlds(120, dim, dtype)
    search = dc.NeighborSearch(points, 0.9, start=start, threads=2, backend=backend)
    kept = search.pairs
    for seed in (0, 1):
        points[:] = worlds(120, dim, dtype, seed)[0]
        assert search() is search.count
        check(search, points, 0.9, start)
    assert search.pairs is kept and search.layout_version == 0


def test_threads_do_not_change_the_pairs():
    points, start = worlds(5000)
    one, two = (dc.NeighborSearch(points, 0.2, start=start, threads=threads) for threads in (1, 3))
    one(), two()
    np.testing.assert_array_equal(one.numpy(), two.numpy())
    check(two, points, 0.2, start)


@pytest.mark.parametrize("kind", ["torch", "warp", "dlpack"])
def test_memory_of_others_is_read_where_it_lies(kind):
    class Foreign:
        """Known by the protocol alone."""

        def __init__(self, array):
            self.__dlpack__, self.__dlpack_device__ = array.__dlpack__, array.__dlpack_device__

    points, start = worlds(200)
    given = {"torch": torch.from_numpy, "warp": lambda a: wp.array(a, dtype=wp.vec2, copy=False), "dlpack": Foreign}
    search = dc.NeighborSearch(given[kind](points), 0.5, start=start)
    points *= 0.5
    search()
    check(search, points, 0.5, start)


def test_room_grows_or_the_lack_of_it_is_an_error():
    points, start = worlds(300)
    points *= 0.02  # all of a world are near each other
    search = dc.NeighborSearch(points, 1.0, start=start)
    left = np.asarray(search.count)
    search()
    assert search.layout_version == 1 and (left == -1).all()
    check(search, points, 1.0, start)
    counts = np.diff(start)
    room = counts * (counts - 1) // 2
    exact = dc.NeighborSearch(points, 1.0, start=start, max_pairs=room)
    exact()
    check(exact, points, 1.0, start)
    room[2] -= 1
    short = dc.NeighborSearch(points, 1.0, start=start, max_pairs=room)
    with pytest.raises(OverflowError, match=rf"world 2 has {room[2] + 1} pairs; max_pairs is {room[2]}"):
        short()


def test_a_search_becomes_part_of_a_graph():
    points, start = worlds(200)
    search = dc.NeighborSearch(points, 0.5, start=start, max_pairs=500, threads=2)
    before = points.copy()
    with wp.ScopedCapture(device="cpu") as capture:
        search()
    for scale in (1.0, 0.7):
        points[:] = before * np.float32(scale)
        wp.capture_launch(capture.graph)
        search.check()
        check(search, points, 0.5, start)
    points *= 0.001
    wp.capture_launch(capture.graph)
    with pytest.raises(OverflowError, match=r"world 2 has \d+ pairs; max_pairs is 500"):
        search.check()
    points[7, 1] = np.nan
    wp.capture_launch(capture.graph)
    with pytest.raises(ValueError, match=r"points\[7, 1\] is nan; it must be finite"):
        search.check()


@pytest.mark.parametrize("backend", ["warp", "numpy"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_point_that_is_not_finite_is_named_and_its_world_left_out(value, backend):
    for index in (1, 60, 119):
        points, start = worlds(120)
        search = dc.NeighborSearch(points, 0.9, start=start, backend=backend)
        search()
        whole = np.asarray(search.count).copy()
        points[index, 1] = value
        with pytest.raises(ValueError, match=rf"points\[{index}, 1\] is {value}; it must be finite"):
            search()
        w = int(np.searchsorted(start, index, side="right")) - 1
        whole[w] = 0
        np.testing.assert_array_equal(np.asarray(search.count), whole)


def test_bad_input_is_named():
    good = np.zeros((4, 2), np.float32)
    for points, options, message in (
        (np.zeros((4, 4), np.float32), {}, r"points has shape \(4, 4\); it must be \(n, 2\) or \(n, 3\)"),
        (np.zeros((4, 4))[:, ::2], {}, r"points has strides .*; it must be contiguous"),
        ([[0.0, 0.0]], {}, r"points is a list; it must be a numpy array"),
        (torch.zeros(4, 2, requires_grad=True), {}, r"points requires a gradient"),
        (good, {"radius": -1.0}, r"radius is -1.0; it must be finite and > 0"),
        (good, {"start": [0, 3]}, r"start\[1\] is 3; it must be the number of points, 4"),
        (good, {"max_pairs": -1}, r"max_pairs\[0\] is -1; it must lie in \[0, 2147483647\]"),
        (good, {"max_pairs": 2.5}, r"max_pairs is 2.5; it must be an integer or \(1,\)"),
        (good, {"threads": 0}, r"threads is 0"),
        (good, {"backend": "jax"}, r"backend is 'jax'"),
    ):
        with pytest.raises(ValueError, match=message):
            dc.NeighborSearch(points, **{"radius": 1.0, **options})
    wide = np.array([[1e308, 0.0], [-1e308, 0.0]])
    with pytest.raises(ValueError, match=r"points of world 0 span more than float64 holds on axis 0"):
        dc.NeighborSearch(wide, 1.0)()


def test_a_graph_of_before_the_room_grew_is_told_of():
    points, start = worlds(300)
    search = dc.NeighborSearch(points, 1.0, start=start)
    with wp.ScopedCapture(device="cpu") as capture:
        search()
    points *= 0.02  # all of a world are near each other
    search()
    wp.capture_launch(capture.graph)
    with pytest.raises(RuntimeError, match=r"recorded before layout_version changed to 1: .*; record it anew"):
        search.check()
    check(search, points, 1.0, start)
    search.check()
