"""Colours that every reader can tell, and lines that do not rest on colour alone."""

from __future__ import annotations

import itertools
from types import SimpleNamespace

import numpy as np
import pytest

from bench.error_time import figures as error_time_figures
from bench.error_time.solve import settings
from pipeline.evaluate.runs import Run
from pipeline.plots import contactnet, kernels, protocol, style
from pipeline.plots.training import curves_figure, rates_figure

LEAST = 15.0
"""Distance of two colours in CIE Lab: 2.3 is just noticed side by side, and thin lines need several times that."""
# severity 1.0 of Machado, Oliveira and Fernandes (2009), on linear RGB
VISION = {
    "usual": np.eye(3),
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}
TO_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
SOLVER_COLORS = [line["color"] for line in style.SOLVERS.values()]
TOGETHER = {
    "cycle": [*style.CYCLE, "#ffffff"],
    "starts": [line["color"] for line in style.STARTS.values()],
    "solvers": list(dict.fromkeys(SOLVER_COLORS)),
    "quantities": [line["color"] for line in style.QUANTITIES.values()],
    "components": [*(line["color"] for line in style.COMPONENTS.values()), style.MUTED],
    "parts of a step": list(protocol.PART_COLORS.values()),
    "kernels": list(kernels.COLORS.values()),
    "contactnet": [*contactnet.COLORS, style.SKY, style.MUTED],
    "engines": [style.VERMILION, style.EDGE],
}


