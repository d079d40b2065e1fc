"""Neighbour search: the cost of building and finding all pairs against the number of points, for every method.

Points are float32 and lie uniformly in a square, so close that each has six neighbours; clustered points and points
in 3D come beside them. SciPy's tree is called as a user would, without the package around it; ``wp.HashGrid`` is built,
queried once to count and once to collect. The output's allocation counts for all.
"""

import functools
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from bench import timing

SUMMARY = "neighbour search, ns a point against n: sorted cells, k-d tree, tree of boxes, all pairs, wp.HashGrid"
KEYS = ("hash_ns", "over_ckdtree")
THREADS = 1

SIZES = (100, 1_000, 10_000, 100_000, 1_000_000)
BARS = (100_000, 1_000_000)  # the sizes whose worse figure is reported
NEIGHBORS = 6.0
ALL_LIMIT, TREE_LIMIT = 10_000, 100_000  # beyond, a method takes too long to be of use
ROUNDS, ROUNDS_QUICK = 9, 3
METHODS = ("hash", "ckdtree", "tree", "all", "hashgrid", "lists")


def uniform(count: int, dim: int) -> tuple[np.ndarray, float]:
    """Points in the unit square or cube, and the radius within which a point has NEIGHBORS others."""
    points = np.random.default_rng(count + dim).random((count, dim), np.float32)
    volume = NEIGHBORS / count
    radius = math.sqrt(volume / math.pi) if dim == 2 else (0.75 * volume / math.pi) ** (1 / 3)
    return points, radius


def clustered(count: int) -> tuple[np.ndarray, float]:
    """Points around 100 centres in a square of 10 km, with a spread of 1 m, and as many neighbours on average."""
    rng = np.random.default_rng(count)
    centres = rng.random((100, 2)) * 1e4
    points = centres[rng.integers(0, 100, count)] + rng.normal(size=(count, 2))
    # the mean density of a Gaussian cluster of m points is m / (4 pi)
    return points.astype(np.float32), math.sqrt(NEIGHBORS * 4.0 / (count / 100))


@functools.cache
def grid_kernel() -> Any:
    """Count or store the pairs of each point that a ``wp.HashGrid`` finds."""
    import warp as wp

    @wp.kernel(enable_backward=False)
    def grid_pairs(
        fill: int,
        grid: wp.uint64,
        radius: float,
        point: wp.array(dtype=wp.vec3),  # type: ignore[valid-type]
        first: wp.array(dtype=wp.int32),  # type: ignore[valid-type]
        found: wp.array(dtype=wp.int32),  # type: ignore[valid-type]
        pair: wp.array2d(dtype=wp.int32),  # type: ignore[valid-type]
    ):
        i = wp.tid()
        near = wp.hash_grid_query(grid, point[i], radius)
        j = wp.int32(0)
        n = wp.int32(0)
        while wp.hash_grid_query_next(near, j):
            if j > i:  # type: ignore[operator]
                d = point[i] - point[j]
                if wp.dot(d, d) <= radius * radius:
                    if fill == 1:
                        pair[first[i] + n, 0] = i
                        pair[first[i] + n, 1] = j
                    n += 1
        found[i] = n

    return grid_pairs


def hash_grid(points: np.ndarray, radius: float) -> Callable[[], Any]:
    """All pairs by Warp's hash grid: built, and queried twice by a kernel."""
    import warp as wp

    wp.init()
    grid_pairs = grid_kernel()
    count, dim = points.shape
    flat = np.zeros((count, 3), np.float32)
    flat[:, :dim] = points
    cells = max(16, round(count ** (1 / dim)))  # about one point a cell, whatever the domain
    grid = wp.HashGrid(cells, cells, 1 if dim == 2 else cells, device="cpu")

    def run() -> np.ndarray:
        place = wp.array(flat, dtype=wp.vec3, device="cpu", copy=False)
        grid.build(place, radius)
        found, first = np.empty(count, np.int32), np.zeros(count + 1, np.int32)
        pairs = np.empty((0, 2), np.int32)
        for fill in (0, 1):
            if fill:
                np.cumsum(found, out=first[1:])
                pairs = np.empty((int(first[-1]), 2), np.int32)
            arrays = [wp.array(array, device="cpu", copy=False) for array in (first, found, pairs)]
            wp.launch(grid_pairs, dim=count, inputs=[fill, grid.id, radius, place, *arrays], device="cpu")
        return pairs

    return run


