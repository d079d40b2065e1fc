"""The examples, in a short form; each checks its own end."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from types import ModuleType

import pytest

FOLDER = Path(__file__).resolve().parents[2] / "examples"
SHORT = {
    "own_simulator": {"boxes": 4, "steps": 50},
    "box2d_solver": {"bodies": 40},
    "pymunk_compare": {"steps_per_second": (100,)},
    "warp_particles": {"count": 100, "steps": 120},
    "optimize_torch": {"count": 8, "steps": 80},
    "dataset_reader": {"worlds": 2, "epochs": 20},
    "rl_loop": {"actions": 120},
    "spawner": {"shots": 12},
}
NEEDS = {"box2d_solver": "Box2D", "pymunk_compare": "pymunk"}


def load(name: str) -> ModuleType:
    """An example as a module."""
    spec = importlib.util.spec_from_file_location(name, FOLDER / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(autouse=True)
def _one_thread():
    torch = pytest.importorskip("torch")
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.mark.parametrize("name", SHORT)
def test_example_ends_as_it_says(name):
    pytest.importorskip(NEEDS.get(name, "numpy"))
    load(name).main(**SHORT[name])


def test_every_example_is_run_and_listed():
    names = {file.stem for file in FOLDER.glob("*.py")}
    assert names == set(SHORT)
    assert set(re.findall(r"\]\((\w+)\.py\)", (FOLDER / "README.md").read_text())) == names
