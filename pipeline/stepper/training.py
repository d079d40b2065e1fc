"""Training of a stepper on recorded motions (``deep-contact train-stepper``).

A step of the training puts some worlds to recorded states, lets the simulation find their contacts, asks the network
for the velocities at t + dt, and compares these with the recorded ones. In a rollout the network's velocities then move
the bodies, and it is asked again; the gradient goes back through the velocities of all its steps, not through the
places and contacts. The recorded steps are finer than dt where that is several of them: a network may learn what a
solver loses by a coarse step.

Files in the folder: ``best.safetensors`` and ``last.safetensors`` (the network and its manifest, that of the least
validation loss and the last one), ``training.safetensors`` (``--resume`` goes on bit for bit on one thread),
``metrics.jsonl``, ``tensorboard/``, ``train.json``, ``curves.png``.
"""

from __future__ import annotations

import time
from dataclasses import asdict
from typing import Any

import numpy as np

from dc_kernels.learn.step_channels import CHANNELS
from dc_kernels.runtime.imports import require
from pipeline.data.dataset import Split, describe
from pipeline.data.generate import generate
from pipeline.data.recipe import GenerateOptions, Recipe
from pipeline.files import check_writable, plain, write_json
from pipeline.networks import models
from pipeline.networks.checkpoint import all_versions, commit, load_training, save_checkpoint, save_training
from pipeline.plots.stepper import stepper_curves_figure
from pipeline.plots.style import save_figure
from pipeline.process import Stop, interruptible, progress_bar
from pipeline.scenes import Thesis
from pipeline.starts.learned import grid_of
from pipeline.stepper.answer import OUTPUTS, answer, errors, image_of, reads_views
from pipeline.stepper.motions import Motion, read_motions
from pipeline.stepper.options import StepperTrainOptions
from pipeline.stepper.replay import Replay
from pipeline.stepper.view import StepReader, StepView
from pipeline.training.log import Log
from pipeline.training.optimizer import check_loss, clip_gradients, continued_schedule, make_optimizer, make_schedule
from pipeline.training.preparation import check_network, configuration, make_grid
from pipeline.training.processes import seed_everything

torch = require("torch", "pipeline")

BEST, LAST, STATE = "best.safetensors", "last.safetensors", "training.safetensors"
FREE = ("data", "out", "resume", "steps", "threads", "log_every", "save_every")
"""Options that change no bit of the steps that are made; data sets are compared by what they hold instead."""
FLOOR = 1.0
"""Error of a world that counts as nothing, beside that of no contacts at all [unit^2]."""
WARM = 0.1
"""Share of the steps in which the rate of one cycle goes up [1]."""
CHECKED = 8
"""States of each validation world that are looked at, for each time step [1]."""


def train_stepper(network: str, options: StepperTrainOptions | None = None, progress: bool = True) -> dict[str, Any]:
    """Train a stepper; Ctrl-C ends it early, with whole files to resume from.

    Args:
        network: stepnet, or one that maps images to images: convfc, pressure, peak, unet, one of a plugin.
        options: what is trained on, how, and what is written.
        progress: show a bar on stderr.

    Returns:
        The content of ``train.json``.

    Raises:
        ValueError: for an option out of its range, a data set that is too short, states of held-out seeds, or a loss
            that is not finite, naming the step.
        OSError: the folder cannot be written into.
    """
    options = options or StepperTrainOptions()
    torch.set_num_threads(options.threads)
    with interruptible() as stop:
        with stop.urgent():
            training = StepperTraining(network, options, progress)
        try:
            return training.run(stop, progress)
        finally:
            training.log.close()


