"""What a shard must not hold, though its bytes are whole: the world is refused by dataset, place and limit."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

h5py = pytest.importorskip("h5py")
pytest.importorskip("torch")

from pipeline.data.dataset import States  # noqa: E402
from pipeline.data.generate import generate  # noqa: E402
from pipeline.data.recipe import GenerateOptions, Recipe  # noqa: E402
from pipeline.scenes import Thesis  # noqa: E402


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole")
    options = GenerateOptions(worlds=1, steps=30, label_sweeps=100)
    generate(Recipe(scene=Thesis(bodies=6), options=options), folder, threads=1, progress=False)
    return folder


def changed(whole, folder, name, change):
    """A copy whose dataset is another one."""
    shutil.copytree(whole, folder)
    with h5py.File(folder / "shard-00000.h5", "r+") as file:
        values = change(file[name][...])
        attributes = dict(file[name].attrs)
        del file[name]
        file[name] = values
        file[name].attrs.update(attributes)
    return folder


def element(value, place=-1):
    """A change of one element."""

    def change(values):
        values.reshape(-1)[place] = value
        return values

    return change


WRONG = {
    "motion/position": (element(np.nan), r"motion/position\[\d+, 1\] is .*nan.*; it must be finite"),
    "body/mass": (element(-1.0), r"body/mass\[\d+\] is -1.0; it must be finite and >= 0"),
    "body/body_type": (element(9), r"body/body_type\[\d+\] is 9; it must be one of 0 \(STATIC\)"),
    "contact/friction": (element(-0.5), r"contact/friction\[\d+\] is -0.5; it must be finite and >= 0"),
    "contact/normal": (element(3.0), r"contact/normal\[\d+\] is .*; it must be a unit vector"),
    "contact/impulse": (element(np.nan), r"contact/impulse\[2, \d+, 1\] is nan; it must be finite"),
    "contact/body_b": (element(7), r"contact/body_b\[\d+\] is 7; it must be in \[0, 6\]"),
    "shape/shape_body": (element(-1), r"shape/shape_body\[\d+\] is -1; it must be in \[0, 6\]"),
    "shape/vertex_start": (element(-1, 1), "is damaged: shape/vertex_start must ascend from 0 to"),
    "step/motion_start": (element(3, 1), r"step/motion_start must rise by the 7 bodies of world 0"),
    "step/contact_start": (element(10**6, 1), "is damaged: step/contact_start must ascend from 0 to"),
    "world/step_start": (element(40), "is damaged: world/step_start must ascend from 0 to 30"),
    "world/shape_start": (element(12), "is damaged: world/shape_start must ascend from 0 to 9"),
    "world/dt": (element(0.0), r"world/dt\[0\] is 0.0; it must be finite and > 0"),
    "vertex/vertices": (element(np.nan), r"vertex/vertices\[\d+, 1\] is .*nan.*; it must be finite"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_no_state_may_hold_is_named(whole, tmp_path, name):
    change, message = WRONG[name]
    folder = changed(whole, tmp_path / "changed", name, change)
    with pytest.raises(ValueError, match=rf"shard-00000\.h5.*{message}"):
        States(folder).batch(range(30))


def test_a_state_that_did_not_advance_may_hold_anything(whole, tmp_path):
    folder = changed(whole, tmp_path / "changed", "step/flags", element(8))
    with h5py.File(folder / "shard-00000.h5", "r+") as file:
        last = file["step/motion_start"][-2]
        file["motion/position"][last:] = np.nan
    states = States(folder)
    assert len(states) < 30
    assert np.isfinite(states.batch(range(len(states))).position.numpy()).all()
