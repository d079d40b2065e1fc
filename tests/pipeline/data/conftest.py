"""A small data set of three shards."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.pipeline.data.making import SHARDS, SMALL, make


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """A data set of three shards; for reading only."""
    folder = tmp_path_factory.mktemp("whole")
    assert make(SMALL, folder)["complete"]
    return folder


@pytest.fixture
def copy(whole, tmp_path) -> Path:
    """Its shards, without the index."""
    for name in SHARDS:
        (tmp_path / name).write_bytes((whole / name).read_bytes())
    return tmp_path
