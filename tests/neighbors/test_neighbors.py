"""Neighbour search: every method finds what all pairs do, and the sorted cells are those of the oracle."""

import _thread
import functools
import itertools
import threading
import tracemalloc
import weakref
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dc_kernels.model.arrays import to_numpy
from dc_kernels.neighbors import cells as cell_search
from dc_kernels.neighbors import search
from dc_kernels.neighbors.cells import SortedCells, Workspace, shards_of
from dc_kernels.neighbors.fields import CELLS
from dc_kernels.neighbors.search import METHODS, neighbor_lists, neighbor_pairs


def test_a_long_search_is_left_to_itself_at_an_interrupt(monkeypatch):
    points = np.random.default_rng(0).uniform(0, 1, (500, 2))
    whole, begun, goes_on, ended = neighbor_pairs(points, 0.1), threading.Event(), threading.Event(), threading.Event()

    def slow(*args):
        begun.set()
        goes_on.wait()
        pairs.append(hash_pairs(*args))
        ended.set()

    pairs, hash_pairs = [], search.hash_pairs
    monkeypatch.setattr(search, "LONG", len(points))
    monkeypatch.setattr(search, "hash_pairs", slow)
    threading.Thread(target=lambda: (begun.wait(), _thread.interrupt_main())).start()
    with pytest.raises(KeyboardInterrupt):
        neighbor_pairs(points, 0.1)
    assert not ended.is_set()
    kept = points.copy()
    points[:] = np.nan  # it has copies
    goes_on.set()
    assert ended.wait(200)
    monkeypatch.undo()
    assert np.array_equal(pairs[0], whole)
    assert np.array_equal(neighbor_pairs(kept, 0.1), whole)


def in_order(pairs):
    assert pairs.dtype == np.int32
    assert (pairs[:, 0] < pairs[:, 1]).all()
    return pairs[np.lexsort(pairs.T[::-1])]


def by_definition(queries, points, radius, query_start=None, point_start=None):
    """Lists of neighbours, one distance after the other in the points' dtype."""
    r = points.dtype.type(radius)
    query_start = [0, len(queries)] if query_start is None else query_start
    point_start = [0, len(points)] if point_start is None else point_start
    lists = []
    for w in range(len(query_start) - 1):
        for q in queries[query_start[w] : query_start[w + 1]]:
            d = q - points[point_start[w] : point_start[w + 1]]
            with np.errstate(over="ignore", under="ignore"):
                square = d[:, 0] * d[:, 0] + d[:, 1] * d[:, 1]
                if d.shape[1] == 3:
                    square = square + d[:, 2] * d[:, 2]
            lists.append(point_start[w] + np.flatnonzero(square <= r * r))
    return lists


def check(points, radius, start=None, queries=None, query_start=None):
    """Pairs and lists of all methods against the definition."""
    lists = by_definition(points, points, radius, start, start)
    wanted = np.array([(i, j) for i, near in enumerate(lists) for j in near if j > i], np.int32).reshape(-1, 2)
    if queries is None:
        queries, query_start = points, start
    lists = by_definition(queries, points, radius, query_start, start)
    for method in METHODS:
        found = in_order(neighbor_pairs(points, radius, method=method, start=start))
        np.testing.assert_array_equal(found, wanted, err_msg=method)
        near = neighbor_lists(
            queries, points, radius, method=method, query_start=query_start, point_start=start, threads=2
        )
        assert near.index.dtype == np.int32
        assert near.start.dtype == np.int64
        np.testing.assert_array_equal(np.diff(near.start), [len(one) for one in lists], err_msg=method)
        np.testing.assert_array_equal(near.index, np.concatenate([[], *lists]), err_msg=method)
    return wanted


def scattered(dim, kind, rng):
    """(points, radius) whose cells differ in kind."""
    if kind == "even":
        return rng.random((400, dim)), 0.1
    if kind == "crowded":  # many more than a block of lanes in a cell
        return rng.normal(size=(300, dim)), 0.8
    if kind == "clusters":  # 1e5 m apart: far more lines and columns than points
        return rng.integers(-3, 4, (300, dim)) * 1e5 + rng.random((300, dim)), 0.25
    if kind == "far":  # few units in the last place wide
        return 1e6 + rng.random((300, dim)), 0.2
    if kind == "wide":  # wider than 2^30 radii: cells are larger then
        return np.concatenate([rng.random((200, dim)) * 1e-3, [[1e9] * dim, [-1e9] * dim]]), 1e-4
    if kind == "coincident":
        return np.full((150, dim), 3.25), 1e-3
    lattice = np.stack(np.meshgrid(*[np.arange(-4, 5) * 0.25] * dim), -1).reshape(-1, dim)
    return rng.permutation(lattice)[:400], 0.25  # distances exactly the radius


