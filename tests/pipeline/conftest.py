"""Fixtures that several tests of the pipeline share."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from pipeline.data.generate import generate
from pipeline.data.recipe import GenerateOptions, Recipe
from tests.pipeline.small import SCENE


@pytest.fixture(scope="session")
def data(tmp_path_factory) -> Path:
    """Eight worlds of six discs that fall and settle."""
    out = tmp_path_factory.mktemp("data")
    generate(Recipe(scene=SCENE, options=GenerateOptions(worlds=8, steps=70)), out, threads=1, progress=False)
    return out


@pytest.fixture(scope="session")
def batch(data: Path) -> Any:
    """States of several worlds, in a batch."""
    dataset = pytest.importorskip("pipeline.data.dataset")
    return next(iter(dataset.loader(data, batch_size=12, seed=1)))


@pytest.fixture(scope="session")
def contactnet(tmp_path_factory) -> Path:
    """The file of an untrained ContactNet."""
    torch = pytest.importorskip("torch")
    from pipeline.networks.checkpoint import save_checkpoint
    from pipeline.networks.models import build

    torch.set_num_threads(1)
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("network") / "untrained.safetensors"
    save_checkpoint(path, build("contactnet"), {})
    return path