class StepperTraining:
    """A training under way: its worlds, network and optimiser, and the steps that are done."""

    def __init__(self, network: str, options: StepperTrainOptions, progress: bool = False) -> None:
        """Find the data, make network and optimiser, and continue where an earlier run stopped.

        Raises:
            ValueError: see ``train_stepper``.
        """
        self.network, self.options = network, options
        if network != "stepnet":
            check_network(network)
        elif options.loss == "grid":
            raise ValueError("loss is 'grid'; stepnet answers bodies, not an image: take 'bodies'")
        check_writable(options.out, BEST, LAST, STATE)
        self._find_data(progress)
        self._build_network()
        self.optimizer = make_optimizer(
            self.model.parameters(), options.optimizer, options.rate, weight_decay=options.weight_decay
        )
        self.schedule = make_schedule(self.optimizer, options.schedule, options.steps, decay=options.decay, warm=WARM)
        self.done, self.spent, self.began = 0, 0.0, time.perf_counter()
        self.best: float | None = None
        self.metrics: dict[str, float] = {}
        self.commit = commit()
        if options.resume:
            self._restore()
        self.log = Log(options.out, self.done)

    def _find_data(self, progress: bool) -> None:
        """Read the recorded motions, and put them into simulations of ``batch_size`` worlds each."""
        options = self.options
        folders = options.data
        if not folders:
            recipe = Recipe(scene=Thesis(), options=GenerateOptions(worlds=options.worlds, seed=options.seed))
            folders = (options.out / "data",)
            made = generate(recipe, folders[0], progress=progress)
            if not made["complete"]:
                raise KeyboardInterrupt
        self.data = describe(list(folders))
        longest = max(options.every) * max(options.rollout)
        groups: dict[Split, list[Motion]] = {}
        splits: tuple[Split, Split] = ("train", "validation")
        for split in splits:
            groups[split] = read_motions(list(folders), split, options.validation, options.seed)
            short = [motion for motion in groups[split] if motion.states <= longest]
            if short:
                found = f"the world of seed {short[0].seed} has {short[0].states} states"
                raise ValueError(f"{found}; every {max(options.every)} x rollout {max(options.rollout)} needs more")
        order = np.random.default_rng([options.seed, 2]).permutation(len(groups["train"]))
        motions = [groups["train"][i] for i in order]
        config = self.data["config"]
        size = options.batch_size
        if len(motions) < size:
            raise ValueError(f"batch_size is {size}; the data set has {len(motions)} worlds to train on")
        # the last worlds that make no whole batch go with those before them
        starts = range(0, len(motions) - size + 1, size)
        self.replays = [Replay(motions[i : i + size], config) for i in starts]
        self.held = Replay(groups["validation"], config)

    def _build_network(self) -> None:
        """Build the network with random weights, its grid, and what reads the worlds for it."""
        options = self.options
        seed_everything(options.seed)
        given: dict[str, Any] = {}
        if self.network != "stepnet":
            grid = make_grid(self.data["box"], options.nodes)
            rows, columns = grid.shape
            given = {
                "rows": rows,
                "columns": columns,
                "channels": len(CHANNELS),
                "outputs": OUTPUTS,
                "width": options.width,
                "dropout": options.dropout,
            }
        self.model = models.build(self.network, configuration(self.network, given, options.sizes))
        if reads_views(self.model):
            grid = grid_of(self.held.sim, self.model.config.spacing)
        self.grid = grid
        self.readers = {id(replay): StepReader(replay.sim, grid) for replay in (*self.replays, self.held)}

    # ------------------------------------------------------------------ steps

    def run(self, stop: Stop, progress: bool) -> dict[str, Any]:
        """Train to the end or until ``stop``, write all files, and return the summary."""
        options = self.options
        losses: list[float] = []
        bar = progress_bar(total=options.steps, initial=self.done, desc=f"train {self.network}", show=progress)
        with bar:
            while self.done < options.steps:
                losses.append(self.learn())
                bar.update()
                if self.done % options.log_every == 0:
                    self.log.add(self.done, self._line(losses))
                    bar.set_postfix(loss=f"{np.mean(losses):.3g}", **self._shown(), refresh=False)
                    losses = []
                last = self.done == options.steps or stop.is_set()
                if last or self.done % options.save_every == 0:
                    self._validate()
                    self._save()
                if stop.is_set():
                    break
        return self._finish()

    def _line(self, losses: list[float]) -> dict[str, float]:
        """Return what the log says of some steps."""
        return {"train/loss": float(np.mean(losses)), "train/rate": self.optimizer.param_groups[0]["lr"]}

    def learn(self) -> float:
        """Make a step of the optimiser, and return its loss.

        Raises:
            ValueError: loss or gradient are not finite, naming the step.
        """
        options = self.options
        stream = np.random.default_rng([options.seed, 3, self.done])
        replay = self.replays[int(stream.integers(len(self.replays)))]
        every = options.every[int(stream.integers(len(options.every)))]
        rollout = options.rollout[self.done % len(options.rollout)]
        times = draw_times(replay, every * rollout, stream)
        self.model.train()
        loss = self.rollout(replay, times, every, rollout)
        check_loss(loss.detach(), self.done + 1)
        self.optimizer.zero_grad()
        loss.backward()
        clip_gradients(self.model.parameters(), options.clip, self.done + 1)
        self.optimizer.step()
        self.schedule.step()
        self.done += 1
        return float(loss.detach())

    def rollout(self, replay: Replay, times: np.ndarray, every: int, steps: int) -> Any:
        """Return the mean loss of some steps of the network from recorded states, with its gradient.

        Args:
            replay: the worlds.
            times: their states, (W,).
            every: recorded steps of a step of time.
            steps: of time.
        """
        total: Any = 0.0
        for view, found, truth in self._steps(replay, times, every, steps):
            total = total + self.loss(view, found, truth)
        return total / steps

    def _steps(self, replay: Replay, times: np.ndarray, every: int, steps: int) -> Any:
        """Go through steps of the network: view, answer and recorded ways of each."""
        sim, reader = replay.sim, self.readers[id(replay)]
        replay.place(times)
        carried: Any = None
        for step in range(1, steps + 1):
            sim.collide(every * replay.dt)
            view = reader.read()
            if carried is not None:
                # what forces add is known; what is carried brings the gradient of the steps before
                view = view.going(view.way + (carried - carried.detach()))
            found = answer(self.model, view, self.grid)
            truth = torch.from_numpy(replay.velocities(times + step * every)) / view.speed
            yield view, found, truth
            if step == steps:
                return
            carried = found.way
            sim.solve(pause=0)
            sim.motion.numpy("solved")[: len(carried), :3] = (carried.detach() * view.speed).numpy()
            sim.advance()

    def loss(self, view: StepView, found: Any, truth: Any) -> Any:
        """Return the loss of an answer: half the squared error over that of no contacts at all, mean of the worlds."""
        none = errors(view, view.way.detach(), truth)[1] + FLOOR
        if self.options.loss == "grid":
            target, there = image_of(view, truth, self.grid)
            square = (there * (found.image - target).square()).sum(dim=(1, 2, 3))
            # a body reaches some nodes; as many as there are for each of them
            bodies = view.dynamic.new_zeros(len(square)).index_add(0, view.world, view.dynamic[:, 0])
            error = square * bodies / there.sum(dim=(1, 2, 3)).clamp(min=1.0)
        else:
            error = errors(view, found.way, truth)[0]
        return 0.5 * ((error + FLOOR) / none).mean()

    # ------------------------------------------------------------------ validation

    def _validate(self) -> None:
        """Measure the network on validation states, log it, and keep it if it is the best so far."""
        self.metrics = self.measure()
        self.log.add(self.done, {f"validation/{name}": value for name, value in self.metrics.items()})
        if self.best is None or self.metrics["loss"] < self.best:
            self.best = self.metrics["loss"]
            save_checkpoint(self.options.out / BEST, self.model, self.manifest())

    def measure(self) -> dict[str, float]:
        """Measure one step from states of the validation worlds.

        Returns:
            "loss", and for each time step, such as "velocity_10ms", the error of the velocities over that of no
            contacts at all: the root of the ratio of the sums of squares.
        """
        self.model.eval()
        losses, found = [], {}
        dt = float(np.mean(self.held.dt))
        with torch.no_grad():
            for every in sorted(set(self.options.every)):
                square = np.zeros(2)
                for part in range(CHECKED):
                    times = spread_times(self.held, every, (part + 0.5) / CHECKED)
                    for view, answered, truth in self._steps(self.held, times, every, 1):
                        losses.append(float(self.loss(view, answered, truth)))
                        square += [float(value.sum()) for value in errors(view, answered.way, truth)]
                found[f"velocity_{1e3 * every * dt:.3g}ms"] = float(np.sqrt(square[0] / max(square[1], 1e-30)))
        return {"loss": float(np.mean(losses)), **found}

    def _shown(self) -> dict[str, str]:
        """Return what the bar says of the last validation."""
        return {name: f"{value:.3g}" for name, value in self.metrics.items() if name != "loss"}

    # ------------------------------------------------------------------ files

    def identity(self) -> dict[str, Any]:
        """Return what decides the bits of this training."""
        return plain({**{k: v for k, v in asdict(self.options).items() if k not in FREE}, "data": self.data})

    def manifest(self) -> dict[str, Any]:
        """Return what the network's file says of it."""
        dt = sorted({float(f"{every * one:.6g}") for every in self.options.every for one in self.held.dt})
        grid = {**asdict(self.grid), "origin": [float(x) for x in self.grid.origin]}
        out = str(self.options.out)
        return plain(
            {
                "stepper": {"dt": dt, "grid": None if reads_views(self.model) else grid},
                "parameters": models.parameter_count(self.model),
                "options": {**asdict(self.options), "data": [str(path) for path in self.options.data], "out": out},
                "data": self.data,
                "step": self.done,
                "metrics": self.metrics,
                "minutes": self._seconds() / 60.0,
                "commit": self.commit,
                "versions": all_versions(),
            }
        )

    def _seconds(self) -> float:
        """Return the wall time of the training so far, with that of earlier runs [s]."""
        return self.spent + time.perf_counter() - self.began

    def _save(self) -> None:
        """Write the network and what the training continues from."""
        progress = {"steps": self.options.steps, "step": self.done, "best": self.best, "metrics": self.metrics}
        progress["spent"] = self._seconds()
        save_checkpoint(self.options.out / LAST, self.model, self.manifest())
        state = self.options.out / STATE
        save_training(state, self.model, self.optimizer, self.schedule, progress, self.identity())

    def _restore(self) -> None:
        """Continue where ``_save`` left off, to as many steps as the options ask for.

        Raises:
            ValueError: another training, one of more steps already, or the middle of a cycle of the rate that more
                steps would change.
        """
        state = self.options.out / STATE
        progress, _ = load_training(state, self.model, self.optimizer, self.schedule, self.identity())
        self.done, self.best = progress["step"], progress["best"]
        self.metrics, self.spent = progress["metrics"], progress["spent"]
        self.schedule = continued_schedule(
            self.schedule,
            self.optimizer,
            self.options.rate,
            unit="steps",
            wanted=self.options.steps,
            # a file of an earlier version does not say
            planned=progress.get("steps", self.options.steps),
            done=self.done,
            warm=WARM,
            folder=self.options.out,
        )

    def _finish(self) -> dict[str, Any]:
        """Draw the curves, write and return the summary."""
        options = self.options
        files = [name for name in (BEST, LAST, STATE) if (options.out / name).exists()]
        summary = {
            "network": self.network,
            "complete": self.done == options.steps,
            **self.manifest(),
            "out": str(options.out),
            "files": [*files, "metrics.jsonl", "train.json", "curves.png"],
        }
        title = f"{self.network}, {summary['parameters']:,} weights, {self.done} steps"
        save_figure(stepper_curves_figure(self.log.rows, title), options.out / "curves.png")
        write_json(options.out / "train.json", summary)
        return summary