KINDS = ("even", "crowded", "clusters", "far", "wide", "coincident", "lattice")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_all_methods_find_the_same(dtype, dim, kind):
    rng = np.random.default_rng(7)
    points, radius = scattered(dim, kind, rng)
    points = points.astype(dtype)
    queries = rng.permutation(points)[: len(points) // 2] + dtype(0.3 * radius)
    cut = len(points) // 3
    check(points, radius)
    check(points, radius, [0, 0, cut, cut, len(points)], queries, [0, 10, 30, 30, len(queries)])


def test_the_radius_itself_is_within():
    """A lattice of spacing 1/4 has 2 n (n - 1) pairs at its spacing; at sqrt(2)/4 rounding decides, for all alike."""
    line = np.arange(20) * 0.25
    points = np.stack(np.meshgrid(line, line), -1).reshape(-1, 2)
    for dtype in (np.float32, np.float64):
        assert len(check(points.astype(dtype), 0.25)) == 2 * 20 * 19
        check(points.astype(dtype), np.sqrt(2.0) / 4.0)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("dim", [2, 3])
def test_nothing_and_one_point(method, dim):
    none, one = np.empty((0, dim), np.float32), np.ones((1, dim), np.float32)
    for points, start in ((none, None), (none, [0]), (none, [0, 0, 0]), (one, None), (one, [0, 0, 1])):
        found = neighbor_pairs(points, 1.0, method=method, start=start, threads=2)
        assert found.shape == (0, 2)
        assert found.dtype == np.int32
        for queries in (none, one):
            near = neighbor_lists(queries, points, 1.0, method=method)
            assert near.start.tolist() == [0, len(points)][: len(queries) + 1] or len(queries) == 0
            assert len(near.start) == len(queries) + 1
            assert near.index.tolist() == [0] * (len(queries) * len(points))


coordinate = st.one_of(
    st.floats(-2.0, 2.0, width=32), st.integers(-8, 8).map(lambda i: 0.25 * i), st.floats(-1e30, 1e30)
)


@given(
    points=st.lists(st.tuples(coordinate, coordinate), max_size=60),
    radius=st.sampled_from([0.25, 0.1, 1e-6, 3.0, 1e12]),
    cut=st.integers(0, 60),
)
def test_any_points_against_the_definition(points, radius, cut):
    array = np.array(points, np.float32).reshape(-1, 2)
    check(array, radius, [0, min(cut, len(points)), len(points)])


def test_a_million_points_as_scipys_tree_finds_them():
    points = np.random.default_rng(1).random((1_000_000, 2), np.float32)
    radius = 1.2e-3
    a, b = in_order(neighbor_pairs(points, radius)), neighbor_pairs(points, radius, method="kdtree")
    assert len(a) == len(b) > 2_000_000
    key = np.sort(b[:, 0].astype(np.int64) * len(points) + b[:, 1])
    np.testing.assert_array_equal(a[:, 0].astype(np.int64) * len(points) + a[:, 1], key)


def test_capacity_grows_until_all_is_stored(monkeypatch):
    """Points all within one radius: n (n - 1) / 2 pairs, far more than reserved; and a room that is short by one."""
    points = np.random.default_rng(2).random((2000, 2)) * 0.5
    pairs = neighbor_pairs(points, 1.0)
    assert len(pairs) == 2000 * 1999 // 2
    assert len(np.unique(pairs[:, 0].astype(np.int64) * 2000 + pairs[:, 1])) == len(pairs)
    near = neighbor_lists(points, points, 1.0)
    np.testing.assert_array_equal(near.index, np.tile(np.arange(2000), 2000))
    few = points[:100]
    wanted = neighbor_pairs(few, 0.1)
    entries = neighbor_lists(few, few, 0.1).index
    for total, call, full in (
        (len(wanted), lambda: neighbor_pairs(few, 0.1), wanted),
        (len(entries), lambda: neighbor_lists(few, few, 0.1).index, entries),
    ):
        for room in (0, 1, total - 1, total, total + cell_search.PADDING - 1, total + cell_search.PADDING):
            monkeypatch.setattr(cell_search, "ROOM", 0)
            monkeypatch.setattr(cell_search, "LEAST_ROOM", max(room, cell_search.PADDING))
            np.testing.assert_array_equal(call(), full)


@pytest.mark.parametrize("method", METHODS)
def test_threads_and_other_worlds_change_no_bit(method):
    rng = np.random.default_rng(3)
    points = rng.random((600, 2))
    start = np.array([0, 10, 10, 300, 350, 480, 600])
    alone = neighbor_pairs(points, 0.1, method=method, start=start)
    lists = neighbor_lists(points, points, 0.1, method=method, query_start=start, point_start=start)
    for threads in (2, 3, 16):
        np.testing.assert_array_equal(neighbor_pairs(points, 0.1, method=method, start=start, threads=threads), alone)
        again = neighbor_lists(
            points, points, 0.1, method=method, query_start=start, point_start=start, threads=threads
        )
        np.testing.assert_array_equal(again.start, lists.start)
        np.testing.assert_array_equal(again.index, lists.index)
    each = [neighbor_pairs(points[a:b], 0.1, method=method) + a for a, b in itertools.pairwise(start)]
    np.testing.assert_array_equal(np.concatenate(each), alone)


def test_shards_are_all_worlds_once():
    rng = np.random.default_rng(4)
    for counts in (np.zeros(5, int), np.array([1000, 1, 1, 1]), np.array([1, 1, 1000]), rng.integers(0, 50, 40)):
        for threads in (1, 2, 7, 100):
            shards = shards_of(counts, threads)
            assert [w for first, count in shards for w in range(first, first + count)] == list(range(len(counts)))
            assert all(count > 0 for _, count in shards)
            assert len(shards) <= threads


@pytest.mark.parametrize("kind", ("even", "clusters"))
@pytest.mark.parametrize("dim", [2, 3])
def test_cells_and_sweeps_are_the_oracles(dim, kind):
    """The same arrays to the last entry: sorted cells, and pairs and lists in the same order."""
    rng = np.random.default_rng(5)
    points, radius = scattered(dim, kind, rng)
    points = points[:200].astype(np.float32)
    start = np.array([0, 0, 70, 200])
    found = {}
    for backend in ("warp", "numpy"):
        cells = SortedCells(radius, points, Workspace(backend))
        group, sort = cells.sorter(points, start, cells.boxes(3, (points, start)))
        sort(0, 3)
        found[backend] = {name: to_numpy(getattr(group, name)) for name in CELLS if name != "start"}
    used = found["numpy"].pop("line_count")
    np.testing.assert_array_equal(found["warp"].pop("line_count"), used)
    for w, lines in enumerate(used):
        for name, oracle in found["numpy"].items():
            ours = found["warp"][name]
            if name == "line_stride":
                np.testing.assert_array_equal(ours, oracle)
            elif name.startswith("line"):
                shift, more = (w, 1) if name == "line_start" and lines else (0, 0)
                part = slice(start[w] + shift, start[w] + shift + lines + more)
                np.testing.assert_array_equal(ours[part], oracle[part], err_msg=name)
            else:
                part = (..., slice(start[w], start[w + 1]))
                np.testing.assert_array_equal(ours[part], oracle[part], err_msg=name)
    for threads in (1, 2):
        np.testing.assert_array_equal(
            neighbor_pairs(points, radius, start=start, threads=threads),
            neighbor_pairs(points, radius, start=start, threads=threads, backend="numpy"),
        )
    queries = points[:150].copy()
    ours, oracle = (neighbor_lists(queries, points, radius, backend=backend) for backend in ("warp", "numpy"))
    np.testing.assert_array_equal(ours.start, oracle.start)
    np.testing.assert_array_equal(ours.index, oracle.index)


def test_a_search_keeps_its_memory_and_gives_its_results_away():
    """A second call allocates what it returns and little more, and leaves alone what the first one returned."""
    rng = np.random.default_rng(7)
    queries, points = rng.uniform(0.0, 60.0, (2, 5000, 2)).astype(np.float32)
    start = np.array([0, 1200, 5000])
    lists = functools.partial(neighbor_lists, radius=1.0, query_start=start, point_start=start, threads=2)
    wanted = lists(queries, points)
    pairs = neighbor_pairs(points, 1.0, start=start)
    search._idle.clear()
    tracemalloc.start()
    try:
        peaks = []
        for given in (queries, queries[::-1].copy()):
            tracemalloc.reset_peak()
            before = tracemalloc.get_traced_memory()[0]
            found = lists(given, points)
            peaks.append(tracemalloc.get_traced_memory()[1] - before)
            if given is queries:
                first = found
    finally:
        tracemalloc.stop()
    assert peaks[1] < peaks[0] - 12 * 2 * len(points)  # place and number of all points, to name but these
    assert peaks[1] < found.start.nbytes + found.index.nbytes + 2**18
    np.testing.assert_array_equal(first.start, wanted.start)
    np.testing.assert_array_equal(first.index, wanted.index)
    with ThreadPoolExecutor(4) as pool:
        for got in pool.map(lambda _: neighbor_pairs(points, 1.0, start=start, threads=2), range(16)):
            np.testing.assert_array_equal(got, pairs)


def test_the_memory_of_a_large_search_is_given_back(monkeypatch):
    points = np.random.default_rng(8).uniform(0.0, 60.0, (5000, 2)).astype(np.float32)
    monkeypatch.setattr(search, "KEPT", 2**12)
    search._idle.clear()
    neighbor_pairs(points, 1.0)
    assert not search._idle["warp"]
    neighbor_pairs(points[:10].copy(), 1.0)
    monkeypatch.undo()
    neighbor_pairs(points[:10].copy(), 1.0)
    assert len(search._idle["warp"]) == 1


def test_bad_input_is_named():
    good = np.zeros((4, 2), np.float32)
    bad = good.copy()
    bad[3, 0] = np.nan
    infinite = np.zeros((4, 3))
    infinite[1, 2] = -np.inf
    for points, message in (
        ([[0.0, 0.0]], r"points is a list; it must be a numpy array"),
        (good.astype(np.float16), r"points has dtype float16; it must be float32 or float64"),
        (good.astype(int), r"points has dtype int64"),
        (np.zeros(4), r"points has shape \(4,\); it must be \(n, 2\) or \(n, 3\)"),
        (np.zeros((4, 4)), r"points has shape \(4, 4\)"),
        (np.zeros((2, 4)).T, r"points has strides \(8, 32\) for shape \(4, 2\); it must be contiguous"),
        (np.zeros((4, 4))[:, :2], r"points has strides \(32, 8\) for shape \(4, 2\); it must be contiguous"),
        (bad, r"points\[3, 0\] is nan; it must be finite"),
        (infinite, r"points\[1, 2\] is -inf; it must be finite"),
        (np.broadcast_to(np.float32(0), (2**31, 2)), r"points has 2147483648 points; it may have 2147483647"),
    ):
        with pytest.raises(ValueError, match=message):
            neighbor_pairs(points, 1.0)
        if isinstance(points, np.ndarray) and points.shape != (2**31, 2):
            with pytest.raises(ValueError, match=message.replace("points", "queries", 1)):
                neighbor_lists(points, good, 1.0)
    for radius in (0.0, -1.0, np.nan, np.inf, 1e-30, 1e30):  # of the last two, a float32 cannot hold the square
        with pytest.raises(ValueError, match=r"radius is .*; it must be (finite and )?> 0"):
            neighbor_pairs(good, radius)
    for start, message in (
        ([1, 4], r"start\[0\] is 1; it must be 0"),
        ([0, 3], r"start\[1\] is 3; it must be the number of points, 4"),
        ([0, 3, 2, 4], r"start\[2\] is 2; it must be at least .*start\[1\], 3"),
        ([], r"start has shape \(0,\); it must be \(W \+ 1,\) integers"),
        ([0.0, 4.0], r"start is \[0.0, 4.0\]; it must be \(W \+ 1,\) integers"),
    ):
        with pytest.raises(ValueError, match=message):
            neighbor_pairs(good, 1.0, start=start)
        with pytest.raises(ValueError, match="point_" + message):
            neighbor_lists(good, good, 1.0, point_start=start)
    for options, message in (
        ({"method": "grid"}, r"method is 'grid'; it must be one of \('hash', 'kdtree', 'tree', 'all'\)"),
        ({"threads": 0}, r"threads is 0; it must be an integer in \[1, 2147483647\]"),
        ({"backend": "jax"}, r"backend is 'jax'"),
        ({"backend": "numpy", "method": "tree"}, r"method is 'tree'; only 'hash' has an oracle"),
    ):
        with pytest.raises(ValueError, match=message):
            neighbor_pairs(good, 1.0, **options)
    for queries, options, message in (
        (np.zeros((4, 3), np.float32), {}, r"queries has shape \(4, 3\), points has shape \(4, 2\); they must agree"),
        (np.zeros((4, 2)), {}, r"queries has dtype float64, points has dtype float32; they must agree"),
        (good, {"query_start": [0, 2, 4]}, r"query_start has 2 worlds, point_start has 1; they must agree"),
    ):
        with pytest.raises(ValueError, match=message):
            neighbor_lists(queries, good, 1.0, **options)


def test_what_a_method_cannot_hold_is_refused():
    with pytest.raises(ValueError, match=r"points of world 1 span more than float64 holds on axis 0"):
        neighbor_pairs(np.array([[0.0, 0.0], [1e308, 0.0], [-1e308, 0.0]]), 1.0, start=[0, 1, 3])
    with pytest.raises(ValueError, match=r"method is 'tree', whose boxes are float32"):
        neighbor_pairs(np.array([[1e39, 0.0]]), 1.0, method="tree")
    with pytest.raises(ValueError, match=r"radius finds more than 2147483631 pairs"):
        neighbor_pairs(np.zeros((66_000, 2), np.float32), 1.0)


def test_an_array_with_a_weak_reference_is_shortened_too():
    for held in (False, True):
        array = np.arange(12, dtype=np.int32).reshape(6, 2)
        want = array[:4].copy()
        kept = weakref.ref(array) if held else None
        short = cell_search.shortened(array, 4)
        np.testing.assert_array_equal(short, want)
        assert short.base is None and short.flags.owndata and (kept is None or short is not kept())
