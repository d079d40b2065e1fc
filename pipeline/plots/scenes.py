"""The scenes side by side."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Any

import dc_kernels as dc
from pipeline.plots.style import figure
from pipeline.plots.world import draw_world

SIDE = 2.6
"""Width and height of a scene's picture [inch]."""
COLUMNS = 4


def scenes_figure(names: Collection[str], simulations: Iterable[dc.Simulation]) -> Any:
    """Draw the first world of each simulation with its contact forces, its name above: left to right and downwards."""
    columns = min(COLUMNS, len(names))
    rows = -(-len(names) // columns)
    with figure(SIDE * columns, SIDE * rows) as made:
        axes = made.subplots(rows, columns, squeeze=False).flat
        for panel, name, sim in zip(axes, names, simulations):
            draw_world(panel, sim, colorbar=False)
            panel.set_title(name)
            panel.set_anchor("C")
        for panel in axes:
            panel.set_axis_off()
        for panel in made.axes:
            panel.set_axis_off()
    return made
