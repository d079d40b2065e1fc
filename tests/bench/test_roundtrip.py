"""What a round trip particle, grid, particle loses: exact statements, the theses' own way, and table 1 of Engedal."""

from __future__ import annotations

import numpy as np
import pytest

from bench.learning import roundtrip as bench
from bench.learning.theses import ThesesTransfer
from dc_kernels.grid.grid import Grid
from dc_kernels.grid.stencil import Stencil
from dc_kernels.grid.transfer import gather, splat

SIDE = bench.QUANTITIES["impulse"][1]


@pytest.fixture(scope="module")
def worlds() -> dict[str, bench.Particles]:
    """Three thesis worlds of 100 discs after 200 steps."""
    return bench.settle(100, SIDE, worlds=3, seed=0)


def world(particles: bench.Particles, index: int) -> tuple[np.ndarray, np.ndarray]:
    """Points and values of one world."""
    part = slice(*map(int, particles.start[index : index + 2]))
    return particles.points[part], particles.values[part]


@pytest.mark.parametrize(("spacing", "h"), [(0.25, 0.5), (0.5, 0.125), (0.5, 0.5)])
def test_agrees_with_trees_and_python_loops(worlds, spacing, h):
    grid = Grid.from_box((0.0, 0.0), (SIDE, SIDE), spacing)
    stencil = Stencil(h=h, nearest=False)
    theirs = ThesesTransfer(grid, h)
    for particles in worlds.values():
        points, values = world(particles, 1)
        image = splat(points, values, grid, stencil)
        expected = theirs.splat(points.astype(np.float64), values.astype(np.float64))
        assert np.abs(image[0] - expected).max() < 1e-5 * np.abs(expected).max()
        back = gather(image, points, grid, stencil, reverse=True)
        shared = theirs.gather(expected, points.astype(np.float64))
        assert np.abs(back - shared).max() < 1e-4 * np.abs(values).max()


def test_reverse_conserves_what_the_nodes_hold(worlds):
    grid = Grid.thesis()
    particles = worlds["impulse"]
    options = {"stencil": Stencil(h=0.5), "start": particles.start}
    image = splat(particles.points, particles.values, grid, **options)
    back = gather(image, particles.points, grid, reverse=True, **options)
    for total in (image.sum(axis=(1, 2, 3)), np.add.reduceat(back[:, 0], particles.start[:-1])):
        assert total == pytest.approx(np.add.reduceat(particles.values[:, 0], particles.start[:-1]), rel=1e-5)


def test_discs_lose_only_those_that_reach_no_node(worlds):
    """Supports of half a disc's distance or less share no node: a mass comes back whole or not at all."""
    particles = worlds["mass"]
    for spacing, h in bench.TABLE:
        tolerance = 2e-3 if h == 0.5 else 1e-5  # discs overlap by some mm, so their supports of a radius do too
        to_node = particles.points - spacing * np.round(particles.points / spacing)
        alone = np.linalg.norm(to_node, axis=1) >= h
        lost = bench.trip(particles, SIDE, spacing, h, nearest=False)[:, 0]
        assert np.allclose(lost, np.where(alone, -particles.values[:, 0], 0.0), atol=tolerance)
        assert np.abs(bench.trip(particles, SIDE, spacing, h)).max() < tolerance


def test_bins_of_the_normal_keep_impulses_apart(worlds):
    particles = worlds["impulse"]
    mean = np.abs(particles.values).mean()
    for spacing, h in bench.LOSSES:
        where = (particles, SIDE, spacing, h)
        loss = {way: np.abs(lose(*where)).mean() / mean for way, lose in bench.WAYS.items()}
        assert loss["bins"] < 1e-6
        assert loss["theirs"] >= loss["default"] > 1e-3
        assert loss["bilinear"] > 0.2  # it averages where a splat spread: most of an impulse does not come back


def test_bins_are_those_of_the_undirected_normal():
    angle = np.radians([0.0, 22.0, 23.0, 45.0, 90.0, 135.0, 157.0, 158.0, 180.0, -22.0, -23.0])
    normal = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    bins = bench.normal_bins(normal)
    assert bins.tolist() == [0, 0, 1, 1, 2, 3, 3, 0, 0, 0, 3]
    assert (bench.normal_bins(-normal) == bins).all()


def test_table_of_engedal():
    """All 18 entries of 50 worlds a column, within the scatter of such means and of those that he printed."""
    values = bench.study(50, batch=50)
    assert values["worst_zero"] < bench.PRINTED
    assert values["worst_scatters"] < 4.0
    assert values["within_tenth"] >= 12
    assert values["bins_lost"] < 1e-6 < values["default_lost"]
    assert set(bench.KEYS) <= set(values)
    lines = bench.report(values).splitlines()
    assert sum(line.startswith(("0.125 ", "0.250 ", "0.500 ")) for line in lines) == len(bench.TABLE)
