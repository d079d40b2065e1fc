"""The weights of ContactNet in the package from nothing: calls recorded in worlds, steps on them, choice of gains."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

from bench import timing

SUMMARY = "training of the ContactNet in the package from nothing, in minutes"
KEYS = ("minutes",)
THREADS = 1

STEPS_QUICK = 40  # of one round


def measure(quick: bool) -> dict[str, Any]:
    """The whole training; ``--quick`` takes part of one round and says what the rounds would take at that speed."""
    import torch

    from pipeline.contactnet.options import ContactTrainOptions
    from pipeline.contactnet.training import ContactTraining, train_contactnet
    from pipeline.training.processes import Processes

    torch.set_num_threads(THREADS)
    with tempfile.TemporaryDirectory() as folder:
        options = ContactTrainOptions(out=Path(folder), threads=THREADS)
        if not quick:
            made = train_contactnet(options)
            kept = ("parameters", "steps", "minutes", "metrics", "tuning")
            return {name: made[name] for name in kept} | {"extrapolated": False}
        import numpy as np

        training = ContactTraining(replace(options, rounds=1), Processes())
        calls: list[Any] = []
        recording = timing.seconds(lambda: calls.extend(training.record(0)))
        generator = np.random.default_rng(0)
        steps = timing.seconds(lambda: [training.step(training.batch(calls, generator), i) for i in range(STEPS_QUICK)])
        training.log.close()
    round_s = recording + steps / STEPS_QUICK * options.steps
    return {
        "minutes": options.rounds * round_s / 60.0,
        "steps": options.rounds * options.steps,
        "recording_s": recording,
        "step_s": steps / STEPS_QUICK,
        "extrapolated": True,
    }


def report(values: dict[str, Any]) -> str:
    """Table for people."""
    rows = [("minutes" + (" (extrapolated)" if values["extrapolated"] else ""), values["minutes"])]
    rows += [(name, values[name]) for name in ("steps", "recording_s", "step_s") if name in values]
    rows += sorted(values.get("metrics", {}).items())
    return timing.table(("ContactNet from nothing", ""), rows)