def lab(color: str, vision: str) -> np.ndarray:
    """Place in CIE Lab of a colour as it is seen."""
    rgb = np.array([int(color[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    seen = np.clip(np.array(VISION[vision]) @ linear, 0.0, 1.0)
    xyz = TO_XYZ @ seen / np.array([0.95047, 1.0, 1.08883])
    f = np.where(xyz > (6 / 29) ** 3, np.cbrt(xyz), xyz / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116.0 * f[1] - 16.0, 500.0 * (f[0] - f[1]), 200.0 * (f[1] - f[2])])


def distance(one: str, other: str, vision: str) -> float:
    return float(np.linalg.norm(lab(one, vision) - lab(other, vision)))


def test_the_measure_is_that_of_the_literature():
    """White, black and red of sRGB in CIE Lab; red and green that a deuteranope confuses."""
    np.testing.assert_allclose(lab("#ffffff", "usual"), [100.0, 0.0, 0.0], atol=0.02)
    np.testing.assert_allclose(lab("#ff0000", "usual"), [53.24, 80.09, 67.20], atol=0.02)
    assert distance("#a03030", "#606030", "usual") > 40.0 > 3.0 * distance("#a03030", "#606030", "deuteranopia")


@pytest.mark.parametrize("vision", VISION)
@pytest.mark.parametrize("name", TOGETHER)
def test_colours_shown_together_can_be_told_apart(name, vision):
    for one, other in itertools.combinations(TOGETHER[name], 2):
        assert distance(one, other, vision) >= LEAST, (one, other)


def test_the_starts_of_the_demo_are_far_apart():
    """Its central comparison."""
    for vision in VISION:
        assert distance(style.STARTS["builtin"]["color"], style.STARTS["cnn"]["color"], vision) > 40.0


@pytest.mark.parametrize("table", [style.STARTS, style.COMPONENTS, style.SOLVERS])
def test_no_two_of_a_table_share_colour_or_marker(table):
    chosen = {name: line for name, line in table.items() if name not in ("plain", "auto")}  # named twice
    for key in ("color", "marker"):
        values = [line[key] for line in chosen.values()]
        assert len(set(values)) == len(values), key


def test_a_start_looks_alike_in_every_company():
    alone, many = style.start_styles(["cnn"]), style.start_styles(["peak", "none", "copy4", "Builtin", "cnn"])
    assert alone["cnn"] == many["cnn"] == style.STARTS["cnn"]
    assert many["Builtin"] == style.STARTS["builtin"]
    assert len({tuple(line.values()) for line in many.values()}) == 5
    taken = {style.STARTS[name]["color"] for name in ("cnn", "none", "builtin")}
    assert not {many["peak"]["color"], many["copy4"]["color"]} & taken
    crowd = style.start_styles([*style.STARTS, *(f"net{i}" for i in range(40))])
    assert len({tuple(line.values()) for line in crowd.values()}) == len(crowd)


def test_every_setting_of_a_bench_has_a_line_of_its_own():
    """Of Gauss-Seidel; Jacobi's are grey, told by marker and dash."""
    labels = [setting.label for setting in settings(learned=True)]
    lines = {tuple(error_time_figures.line_style(label).items()) for label in labels}
    assert len(lines) == len(labels) > 12


def run(start: str, solver: str = "PGS") -> Run:
    """Some sweeps of a start."""
    stream = np.random.default_rng(len(start) + len(solver))
    shape = (30, 3)
    return Run(
        start=start,
        solver=solver,
        max_sweeps=1000,
        tolerance=1e-4,
        sweeps=stream.integers(1, 900, shape),
        change=np.full(shape, 1e-5),
        contacts=np.full(shape, 9),
        start_error=(0.1, 0.1),
        wall_s=1.0,
        strategy_s=0.1,
        decay=np.geomspace(1.0, 1e-5, 1000),
        errors=stream.uniform(0.1, 1.0, (*shape, 2)),
        parts={"solve": 1.0, "network": 0.5, "start": 0.2},
        counts={"calls": 3},
    )


RUNS = [run("none"), run("builtin"), run("cnn"), run("builtin", "PGS + aitken")]
ROWS = [{"step": 20 * i, "train/loss": 1.0, "train/rate": 1e-3} for i in range(3)]
VALIDATED = {"loss": 0.5, "normal": 0.4, "tangential": 0.6, "gain": 0.2, "aitken_30": 0.1}
ROWS.append({"step": 60, **{f"validation/{name}": value for name, value in VALIDATED.items()}})
FIGURES = {
    "protocol": lambda: protocol.protocol_figure(RUNS, "protocol"),
    "evaluation": lambda: protocol.evaluation_figure(RUNS[:3], "evaluation"),
    "training": lambda: curves_figure(ROWS, "training"),
    "rates": lambda: rates_figure(SimpleNamespace(rates=[1e-3, 1e-2], losses=[1.0, 0.5], rate=1e-3)),
    "contactnet": lambda: contactnet.contact_curves_figure(ROWS, "contactnet"),
}


@pytest.mark.parametrize("name", FIGURES)
def test_legends_lie_beside_the_data(name):
    fig = FIGURES[name]()
    fig.canvas.draw()
    plotted = [axes for axes in fig.axes if axes.axison]
    legends = [*fig.legends, *(axes.get_legend() for axes in plotted if axes.get_legend())]
    assert legends
    for legend, axes in itertools.product(legends, plotted):
        assert not legend.get_window_extent().overlaps(axes.get_window_extent()), axes.get_title()
    assert all(axes.get_ylabel() or axes.get_yticklabels() for axes in plotted)


@pytest.mark.parametrize("name", ["protocol", "evaluation"])
def test_lines_of_runs_differ_in_more_than_colour(name):
    fig = FIGURES[name]()
    lines = [line for line in fig.axes[0].get_lines() if line.get_label() in {r.label for r in RUNS}]
    looks = {(line.get_marker(), line.get_linestyle()) for line in lines}
    assert len(looks) == len(lines) >= 3
    assert all(line.get_marker() != "None" for line in lines)


def test_a_few_points_are_marked():
    fig = FIGURES["training"]()
    for axes in fig.axes:
        for line in axes.get_lines():
            if 0 < len(line.get_xdata()) < 4 and "validation" in line.get_label():
                assert line.get_marker() != "None"
