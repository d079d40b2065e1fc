"""The grid, and its choice for the points of a scene."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from bench import cases
from dc_kernels.grid.grid import Grid, choose_grid, closest_pair, shared_cells
from dc_kernels.measure import contact_slots

BOX = {"lower": (0.0, 0.0), "upper": (15.0, 15.0)}
scattered = arrays(np.float64, st.tuples(st.integers(0, 30), st.just(2)), elements=st.floats(0.0, 15.0))


def distances(points):
    return [float(np.hypot(*(a - b))) for a, b in itertools.combinations(points, 2)]


def weights(points, grid, h):
    """Poly6 weights (points, nodes) in plain numpy, without their constant."""
    away = points[:, None] - grid.nodes().reshape(-1, 2)
    return np.maximum(h * h - (away * away).sum(axis=-1), 0.0) ** 3


def round_trip(points, values, grid, h):
    """Splat with weights that sum to 1, then reverse SPH."""
    w = weights(points, grid, h)
    s = w / w.sum(axis=1, keepdims=True)
    image = s.T @ values
    share = s / np.maximum(s.sum(axis=0), 1e-300)
    return share @ image


def test_nodes_and_corners():
    grid = Grid.from_box((-1.0, 2.0), (1.0, 3.1), 0.5)
    assert grid.shape == (4, 5)
    assert grid.upper == (1.0, 3.5)  # moved out to a whole number of cells
    assert grid.nodes()[1, 2] == pytest.approx((0.0, 2.5))
    assert Grid.from_box((0, 0), (15, 15), 0.25) == Grid.thesis()
    assert Grid.from_box((0, 0), (6.0, 6.0), 0.1).shape == (61, 61)  # 6 / 0.1 exceeds 60 in floating point


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Grid(rows=1, columns=5, spacing=1.0), "Grid.rows is 1; it must be an integer"),
        (lambda: Grid(rows=2, columns=2.5, spacing=1.0), "Grid.columns is 2.5"),
        (lambda: Grid(rows=2, columns=2, spacing=0.0), "Grid.spacing is 0.0"),
        (
            lambda: Grid(rows=2, columns=2, spacing=1.0, origin=(0.0, np.nan)),
            "Grid.origin\\[1\\] is nan; it must be finite",
        ),
        (lambda: Grid.from_box((0, 0), (0, 1), 1.0), "it must lie above"),
        (lambda: Grid.from_box((0, 0), (1, np.inf), 1.0), "upper\\[1\\] is inf; it must be finite"),
        (lambda: Grid.from_box((0, 0), (1, 1), 1e-9), "cells of 1e-09 m"),
        (lambda: choose_grid([(0.0, np.nan)], **BOX), r"points\[0, 1\] is nan"),
        (lambda: choose_grid([(0.0, 0.0)], start=[0, 2], **BOX), r"start\[1\] is 2; it must be the number"),
        (lambda: choose_grid([(0.0, 0.0)], start=[0.0, 1.0], **BOX), "start is .* integers"),
        (lambda: choose_grid([(0.0, 0.0)], max_nodes=3, **BOX), "max_nodes is 3; it must be an integer in \\[4, "),
        (lambda: choose_grid([(0.0, 0.0)], max_spacing=0.0, **BOX), "max_spacing is 0.0"),
        (lambda: choose_grid(np.zeros((0, 2)), lower=(0, 0), upper=(1, -1)), "it must lie above"),
    ],
)
def test_bad_values_are_named(make, message):
    with pytest.raises(ValueError, match=message):
        make()


@given(scattered)
def test_the_closest_pair_is_that_of_all_pairs(points):
    assert closest_pair(points) == min(distances(points), default=np.inf)


def test_points_of_different_worlds_are_never_close():
    points = np.array([(1.0, 1.0), (4.0, 1.0), (1.0, 1.0), (1.0, 3.0)])
    assert closest_pair(points, [0, 2, 4]) == 2.0
    choice = choose_grid(points, start=[0, 2, 4], **BOX)
    assert choice.closest == 2.0
    assert not choice.shared.any()


@given(scattered, st.integers(4, 20_000))
def test_a_choice_keeps_its_promise_or_says_how_far_it_fails(points, max_nodes):
    choice = choose_grid(points, max_nodes=max_nodes, **BOX)
    grid = choice.grid
    assert grid.rows * grid.columns <= max_nodes
    # counted by brute force: cells are squares around the nodes
    place = [tuple(np.floor(p / grid.spacing + 0.5)) for p in points]
    assert choice.shared[0] == sum(place.count(p) > 1 for p in place)
    reach = weights(points, grid, choice.h) > 0
    assert reach.any(axis=1).all()
    if choice.exact:
        assert not choice.shared.any()
        assert (reach.sum(axis=0) <= 1).all()
        values = np.random.default_rng(len(points)).normal(size=(len(points), 2))
        np.testing.assert_allclose(round_trip(points, values, grid, choice.h), values, rtol=1e-12)
    else:
        # finer would not do: the nodes' limit is reached
        finer = 0.95 * grid.spacing
        assert (15.0 / finer + 1) ** 2 > 0.5 * max_nodes or max_nodes < 40


def test_coincident_points_are_counted():
    points = np.array([(1.0, 1.0), (1.0, 1.0), (5.0, 5.0), (1.0, 1.0)])
    choice = choose_grid(points, max_nodes=1000, **BOX)
    assert not choice.exact
    assert choice.closest == 0.0
    assert list(choice.shared) == [3]
    assert "3 points in 1 of 1 worlds share a cell" in str(choice)


def test_few_points_need_few_nodes():
    for points in (np.zeros((0, 2)), np.array([(3.0, 4.0)])):
        choice = choose_grid(points, **BOX)
        assert choice.exact
        assert choice.grid.shape == (2, 2)
        assert choose_grid(points, max_spacing=0.25, **BOX).grid == Grid.thesis()
    assert not choose_grid([(60.0, 3.0)], **BOX).exact  # outside: it reaches no node


def test_a_settled_thesis_world_gets_a_grid_with_an_exact_round_trip():
    sim = cases.settled(100, worlds=2)
    slots, world = contact_slots(sim.contacts)
    body = sim.contacts.numpy("body_a")[slots]
    points = (sim.state.numpy("position")[body] + sim.contacts.numpy("arm_a")[slots]).astype(float)
    start = np.searchsorted(world, [0, 1, 2])
    assert len(points) > 300
    choice = choose_grid(points, start=start, **BOX)
    assert choice.exact
    assert not choice.shared.any()
    assert 0.45 < choice.closest < 0.55  # neighbours on a disc are a radius apart, less by the overlap
    for w in range(2):
        mine = points[start[w] : start[w + 1]]
        values = np.random.default_rng(w).uniform(size=(len(mine), 2))
        np.testing.assert_allclose(round_trip(mine, values, choice.grid, choice.h), values, rtol=1e-9)
    # the theses' own grid shares no cell either; one of 1 m does
    assert not shared_cells(points, Grid.thesis(), start).any()
    coarse = shared_cells(points, Grid.from_box((0, 0), (15, 15), 1.0), start)
    assert (coarse > 50).all()