def candidates(points: np.ndarray, radius: float, tree_limit: int = TREE_LIMIT) -> dict[str, Callable[[], Any]]:
    """What finds the pairs of these points, by name."""
    from scipy.spatial import cKDTree

    from dc_kernels.neighbors.search import neighbor_lists, neighbor_pairs

    found: dict[str, Callable[[], Any]] = {
        "hash": lambda: neighbor_pairs(points, radius),
        "ckdtree": lambda: cKDTree(points).query_pairs(radius, output_type="ndarray"),
        "hashgrid": hash_grid(points, radius),
        "lists": lambda: neighbor_lists(points, points, radius),
    }
    if len(points) <= tree_limit:
        found["tree"] = lambda: neighbor_pairs(points, radius, method="tree")
    if len(points) <= ALL_LIMIT:
        found["all"] = lambda: neighbor_pairs(points, radius, method="all")
    return found


def cases() -> dict[str, tuple[np.ndarray, float]]:
    """Points and radius by the name of the case."""
    found = {f"2D {count}": uniform(count, 2) for count in SIZES}
    return {**found, "2D clustered 100000": clustered(100_000), "3D 100000": uniform(100_000, 3)}


def measure(quick: bool) -> dict[str, Any]:
    """Nanoseconds a point by case and method, and how much faster than SciPy's tree the hash is."""
    values: dict[str, Any] = {}
    for name, (points, radius) in cases().items():
        timing.progress(name)
        functions = candidates(points, radius, ALL_LIMIT if quick else TREE_LIMIT)
        rounds = ROUNDS_QUICK if quick else ROUNDS
        if len(points) < 100_000:
            rounds = 4 * rounds + 1
        # the slow ones apart: after one of them a fast one would find the caches empty
        slow: dict[str, Callable[[], Any]] = {m: functions[m] for m in ("tree", "all") if m in functions}
        fast = {method: function for method, function in functions.items() if method not in slow}
        times = timing.medians({**timing.interleave(fast, rounds), **timing.interleave(slow, rounds)})
        for method, seconds in times.items():
            values[f"{method}_ns {name}"] = 1e9 * seconds / len(points)
        values[f"pairs {name}"] = len(functions["hash"]()) / len(points)
        values[f"over_ckdtree {name}"] = times["ckdtree"] / times["hash"]
        values[f"over_hashgrid {name}"] = times["hashgrid"] / times["hash"]
    values["hash_ns"] = max(values[f"hash_ns 2D {count}"] for count in BARS)
    values["over_ckdtree"] = min(values[f"over_ckdtree 2D {count}"] for count in BARS)
    return values


def report(values: dict[str, Any]) -> str:
    """Table for people."""
    names = [key.removeprefix("pairs ") for key in values if key.startswith("pairs ")]
    columns = ("pairs", *(f"{method}_ns" for method in METHODS), "over_ckdtree", "over_hashgrid")
    rows = [(name, *(values.get(f"{column} {name}") for column in columns)) for name in names]
    header = (
        "points",
        "pairs/point",
        "hash",
        "cKDTree",
        "tree",
        "all",
        "wp.HashGrid",
        "hash, lists",
        "cKDTree/hash",
        "HashGrid/hash",
    )
    worst = ", ".join(f"{key} {values[key]:.3g}" for key in KEYS)
    return f"ns a point\n{timing.table(header, rows)}\nworst of 2D {BARS[0]} and {BARS[1]}: {worst}"
