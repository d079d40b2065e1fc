"""A small data set, and what tests do with it."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import h5py
import hdf5plugin  # noqa: F401  (for h5py, which reads zstd with it)

from pipeline.data import layout
from pipeline.data.generate import generate
from pipeline.data.recipe import GenerateOptions, Recipe
from pipeline.scenes import Thesis

SMALL = Recipe(scene=Thesis(bodies=6), options=GenerateOptions(worlds=5, seed=7, steps=70, dt=0.02, shard_worlds=2))
SHARDS = ["shard-00000.h5", "shard-00001.h5", "shard-00002.h5"]
FILTERS = {"zstd": (2, 32015, 3), "gzip": (2, 1, 3)}  # shuffle, the codec, fletcher32, as they are registered


def changed(recipe: Recipe, **options) -> Recipe:
    """A recipe with other options."""
    return dataclasses.replace(recipe, options=dataclasses.replace(recipe.options, **options))


def make(recipe: Recipe, folder: Path, **options) -> dict:
    """A data set, without a bar."""
    return generate(recipe, folder, **{"threads": 1, "progress": False, **options})


def contents(folder: Path) -> dict[str, bytes]:
    """Every file of a folder but the index, which tells how many worlds there are."""
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir()) if path.name != layout.INDEX}


def filters(data: h5py.Dataset) -> tuple[int, ...]:
    """Filters that HDF5 applied to a dataset, in their order."""
    properties = data.id.get_create_plist()
    return tuple(properties.get_filter(i)[0] for i in range(properties.get_nfilters()))
