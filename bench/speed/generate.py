"""A data set of thesis worlds from nothing: simulated, solved on to the labels, compressed, written, indexed.

Each world is 100 discs that fall into a box, 250 steps of 0.01 s solved to 1e-4 N s; each state is solved on to its
label. A shard of four worlds is made beforehand, so that compiling is not in the time.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from bench import timing

SUMMARY = "1 000 thesis worlds as a data set on 2 cores, with the bytes that a state takes"
KEYS = ("seconds_per_1000", "bytes_per_step")
THREADS = 2

WORLDS, WORLDS_QUICK = 1_000, 100
PARTS = {"contact": "contacts", "motion": "bodies", "step": "solver"}


def measure(quick: bool) -> dict[str, Any]:
    """One run; ``--quick`` multiplies the time of a tenth of the worlds."""
    from pipeline.data import layout, shards
    from pipeline.data.generate import generate
    from pipeline.data.recipe import GenerateOptions, Recipe

    worlds = WORLDS_QUICK if quick else WORLDS
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        few = GenerateOptions(worlds=4, shard_worlds=2, steps=2)
        generate(Recipe(options=few), out / "few", threads=THREADS, progress=False)
        timing.progress(f"{worlds} worlds")
        recipe = Recipe(options=GenerateOptions(worlds=worlds))
        made = generate(recipe, out / "whole", threads=THREADS, progress=False)
        parts: dict[str, int] = {}
        for number in range(recipe.options.shard_count):
            with shards.opened(layout.shard_path(out / "whole", number)) as file:
                for name, data in shards.datasets(file):
                    parts[name] = parts.get(name, 0) + data.id.get_storage_size()
        with shards.opened(out / "whole" / layout.INDEX) as file:
            sweeps, further = file["step/sweeps"][...].mean(), file["step/label_sweeps"][...].mean()
    states = made["states"]
    return {
        "seconds_per_1000": made["seconds"] * WORLDS / worlds,
        "bytes_per_step": made["bytes_per_state"],
        "worlds": worlds,
        "states": states,
        "seconds": made["seconds"],
        "contacts": made["contacts_mean"],
        "mean_sweeps": float(sweeps),
        "mean_label_sweeps": float(further),
        "label_reached": made["label_reached"],
        **{f"{axis}_bytes": sum(n for name, n in parts.items() if name.startswith(axis)) / states for axis in PARTS},
    }


def report(values: dict[str, Any]) -> str:
    """Table for people."""
    rows = [
        ("1 000 thesis worlds, 250 000 states [s]", values["seconds_per_1000"]),
        ("bytes a state, file and index", values["bytes_per_step"]),
        *((f"  of {name}", values[f"{axis}_bytes"]) for axis, name in PARTS.items()),
        ("contacts of a state", values["contacts"]),
        ("sweeps to 1e-4 N s", values["mean_sweeps"]),
        ("further sweeps to the label", values["mean_label_sweeps"]),
        ("labels that reach it [%]", 100.0 * values["label_reached"]),
    ]
    return timing.table((f"{values['worlds']} worlds made, {THREADS} threads", ""), rows)
