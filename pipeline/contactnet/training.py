"""Training of a ContactNet on its own calls: rounds of solves in which they are recorded, and of steps on them.

Each round records anew with the network as it stands, so its data are never stored, and an interrupted training goes on
from the last whole round, bit for bit on one thread. Files in the folder: ``contactnet.safetensors`` (the network and
its manifest), ``training.safetensors``, ``metrics.jsonl``, ``tensorboard/``, ``train.json``, ``curves.png``.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

import dc_kernels as dc
from dc_kernels.learn.channels import Scale
from dc_kernels.runtime.imports import require
from pipeline.contactnet.loss import ERRORS, CallBatch, errors_left, predicted
from pipeline.contactnet.network import EvenShare
from pipeline.contactnet.options import ContactTrainOptions
from pipeline.contactnet.rollouts import SETTINGS, Setting, record, seeds_of
from pipeline.contactnet.tuning import choose_gains
from pipeline.files import check_writable, plain, write_json
from pipeline.networks import models
from pipeline.networks.checkpoint import all_versions, commit, load_training, save_checkpoint, save_training
from pipeline.options import RunOptions
from pipeline.plots.contactnet import contact_curves_figure, contact_predictions_figure
from pipeline.plots.style import save_figure
from pipeline.process import Stop, interruptible, progress_bar
from pipeline.scenes import Thesis
from pipeline.seeds import HELD_OUT_SEED, TUNING_SEED, VALIDATION_SEED
from pipeline.starts.learned import grid_of
from pipeline.training.log import Log
from pipeline.training.optimizer import check_loss, clip_gradients, make_optimizer, make_schedule
from pipeline.training.processes import Processes, processes, seed_everything

torch = require("torch", "pipeline")

NETWORK, STATE = "contactnet.safetensors", "training.safetensors"
VALIDATION_CALLS = 100
"""Calls of validation of each kind of world [1]."""
Recorded = tuple[tuple[int, str], dict[str, Any]]
"""Discs and acceleration of a world, and a call in it."""
WEIGHTS = {"velocity": 0.3, "impulse": 0.2, "step": 0.5}
"""Weights of the errors in the loss [1]."""
AFTER = (20, 40, 80)
"""Sweeps after which the error of a call counts; steps take them in turn [1]."""
SLOW = 0.5
"""Power of 1 + A in the weight of a world, as an error there costs more sweeps [1]."""


def settings_of(options: ContactTrainOptions) -> tuple[Setting, ...]:
    """Return what is recorded in a round."""
    return tuple(replace(setting, worlds=max(1, round(options.worlds * setting.worlds))) for setting in SETTINGS)


def train_contactnet(options: ContactTrainOptions | None = None, progress: bool = True) -> dict[str, Any]:
    """Train a ContactNet; Ctrl-C ends it, with whole files to resume from: those of the last round that is done.

    Under ``torchrun`` each process records worlds of its own and the gradients are averaged.

    Args:
        options: how.
        progress: show a bar on stderr.

    Returns:
        The content of ``train.json``.

    Raises:
        ValueError: for an option out of its range, a training to resume that is another one, or a loss that is not
            finite, naming the step.
        OSError: the folder cannot be written into.
    """
    options = options or ContactTrainOptions()
    torch.set_num_threads(options.threads)
    with processes() as group, interruptible() as stop:
        with stop.urgent():
            training = ContactTraining(options, group)
        return training.run(stop, progress and group.first)


class ContactTraining:
    """A training under way: its network, its optimiser, and the rounds that are done."""

    def __init__(self, options: ContactTrainOptions, group: Processes) -> None:
        """Make network and optimiser, and continue where an earlier run stopped.

        Raises:
            ValueError: see ``train_contactnet``.
        """
        self.options, self.group = options, group
        last = options.seed + options.rounds * group.size * seeds_of(settings_of(options))
        if last > TUNING_SEED:
            raise ValueError(
                f"the worlds' seeds go from {options.seed} to {last}; those from {TUNING_SEED} on are for the gains, "
                f"from {VALIDATION_SEED} on for validation, from {HELD_OUT_SEED} on for tests"
            )
        check_writable(options.out, NETWORK, STATE)
        seed_everything(options.seed)
        names = ("spacing", "channels", "near", "hidden")
        self.model = models.build("contactnet", {name: getattr(options, name) for name in names})
        group.broadcast(self.model)
        self.optimizer = make_optimizer(
            self.model.parameters(), "adamw", options.rate, weight_decay=options.weight_decay
        )
        self.schedule = make_schedule(self.optimizer, "onecycle", options.rounds * options.steps, warm=0.1)
        free = ("out", "resume", "threads")
        self.identity = {k: v for k, v in plain(asdict(options)).items() if k not in free} | {"processes": group.size}
        self.round, self.seconds = 0, 0.0
        self.tuned: dict[str, Any] = {}
        if options.resume:
            done, _ = load_training(options.out / STATE, self.model, self.optimizer, self.schedule, self.identity)
            self.round, self.seconds, self.tuned = int(done["round"]), float(done["seconds"]), done["tuned"]
        self.log = Log(options.out, self.round * options.steps, enabled=group.first)
        self.grids: dict[int, Any] = {}

    def run(self, stop: Stop, progress: bool) -> dict[str, Any]:
        """Run the rounds that are left, and return the summary."""
        options = self.options
        with stop.urgent():
            self.validation = self.record(-1)
        total = options.rounds * options.steps
        bar = progress_bar(total=total, initial=self.round * options.steps, desc="train contactnet", show=progress)
        try:
            with bar:
                while self.round < options.rounds and not self.group.any(stop.is_set()):
                    began = time.perf_counter()
                    with stop.urgent():
                        self.train(bar)
                    self.round += 1
                    self.seconds += time.perf_counter() - began
                    self.log.add(self.round * options.steps, self.validate())
                    if self.group.first:
                        self.save()
                if self.round == options.rounds and not self.tuned and self.group.first and not stop.is_set():
                    self.tune(stop, bar)
        finally:
            self.log.close()
        return self.finish() if self.group.first else {}

    def tune(self, stop: Stop, bar: Any) -> None:
        """Choose how much of the answer is used; an interrupt leaves the last round to resume from."""
        bar.set_postfix_str("choosing gains")
        began = time.perf_counter()
        self.model.eval()
        with stop.urgent():
            self.tuned = choose_gains(self.model, TUNING_SEED)
        self.seconds += time.perf_counter() - began
        self.save()

    def train(self, bar: Any) -> None:
        """Record the calls of a round and make its steps."""
        options = self.options
        bar.set_postfix_str("recording")
        calls = self.record(self.round)
        self.model.train()
        generator = np.random.default_rng([options.seed, self.round, self.group.rank, 1])
        for i in range(options.steps):
            step = self.round * options.steps + i
            loss = self.step(self.batch(calls, generator), step)
            bar.update()
            if i % 20 == 0:
                self.log.add(step + 1, {"train/gain": loss, "train/rate": self.optimizer.param_groups[0]["lr"]})
                bar.set_postfix(gain=f"{loss:.3f}", refresh=False)

    def record(self, round_: int) -> list[Recorded]:
        """Record the calls of a round; round -1 are those of validation."""
        options, rank = self.options, self.group.rank
        validation = round_ < 0
        generator = np.random.default_rng([options.seed, round_ + 1, rank])
        settings = settings_of(options)
        per_round = seeds_of(settings)
        seed = VALIDATION_SEED if validation else options.seed + (round_ * self.group.size + rank) * per_round
        self.model.eval()
        calls: list[Recorded] = []
        for setting in settings:
            if setting.bodies not in self.grids:
                sim = RunOptions().simulation(Thesis(bodies=setting.bodies), dc.SolverConfig.preset("accurate"))
                self.grids[setting.bodies] = grid_of(sim, options.spacing)
            kept = record(self.model, setting, seed, generator)
            seed += setting.worlds
            kind = (setting.bodies, setting.acceleration)
            calls += [(kind, call) for call in (kept[:VALIDATION_CALLS] if validation else kept)]
        return calls

    def batch(self, calls: Sequence[Recorded], generator: np.random.Generator) -> list[tuple[Any, CallBatch]]:
        """Draw calls until there are contacts enough; returns grid and batch for each kind of world."""
        drawn: list[Recorded] = []
        contacts = 0
        while contacts < self.options.contacts:
            drawn.append(calls[int(generator.integers(len(calls)))])
            contacts += len(drawn[-1][1]["impulse"])
        return [(grid, batch) for grid, batch, _ in self.batches(drawn)]

    def batches(self, calls: Sequence[Recorded]) -> list[tuple[Any, CallBatch, str]]:
        """Put calls together as one batch for each kind of world, with its grid and name."""
        kinds = sorted({kind for kind, _ in calls})
        return [
            (
                self.grids[bodies],
                CallBatch.of([call for kind, call in calls if kind == (bodies, solver)]),
                f"{solver}_{bodies}",
            )
            for bodies, solver in kinds
        ]

    def step(self, batches: Sequence[tuple[Any, CallBatch]], step: int) -> float:
        """Make a step of the optimiser; returns the mean log of the error over that of an even share."""
        after = AFTER[step % len(AFTER)]
        total: Any = 0.0
        weights = gain = 0.0
        for grid, batch in batches:
            difference = self.difference(batch, grid, after)
            weight = (1.0 + batch.scale[:, Scale.RATE]) ** SLOW
            total = total + (weight * difference).sum()
            gain += float((weight * difference.detach()).sum())
            weights += float(weight.sum())
        loss = total / weights
        check_loss(loss.detach(), step + 1)
        self.optimizer.zero_grad()
        loss.backward()
        self.group.average_gradients(self.model.parameters())
        clip_gradients(self.model.parameters(), self.options.clip, step + 1)
        self.optimizer.step()
        self.schedule.step()
        return gain / weights

    def difference(self, batch: CallBatch, grid: Any, after: int) -> Any:
        """Log of the error that is left after some sweeps over that of an even share of Aitken's step, (B,)."""
        found = errors_left(batch, self.model, grid, after)
        with torch.no_grad():
            even = errors_left(batch, EvenShare(), grid, after)
        return sum(WEIGHTS[name] * (found[name] - even[name]) for name in ERRORS)

    def validate(self) -> dict[str, float]:
        """Return mean logs of the errors over those of an even share, by sweeps after the call and by kind of world."""
        self.model.eval()
        values: dict[str, list[float]] = {}
        with torch.no_grad():
            for first in range(0, len(self.validation), VALIDATION_CALLS):
                group = self.validation[first : first + VALIDATION_CALLS]
                for grid, batch, kind in self.batches(group):
                    for after in AFTER:
                        difference = self.difference(batch, grid, after)
                        for key in (f"after_{after}", kind, "gain"):
                            values.setdefault(key, []).extend(difference.tolist())
        return {f"validation/{key}": float(np.mean(value)) for key, value in values.items()}

    def predictions(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return impulses before the calls of validation, after them, and the true ones, (M, 2) each [N s]."""
        self.model.eval()
        found = []
        with torch.no_grad():
            for grid, batch, _ in self.batches(self.validation):
                after = predicted(batch, self.model, grid)
                found.append((batch.impulse, after, batch.label))
        before, after, label = (torch.cat(parts).numpy() for parts in zip(*found))
        return before, after, label

    def save(self) -> None:
        """Write network and state, each in one go."""
        options = self.options
        progress = {"round": self.round, "seconds": self.seconds, "tuned": self.tuned}
        save_checkpoint(options.out / NETWORK, self.model, self.manifest())
        save_training(options.out / STATE, self.model, self.optimizer, self.schedule, progress, self.identity)

    def manifest(self) -> dict[str, Any]:
        """Return what the network was trained on, for its file."""
        options = self.options
        last = self.log.rows[-1] if self.log.rows else {}
        return plain(
            {
                "options": self.identity,
                "settings": [asdict(setting) for setting in settings_of(options)],
                "seeds": [options.seed, options.seed + self.round * self.group.size * seeds_of(settings_of(options))],
                "rounds": self.round,
                "steps": self.round * options.steps,
                "minutes": self.seconds / 60.0,
                "tuning": self.tuned,
                "metrics": {k: v for k, v in last.items() if k != "step"},
                "commit": commit(),
                "versions": all_versions(),
            }
        )

    def finish(self) -> dict[str, Any]:
        """Draw the pictures, and write and return the summary."""
        options = self.options
        summary = {
            "network": "contactnet",
            "parameters": models.parameter_count(self.model),
            "complete": self.round == options.rounds and bool(self.tuned),
            **self.manifest(),
            "out": str(options.out),
            "files": [NETWORK, STATE, "metrics.jsonl", "train.json", "curves.png", "predictions.png"],
        }
        title = f"contactnet, {summary['parameters']:,} weights, {summary['minutes']:.0f} minutes"
        save_figure(contact_curves_figure(self.log.rows, title), options.out / "curves.png")
        predictions = contact_predictions_figure(*self.predictions(), f"{title}: one call")
        save_figure(predictions, options.out / "predictions.png")
        write_json(options.out / "train.json", summary)
        return summary


def describe_contact_training(summary: dict[str, Any]) -> str:
    """Say what a training did, in a few lines."""
    tuning, metrics = summary["tuning"], summary["metrics"]
    lines = [
        f"contactnet: {summary['parameters']:,} weights, {summary['steps']} steps, {summary['minutes']:.1f} minutes"
        + ("" if summary["complete"] else "; interrupted, --resume goes on"),
    ]
    if "validation/gain" in metrics:
        left = math.exp(metrics["validation/gain"])
        lines.append(f"error left by a call, over that of an even share of Aitken's step: {left:.2f}")
    if tuning:
        plain_gain, accelerated = tuning["gain"]
        lines.append(
            f"gain of the answer: {plain_gain:g} with plain sweeps, {accelerated:g} with an accelerated solver"
        )
    lines.append(f"{summary['out']}: {', '.join(summary['files'])}")
    return "\n".join(lines)
