"""Pictures of a run: the summary says of how many worlds a curve is the median, and shows their spread."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

import dc_kernels as dc
from pipeline.plots.trajectory import animate, summary_figure
from pipeline.run.simulate import Output, simulate
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


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    simulate(Stack(bodies=2), output=Output(steps=3, out=folder), progress=False)
    return folder / "trajectory.h5"


def element(value, place=-1):
    """A change of one element."""

    def change(values):
        values.reshape(-1)[place] = value
        return values

    return change


WRONG = {
    "model/body_start": (element(-1), r"model/body_start\[1\] is -1; it must be ascending, at least the one before it"),
    "model/shape_body": (
        element(2**31 - 1),
        r"model/shape_body\[\d+\] is 2147483647; it must be a body of its world 0",
    ),
    "model/shape_type": (element(7), r"model/shape_type\[\d+\] is 7; it must be one of"),
    "model/joint_length": (lambda values: np.ones(3, np.float32), r"model/joint_length is float32 \(3,\); it must be"),
    "model/mass": (lambda values: values.astype(np.int32), r"model/mass is int32; it must be float32 or float64"),
    "model/shape_start": (
        lambda values: np.append(values, values[-1]),
        r"model/shape_start is int32 \(3,\); it must be",
    ),
    "record/position": (element(np.nan, 0), r"record/position\[0, 0, 0\] is nan; it must be finite"),
    "record/angle": (lambda values: values[:1], "record/ has 4 times"),
    "record/time": (lambda values: values[:0], "record/ has 0 times"),
}


LATE = ("record/time", (element(1e30, 0), r"record/time\[1\] is 0\.\d+; it must be later than the one before it"))


@pytest.mark.parametrize(("name", "wrong"), [*WRONG.items(), LATE])
def test_a_trajectory_that_none_may_be_is_not_drawn(run, tmp_path, name, wrong):
    h5py = pytest.importorskip("h5py")
    change, message = wrong
    path = tmp_path / "trajectory.h5"
    shutil.copyfile(run, path)
    with h5py.File(path, "r+") as file:
        values = change(file[name][...])
        del file[name]
        file[name] = values
    with pytest.raises(ValueError, match=rf"trajectory\.h5: {message}"):
        animate(path, tmp_path / "video.gif")