def draw_times(replay: Replay, length: int, stream: np.random.Generator) -> np.ndarray:
    """Draw a state of each world, with contacts if one has ``length`` recorded steps after it, (W,)."""
    return np.array([_pick(motion, length, stream.random()) for motion in replay.motions])


def spread_times(replay: Replay, length: int, place: float) -> np.ndarray:
    """Return for each world the state at a place, 0 to 1, among those that ``draw_times`` draws from, (W,)."""
    return np.array([_pick(motion, length, place) for motion in replay.motions])


def _pick(motion: Motion, length: int, place: float) -> int:
    """Return the state at a place, in [0, 1), among those with contacts and ``length`` steps after them, or any."""
    last = motion.states - 1 - length
    busy = motion.busy[motion.busy <= last]
    return int(busy[int(place * len(busy))]) if len(busy) else int(place * (last + 1))


def describe_stepper_training(summary: dict[str, Any]) -> str:
    """Say what a training did, in a few lines."""
    metrics = summary["metrics"]
    shown = ", ".join(
        f"{name.removeprefix('velocity_')} {value:.3f}" for name, value in metrics.items() if name != "loss"
    )
    return "\n".join(
        [
            f"{summary['network']}: {summary['parameters']:,} weights, {summary['step']} steps, "
            f"{summary['minutes']:.1f} minutes" + ("" if summary["complete"] else "; interrupted, --resume goes on"),
            f"error of the velocities after a step, over that of no contacts at all: {shown}",
            f"{summary['out']}: {', '.join(summary['files'])}",
        ]
    )
