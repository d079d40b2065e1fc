"""Pictures of a run: the summary says of how many worlds a curve is the median, and shows their spread."""

from __future__ import annotations

import numpy as np
import pytest

import dc_kernels as dc
from pipeline.plots.trajectory import summary_figure
from pipeline.run.trajectory import STEP_FIELDS
from pipeline.scenes import Stack


@pytest.mark.parametrize("worlds", [1, 2, 3])
def test_the_summary_says_what_its_curves_are(worlds):
    sim = dc.Simulation(*Stack(bodies=3).build(worlds).finalize())
    sim.run(2, 0.01)
    series = {name: np.arange(5.0 * worlds).reshape(5, worlds) for name in STEP_FIELDS}
    fig = summary_figure(sim, series, 0.01, "title")
    sweeps = next(axes for axes in fig.axes if axes.get_title("left").startswith("sweeps"))
    spread = f" (median and 10-90 % of {worlds} worlds)" if worlds > 1 else ""
    assert sweeps.get_title("left") == "sweeps of the solver" + spread
    assert len(sweeps.collections) == (worlds > 1)  # the band
    np.testing.assert_array_equal(sweeps.lines[0].get_ydata(), np.median(series["sweeps"], axis=1))
