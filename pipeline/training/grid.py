"""Training of the theses' networks on images of a data set's states.

What a training writes into its folder:

- ``best.safetensors``, ``last.safetensors``: the network with the least validation loss, and the last one, each with
  its manifest (``networks.checkpoint``);
- ``training.safetensors``: what ``--resume`` continues from, bit for bit on one thread;
- ``metrics.jsonl`` and ``tensorboard/``: loss, rate, gradient and validation by step;
- ``train.json``, ``curves.png``, ``predictions.png``, with the rate finder ``rates.png``: summary and pictures.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from dc_kernels.grid.image_spec import ImageSpec
from dc_kernels.grid.stencil import Stencil
from dc_kernels.runtime.imports import require
from pipeline.data import dataset
from pipeline.data.splatter import Splatter
from pipeline.files import check_writable, plain, write_json
from pipeline.networks import models
from pipeline.networks.checkpoint import (
    all_versions,
    load_checkpoint,
    load_training,
    save_checkpoint,
    save_training,
)
from pipeline.plots import training as training_plots
from pipeline.plots.style import save_figure
from pipeline.process import Stop, interruptible, progress_bar
from pipeline.training.log import Log
from pipeline.training.losses import Decoder, Loss
from pipeline.training.optimizer import check_loss, clip_gradients, continued_schedule, make_optimizer, make_schedule
from pipeline.training.options import CACHED, TrainOptions
from pipeline.training.preparation import build_network, check_network, make_grid
from pipeline.training.processes import Processes, own_randomness, processes, seed_everything
from pipeline.training.rate import RateSearch, find_rate
from pipeline.training.scales import find_scales
from pipeline.training.validation import Validation

torch = require("torch", "pipeline")

RATE_BATCHES = 8
"""Number of batches that the rate finder goes over in turn [1]."""
BOUND = 10.0
"""Magnitude to which scaled input channels are cut: that of walls would drown all else [1]."""
BEST, LAST, STATE = "best.safetensors", "last.safetensors", "training.safetensors"
FREE = ("data", "out", "resume", "threads", "workers", "log_every", "save_every")
"""Options that change no bit of what is trained; data sets are compared by what they hold instead."""


def train_grid_network(network: str, options: TrainOptions | None = None, progress: bool = True) -> dict[str, Any]:
    """Train a network of the theses; Ctrl-C ends it early, with whole files to resume from.

    Under ``torchrun`` each process takes its share of every batch; the first one prints and writes.

    Args:
        network: convfc, pressure, peak, unet, or another one that is registered to read images.
        options: what is trained on, how, and what is written.
        progress: show a bar on stderr.

    Returns:
        The content of ``train.json``.

    Raises:
        ValueError: for an option out of its range, a data set that is none or too small, states of held-out seeds, or
            a loss that is not finite, naming the step.
        OSError: the folder cannot be written into.
        ImportError: naming the extra, without torch, h5py or matplotlib.
    """
    options = options or TrainOptions()
    check_network(network)
    torch.set_num_threads(options.threads)
    with processes() as group, interruptible() as stop:
        with stop.urgent():
            run = GridTraining(network, options, group)
        try:
            return run.run(stop, progress and group.first)
        finally:
            run.log.close()


class GridTraining:
    """A training under way: its data, network and optimiser, and the steps that are done."""

    def __init__(self, network: str, options: TrainOptions, group: Processes) -> None:
        """Find the data, make network and optimiser, and continue where an earlier run stopped.

        Raises:
            ValueError: see ``train_grid_network``.
        """
        self.network, self.options, self.group = network, options, group
        if options.batch_size % group.size:
            raise ValueError(f"batch_size is {options.batch_size}; {group.size} processes cannot share it evenly")
        self.setup = check_network(network)
        self._find_data()
        check_writable(options.out, BEST, LAST, STATE)
        self._build_network()
        self._prepare_steps()
        if options.resume:
            self.restore()
        self.log = Log(options.out, self.step, enabled=group.first)

    def _find_data(self) -> None:
        """Describe the data set, and choose grid, images and batches."""
        options, group, setup = self.options, self.group, self.setup
        self.data = dataset.describe(options.data)
        grid = make_grid(self.data["box"], setup.nodes if options.nodes is None else options.nodes)
        self.images = ImageSpec(
            grid,
            body_channels=setup.bodies,
            contact_channels=(*setup.contacts, *(CACHED if options.cached else ())),
            stencil=Stencil(h=options.h),
            bins=options.bins,
            walls=options.walls,
        )
        self.splatter = Splatter(self.images, threads=options.threads)
        reverse = (options.decode or setup.decode) == "reverse"
        self.decode = Decoder(images=self.images, reverse=reverse, threads=options.threads)
        self.train = self.loader("train", rank=group.rank, world_size=group.size)
        self.held = self.loader("validation")
        if not len(self.train):
            raise ValueError(f"{_shown(options.data)} has fewer training states than a batch of {options.batch_size}")

    def _build_network(self) -> None:
        """Build the network with random weights, scale it, and choose what is minimized."""
        options, group = self.options, self.group
        seed_everything(options.seed)
        self.model = build_network(self.network, self.images, options)
        grid_scale, contact_scale = self.set_scales()
        group.broadcast(self.model)
        seed_everything(options.seed, group.rank)
        self.loss = Loss(
            name=options.loss,
            decode=self.decode,
            grid_scale=grid_scale,
            contact_scale=contact_scale,
            sweeps=options.sweeps,
        )
        self.validation = Validation(batches=self.held, splatter=self.splatter, decode=self.decode, loss=self.loss)

    def _prepare_steps(self) -> None:
        """Set the counts to zero, and make optimiser and schedule, whose rate is searched on request."""
        options, setup = self.options, self.setup
        self.epoch = self.batch = self.step = 0
        self.best: float | None = None
        self.metrics: dict[str, float] = {}
        self.running = [0.0, 0]  # sum of the losses since the last line of the log, and their number
        self.spent = 0.0  # [s] in earlier runs
        self.search: RateSearch | None = None
        steps = options.epochs * len(self.train)
        rate = setup.rate if options.rate is None else options.rate
        self.choices: dict[str, Any] = {
            "optimizer": options.optimizer or setup.optimizer,
            "schedule": options.schedule or setup.schedule,
            "rate": rate,
        }
        if options.find_rate and not options.resume:
            self.search = self.find_rate()
            self.choices["rate"] = self.search.rate
        self.optimizer = self.make_optimizer()
        self.schedule = make_schedule(self.optimizer, self.choices["schedule"], steps, decay=options.decay)

    # ------------------------------------------------------------------ data

    def loader(self, split: dataset.Split, rank: int = 0, world_size: int = 1) -> Any:
        """Make batches of a split, those of training in the epoch's order, of which this process takes its share."""
        options, training = self.options, split == "train"
        return dataset.loader(
            options.data,
            batch_size=options.batch_size // world_size,
            split=split,
            shuffle=training,
            drop_last=training,
            seed=options.seed,
            num_workers=options.workers,
            stride=options.stride,
            validation=options.validation,
            rank=rank,
            world_size=world_size,
        )

    def batches(self, epoch: int, skip: int = 0) -> Iterator[Any]:
        """Go through the training batches of an epoch, without the first ``skip``; torch's generator is left alone."""
        self.train.set_epoch(epoch)
        with own_randomness():
            batches = iter(self.train)
        return itertools.islice(batches, skip, None)

    def set_scales(self) -> tuple[Any, Any]:
        """Scale the network by what training states show; returns the scales of the losses, of images and contacts."""
        if self.options.scaling == "none":
            return torch.ones(self.images.impulse_channels), torch.ones(2)
        with own_randomness():
            scales = find_scales(self.loader("train"), self.splatter, self.options.walls)
        self.model.set_scales(scales.channels, scales.outputs, BOUND)
        return scales.nodes, scales.contacts

    # ------------------------------------------------------------------ steps

    def run(self, stop: Stop, progress: bool) -> dict[str, Any]:
        """Train to the end or until ``stop``, write all files, and return the summary."""
        options = self.options
        began, stopped = time.perf_counter(), False
        steps = len(self.train)
        bar = progress_bar(
            total=options.epochs * steps,
            initial=self.step,
            desc=f"train {self.network}",
            unit="step",
            show=progress,
        )
        with bar:
            while self.epoch < options.epochs and not stopped:
                for batch in self.batches(self.epoch, skip=self.batch):
                    stopped = self.learn(batch, stop.is_set())
                    bar.update()
                    if self.step % options.log_every == 0:
                        bar.set_postfix(loss=f"{self.note():.4g}", **self.shown_metrics())
                    if stopped or self.step % options.save_every == 0:
                        self.save(began)
                    if stopped:
                        break
                if not stopped:
                    self.epoch, self.batch = self.epoch + 1, 0
                    self.validate()
                    self.save(began)
        return self.finish(began)

    def learn(self, batch: Any, stop: bool = False) -> bool:
        """Make a step of the optimiser; returns whether any process is to stop.

        Raises:
            ValueError: loss or gradient are not finite, naming the step.
        """
        self.model.train()
        self.optimizer.zero_grad()
        total, weight = self.total(batch)
        means = self.group.mean(torch.stack([total.detach(), weight.detach(), torch.tensor(float(stop))]))
        loss = means[0] / means[1]
        check_loss(loss, self.step)
        (total / means[1]).backward()
        self.group.average_gradients(self.model.parameters())
        self.gradient = clip_gradients(self.model.parameters(), self.options.clip, self.step)
        self.optimizer.step()
        self.schedule.step()
        self.step, self.batch = self.step + 1, self.batch + 1
        self.running = [self.running[0] + float(loss), self.running[1] + 1]
        return bool(means[2] > 0)

    def total(self, batch: Any) -> tuple[Any, Any]:
        """Return total and weight of a batch's loss."""
        images, target = self.splatter(batch)
        return self.loss(self.model(images), target, batch)

    def make_optimizer(self) -> Any:
        """Make the optimiser that was chosen."""
        return make_optimizer(
            self.model.parameters(),
            self.choices["optimizer"],
            self.choices["rate"],
            weight_decay=self.options.weight_decay,
        )

    def find_rate(self) -> RateSearch:
        """Find the rate by a short training in which it grows."""
        batches = list(itertools.islice(self.batches(0), RATE_BATCHES))
        self.model.train()

        def loss(i: int) -> Any:
            total, weight = self.total(batches[i])
            return total / self.group.mean(weight)

        return find_rate(self.model, self.make_optimizer(), loss, batches=len(batches), group=self.group)

    def note(self) -> float:
        """Log what the steps since the last line did; returns their mean loss."""
        mean = self.running[0] / max(self.running[1], 1)
        rate = self.optimizer.param_groups[0]["lr"]
        self.log.add(self.step, {"train/loss": mean, "train/rate": rate, "train/gradient": self.gradient})
        self.running = [0.0, 0]
        return mean

    # ------------------------------------------------------------------ validation

    def validate(self) -> None:
        """Measure the network on the validation states, log it, and keep it if it is the best so far.

        Every process does all of it, so that all know the same without a message.
        """
        self.metrics = self.validation.measure(self.model)
        self.log.add(self.step, {f"validation/{name}": value for name, value in self.metrics.items()})
        if self.best is not None and not self.metrics["loss"] < self.best:
            return
        self.best = self.metrics["loss"]
        if self.group.first:
            save_checkpoint(self.options.out / BEST, self.model, self.manifest())

    def shown_metrics(self) -> dict[str, str]:
        """Return what the bar says of the last validation."""
        return {name: f"{self.metrics[name]:.3g}" for name in training_plots.NAMES.values() if name in self.metrics}

    # ------------------------------------------------------------------ files

    def identity(self) -> dict[str, Any]:
        """Return what decides the bits of this training."""
        options = {name: value for name, value in asdict(self.options).items() if name not in (*FREE, "epochs")}
        return {**options, "processes": self.group.size, "data": self.data}

    def manifest(self) -> dict[str, Any]:
        """Return what the network's file says of it."""
        return {
            "images": plain(self.images.to_dict()),
            "decode": {"reverse": self.decode.reverse},
            "parameters": models.parameter_count(self.model),
            "options": _plain_options(self.options),
            "choices": self.choices,
            "seed": self.options.seed,
            "data": self.data,
            "step": self.step,
            "epoch": self.epoch,
            "metrics": self.metrics,
            "versions": all_versions(),
        }

    def save(self, began: float) -> None:
        """Write the network and what the training continues from; all processes call it."""
        rng = self.group.gather(torch.get_rng_state())
        if not self.group.first:
            return
        progress = {
            "epochs": self.options.epochs,
            "epoch": self.epoch,
            "batch": self.batch,
            "step": self.step,
            "best": self.best,
            "metrics": self.metrics,
            "running": self.running,
            "choices": self.choices,
            "search": self.search and self.search.plain(),
            "spent": self.spent + time.perf_counter() - began,
        }
        save_checkpoint(self.options.out / LAST, self.model, self.manifest())
        state = self.options.out / STATE
        save_training(state, self.model, self.optimizer, self.schedule, progress, self.identity(), {"rng": rng})

    def restore(self) -> None:
        """Continue where ``save`` left off, to as many epochs as the options ask for.

        Raises:
            ValueError: another training, one of more epochs already, or the middle of a cycle of the rate that more
                epochs would change.
        """
        state = self.options.out / STATE
        progress, extra = load_training(state, self.model, self.optimizer, self.schedule, self.identity())
        torch.set_rng_state(extra["rng"][self.group.rank])
        for name in ("epoch", "batch", "step", "best", "metrics", "running", "choices", "spent"):
            setattr(self, name, progress[name])
        self.search = progress["search"] and RateSearch(**progress["search"])
        self.schedule = continued_schedule(
            self.schedule,
            self.optimizer,
            self.choices["rate"],
            unit="epochs",
            wanted=self.options.epochs,
            planned=progress["epochs"],
            done=self.epoch,
            each=len(self.train),
            folder=self.options.out,
        )

    def finish(self, began: float) -> dict[str, Any]:
        """Draw the pictures, write and return the summary."""
        options, complete = self.options, self.epoch == self.options.epochs
        summary: dict[str, Any] = {
            "network": self.network,
            "complete": complete,
            "epochs": self.epoch,
            "steps": self.step,
            "parameters": models.parameter_count(self.model),
            "best_loss": self.best,
            "metrics": self.metrics,
            "training_s": self.spent + time.perf_counter() - began,
            "choices": self.choices,
            "search": self.search and self.search.plain(),
            "processes": self.group.size,
            "data": self.data,
            "options": _plain_options(options),
            "versions": all_versions(),
            "out": str(options.out),
        }
        if not self.group.first:
            return summary
        title = f"{self.network}, {summary['parameters']:,} weights, {self.epoch} epochs, loss {options.loss}"
        figures = {"curves.png": training_plots.curves_figure(self.log.rows, title)}
        if self.search is not None:
            figures["rates.png"] = training_plots.rates_figure(self.search)
        if (options.out / BEST).exists() and self.metrics:
            shown = self.validation.predict(load_checkpoint(options.out / BEST)[0])
            figures["predictions.png"] = training_plots.predictions_figure(shown, f"{title}: validation states")
        for name, figure in figures.items():
            save_figure(figure, options.out / name)
        networks = [name for name in (BEST, LAST, STATE) if (options.out / name).exists()]
        summary["files"] = [*networks, "metrics.jsonl", "train.json", *figures]
        write_json(options.out / "train.json", summary)
        return summary


def _plain_options(options: TrainOptions) -> dict[str, Any]:
    """Return options with their paths as text, for JSON."""
    data = [str(path) for path in options.data] if isinstance(options.data, tuple) else str(options.data)
    return {**asdict(options), "data": data, "out": str(options.out)}


def _shown(data: Path | tuple[Path, ...]) -> str:
    """Return the folder of a data set, or all of them, as text."""
    return ", ".join(map(str, data)) if isinstance(data, tuple) else str(data)
