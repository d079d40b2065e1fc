"""Data sets in batch (``deep-contact generate``): worlds simulated on all cores, every state solved on to a label.

Worlds of consecutive seeds make a shard; a shard depends on the recipe alone, so it may be computed anywhere, in any
order, and again. On one machine shards run on threads, as launches and compression release the GIL; with the address
of a Dask scheduler the same function runs on its workers, which send the shard back: only this process writes. What a
shard looks like is described in ``shards``.
"""

from __future__ import annotations

import functools
import itertools
import json
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, ThreadPoolExecutor, wait
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import dc_kernels as dc
from dc_kernels.runtime.optional import require
from pipeline.data import shards
from pipeline.data.recipe import Recipe
from pipeline.data.shards import Column
from pipeline.files import write_bytes
from pipeline.process import cores, interruptible, progress_bar

TICK = 0.2  # between two looks at what is finished [s]
CONNECT = 10  # after which a scheduler counts as not there [s]


# ---------------------------------------------------------------------- one shard


class Stopped(Exception):
    """A shard was given up because the run is to end."""


def make_shard(
    recipe: Recipe, number: int, progress: Callable[[int], None] | None = None, stop: threading.Event | None = None
) -> Image:
    """Simulate the worlds of a shard and give its file's bytes.

    Args:
        recipe: of the data set.
        number: of the shard.
        progress: called with the steps done after each.
        stop: ends the shard early, by ``Stopped``.

    Raises:
        ValueError: for a scene that cannot be built, or has joints.
    """
    seeds = recipe.options.seeds(number)
    builder, drawn, dt = _build(recipe, seeds)
    recorder = Recorder(recipe, builder)
    for step in range(recipe.options.steps):
        if stop is not None and stop.is_set():
            raise Stopped
        recorder.step(dt)
        if progress is not None:
            progress(step + 1)
    own = {"world/seed": np.array(seeds), "world/dt": dt}
    own |= {f"drawn/{name}": np.array([world[name] for world in drawn]) for name in drawn[0]}
    extra = {f"drawn/{name}": _drawn_column(recipe, name) for name in drawn[0]}
    attributes = {
        "config": json.dumps(recipe.config()),
        "seed": seeds[0],
        "worlds": len(seeds),
        "steps": recipe.options.steps,
        "flags": recorder.flags,
        "label_reached": recorder.label_reached / (len(seeds) * recipe.options.steps),
    }
    return shards.shard_image(itertools.chain(own.items(), recorder.arrays()), {**extra, **recorder.extra}, attributes)


def _drawn_column(recipe: Recipe, name: str) -> Column:
    dtype = np.dtype(np.int64 if recipe.is_whole(name) else np.float64)
    return Column(dtype, "SI", f"{'time step' if name == 'dt' else f'scene.{name}'} of the world, drawn from its seed")


def _build(recipe: Recipe, seeds: Sequence[int]) -> tuple[dc.ModelBuilder, list[dict[str, float | int]], np.ndarray]:
    """The worlds of some consecutive seeds, what was drawn for each, and their time steps."""
    drawn = [recipe.draw(seed) for seed in seeds]
    dt = np.array([world.get("dt", recipe.options.dt) for world in drawn], np.float32)
    if {name for name, _, _ in recipe.options.ranges} <= {"dt"}:
        return recipe.scene.build(len(seeds), seeds[0]), drawn, dt
    builder = dc.ModelBuilder()
    for seed, world in zip(seeds, drawn):
        own = replace(recipe.scene, **{name: value for name, value in world.items() if name != "dt"})
        own.check()
        own.add_worlds(builder, [np.random.Generator(np.random.PCG64(seed))])
    return builder, drawn, dt


class Recorder:
    """Steps a simulation and keeps every state, its solution and its label."""

    def __init__(self, recipe: Recipe, builder: dc.ModelBuilder) -> None:
        """The worlds at their start.

        Raises:
            ValueError: where there are joints.
        """
        model, state, joints = builder.finalize("float32")
        if model.joint_count:
            raise ValueError(f"scene {recipe.scene.name} has joints, whose impulses a data set does not hold")
        self.sim = sim = dc.Simulation(model, state, joints, config=recipe.solver)
        self.recipe = recipe
        self.label_config = recipe.label_config
        self.measure = "change" if recipe.solver.stop == "change" else "residual"
        self.flags = self.label_reached = 0
        self.kept: dict[str, list[np.ndarray]] = {}
        self.images: dc.Images | None = None
        self.extra: dict[str, Column] = {}
        if recipe.options.grids:
            self.images = dc.Images(sim, recipe.options.grid)
            channels = "mass, velocity_x, velocity_y, omega, normal_x, normal_y; walls as 100 kg"
            shape = recipe.options.grid.shape
            self.extra = {
                "grid/input": Column(np.dtype(np.float32), "SI", channels, (len(self.images.channels), *shape)),
                "grid/label": Column(np.dtype(np.float32), "N s", "normal and tangential impulse", (2, *shape)),
            }

    def step(self, dt: np.ndarray) -> None:
        """One step of dt [s] in each world, (worlds,)."""
        sim = self.sim
        sim.collide(dt)
        contacts = sim.contacts
        for name in shards.LAYOUT["motion"]:
            self._keep(f"motion/{name}", sim.state.numpy(name).copy())
        live = sim.state.numpy("flags") == 0  # others keep the contacts of the step in which they stopped
        count = np.where(live, contacts.numpy("contact_count"), 0).astype(np.int64)
        world = np.repeat(np.arange(len(count)), count)
        slots = np.arange(len(world)) + (contacts.numpy("contact_start")[:-1] - (np.cumsum(count) - count)).take(world)
        self._keep("count", count)
        for name in ("key", "normal", "gap", "friction", "restitution", "age"):
            self._keep(f"contact/{name}", contacts.numpy(name).take(slots, 0))
        self._keep("contact/color", contacts.numpy("color").take(slots).astype(np.uint8))
        body, first = contacts.numpy("body_a").take(slots), sim.model.numpy("body_start").take(world)
        self._keep("contact/body_a", body - first)
        self._keep("contact/body_b", contacts.numpy("body_b").take(slots) - first)
        self._keep("contact/point", sim.state.numpy("position").take(body, 0) + contacts.numpy("arm_a").take(slots, 0))
        impulse, solved = contacts.numpy("impulse"), sim.motion.numpy("solved")
        stages = np.empty((len(shards.STAGES), len(slots), 2), np.float32)
        impulse.take(slots, 0, stages[0])
        if self.images is not None:
            self._keep("grid/input", dc.to_numpy(self.images.splat()).copy())
        sim.solve()
        impulse.take(slots, 0, stages[1])
        self._note("")
        stages[2] = self._label(impulse, solved, slots)
        self._keep("contact/impulse", stages)
        sim.advance()
        flags = sim.state.numpy("flags").copy()
        self._keep("step/flags", flags)
        self.flags |= int(np.bitwise_or.reduce(flags))

    def _label(self, impulse: np.ndarray, solved: np.ndarray, slots: np.ndarray) -> np.ndarray:
        """Solve on to the label, then put back what the step goes on from."""
        before = impulse.copy(), solved.copy()
        self.sim.solve(self.label_config)
        self._note("label_")
        reached = self.sim.stats.numpy(self.measure) <= self.label_config.tolerance
        self._keep("step/label_reached", reached)
        self.label_reached += int(reached.sum())
        label = impulse.take(slots, 0)
        if self.images is not None:
            self._keep("grid/label", dc.to_numpy(self.images.impulse_image()).copy())
        impulse[...], solved[...] = before
        return label

    def _note(self, prefix: str) -> None:
        for name in ("sweeps", "change", "residual"):
            self._keep(f"step/{prefix}{name}", self.sim.stats.numpy(name).copy())

    def _keep(self, name: str, values: np.ndarray) -> None:
        self.kept.setdefault(name, []).append(values)

    def arrays(self) -> Iterator[tuple[str, np.ndarray]]:
        """All datasets but seeds and time steps, path and values; what was kept is given up one by one."""
        model, kept = self.sim.model, self.kept
        worlds, steps = model.world_count, self.recipe.options.steps
        body_start, shape_start = (model.numpy(name).astype(np.int64) for name in ("body_start", "shape_start"))
        bodies = np.diff(body_start)
        count = np.stack(kept.pop("count"))  # (steps, worlds)
        edges = np.concatenate([np.zeros((steps, 1), np.int64), np.cumsum(count, axis=1)], axis=1).tolist()
        fixed = {
            **{f"world/{name}": model.numpy(name) for name in ("gravity", "origin", "length_scale")},
            "world/body_start": body_start,
            "world/shape_start": shape_start,
            "world/step_start": np.arange(worlds + 1) * steps,
            **{f"body/{name}": model.numpy(name) for name in shards.LAYOUT["body"]},
            **{f"shape/{name}": model.numpy(name) for name in shards.LAYOUT["shape"] if name.startswith("shape_")},
            "shape/shape_body": model.numpy("shape_body") - np.repeat(body_start[:-1], np.diff(shape_start)),
            "shape/vertex_start": model.numpy("vertex_start"),
            "vertex/vertices": model.numpy("vertices"),
            "step/step": np.tile(np.arange(steps), worlds),
            "step/motion_start": _offsets(np.repeat(bodies, steps)),
            "step/contact_start": _offsets(count.T.ravel()),
        }
        yield from fixed.items()
        for name in list(kept):
            parts, axis = kept.pop(name), name.split("/")[0]
            if axis == "contact":
                lead = len(shards.LAYOUT[axis][name.split("/")[1]].lead)
                before = (slice(None),) * lead
                rows = (
                    part[(*before, slice(edge[w], edge[w + 1]))]
                    for w in range(worlds)
                    for part, edge in zip(parts, edges)
                )
                yield name, np.concatenate(list(rows), lead)
                continue
            whole = np.stack(parts)  # (steps, ...)
            if axis == "motion":
                own = [whole[:, a:b] for a, b in itertools.pairwise(body_start)]
                yield name, np.concatenate([part.reshape(-1, *whole.shape[2:]) for part in own])
            else:
                yield name, whole.swapaxes(0, 1).reshape(-1, *whole.shape[2:])


def _offsets(sizes: np.ndarray) -> np.ndarray:
    return np.concatenate([[0], np.cumsum(sizes)])


# ---------------------------------------------------------------------- all shards


def finished_shards(recipe: Recipe, folder: Path) -> list[int]:
    """Numbers of the shards that are there, each of them checked.

    Raises:
        ValueError: for a damaged or foreign one, or one of another recipe.
    """
    found = []
    for path in sorted(folder.glob("shard-*.h5")):
        number = path.stem.removeprefix("shard-")
        if not number.isdecimal() or path != shards.shard_path(folder, int(number)):
            raise ValueError(f"{path} is no shard's name; take it out of the folder")
        seeds = recipe.options.seeds(int(number))
        shards.check_shard(path, recipe.config(), seeds.start, len(seeds))
        found.append(int(number))
    return found


class Progress:
    """Worlds done, in a bar: whole shards, and the shares of those in the making."""

    def __init__(self, recipe: Recipe, bar: Any, done: int) -> None:
        """Begin with so many worlds done."""
        self.options, self.bar, self.done = recipe.options, bar, done
        self.steps: dict[int, int] = {}
        bar.update(done)
        bar.initial = done  # worlds per second are those of this run

    def of(self, number: int) -> Callable[[int], None]:
        """What notes the steps done of a shard; any thread may call it."""
        return functools.partial(self.steps.__setitem__, number)

    def finish(self, number: int) -> None:
        """Count a whole shard."""
        self.steps.pop(number, None)
        self.done += len(self.options.seeds(number))
        self.show()

    def show(self) -> None:
        """Bring the bar up to date."""
        share = sum(n * len(self.options.seeds(i)) for i, n in list(self.steps.items())) / self.options.steps
        self.bar.update(max(self.done + int(share) - self.bar.n, 0))


Image = bytes | memoryview


def on_threads(
    threads: int, recipe: Recipe, numbers: Sequence[int], stop: threading.Event, progress: Progress
) -> Iterator[tuple[int, Image]]:
    """Make shards on threads of this process; each comes as soon as it is made, until ``stop``."""
    halt = threading.Event()
    left: list[int] = list(reversed(numbers))
    running: dict[Any, int] = {}
    with ThreadPoolExecutor(threads) as pool:
        try:
            while (left or running) and not stop.is_set():
                while left and len(running) <= threads:  # one waits, so that no thread does while a shard is written
                    number = left.pop()
                    running[pool.submit(make_shard, recipe, number, progress.of(number), halt)] = number
                for future in wait(running, TICK, FIRST_COMPLETED).done:
                    number = running.pop(future)
                    yield number, future.result()
                    progress.finish(number)
                progress.show()
        finally:
            halt.set()
            pool.shutdown(cancel_futures=True)


def on_cluster(
    address: str, recipe: Recipe, numbers: Sequence[int], stop: threading.Event, progress: Progress
) -> Iterator[tuple[int, Image]]:
    """Make shards on the workers of a Dask scheduler; a worker that dies costs what it was at, which others repeat.

    Raises:
        OSError: when the scheduler is not there, or a shard cannot be had from it.
    """
    distributed = require("distributed", "cluster")
    with distributed.Client(address, timeout=CONNECT, set_as_default=False) as client:
        running = {client.submit(_on_worker, recipe, n, pure=False): n for n in numbers}
        while running and not stop.is_set():
            done = [future for future in running if future.done()]
            for future in done:
                number = running.pop(future)
                try:
                    image = future.result()
                except (CancelledError, distributed.KilledWorker, OSError) as error:
                    raise OSError(f"scheduler {address} lost shard {number}: {error}; run again to go on") from error
                yield number, image
                progress.finish(number)
                future.release()
            if not done:
                time.sleep(TICK)


def _on_worker(recipe: Recipe, number: int) -> bytes:
    return bytes(make_shard(recipe, number))


def generate(
    recipe: Recipe, out: Path, threads: int = 0, scheduler: str | None = None, progress: bool = True
) -> dict[str, Any]:
    """Make a data set, or go on with one that was cut short: whole shards are checked and kept, the others made.

    Ctrl-C ends it early; what is finished stays.

    Args:
        recipe: what it holds.
        out: its folder, made if missing.
        threads: shards made at once; 0: as many as there are cores.
        scheduler: address of a Dask scheduler, tcp://..., whose workers make the shards instead.
        progress: show a bar on stderr.

    Returns:
        What was made and what it took.

    Raises:
        ValueError: for a recipe out of its range, another one than that of the shards that are there, or a damaged or
            foreign shard, which is left as it is.
        OSError: when a file cannot be written, or the scheduler is not there or lost.
        ImportError: naming the extra, without h5py, tqdm or distributed.
    """
    recipe.check()
    if threads < 0:
        raise ValueError(f"threads is {threads}; it must be >= 0")
    options, began = recipe.options, time.perf_counter()
    out.mkdir(parents=True, exist_ok=True)
    shards.remove_partial(out)
    kept = finished_shards(recipe, out)
    missing = [number for number in range(options.shard_count) if number not in kept]
    made = 0
    with (
        interruptible() as stop,
        progress_bar(total=options.worlds, desc=f"generate {recipe.scene.name}", unit="world", show=progress) as bar,
    ):
        state = Progress(recipe, bar, sum(len(options.seeds(number)) for number in kept))
        source = (
            on_cluster(scheduler, recipe, missing, stop, state)
            if scheduler
            else on_threads(threads or cores(), recipe, missing, stop, state)
        )
        for number, image in source:
            write_bytes(shards.shard_path(out, number), image)
            made += len(options.seeds(number))
    paths = [shards.shard_path(out, number) for number in range(options.shard_count)]
    complete = all(path.exists() for path in paths)
    if complete:
        shards.write_index(out, paths)
    seconds = time.perf_counter() - began
    files = [path for path in (*paths, out / shards.INDEX) if path.exists()]
    summary: dict[str, Any] = {
        "scene": recipe.scene.name,
        "complete": complete,
        "worlds": options.worlds,
        "worlds_made": made,
        "seconds": seconds,
        "worlds_per_s": made / seconds,
        "shards": len(paths),
        "shards_kept": len(kept),
        "bytes": sum(path.stat().st_size for path in files),
        "out": str(out),
        "config": recipe.config(),
    }
    if complete:
        with shards.opened(out / shards.INDEX) as file:
            summary["states"] = int(file["step/step"].shape[0])
            summary["contacts_mean"] = float(file["contact/gap"].shape[0] / summary["states"])
            summary["bytes_per_state"] = summary["bytes"] / summary["states"]
            summary["label_reached"] = float(file.attrs["label_reached"])
            summary["flags"] = int(file.attrs["flags"])
    return summary


def describe(summary: dict[str, Any]) -> str:
    """Say what ``generate`` did, in a few lines."""
    lines = [
        f"{summary['scene']}: {summary['worlds_made']} of {summary['worlds']} worlds made in "
        f"{summary['seconds']:.1f} s, {summary['worlds_per_s']:.1f} a second; "
        f"{summary['shards_kept']} of {summary['shards']} shards were there"
    ]
    if not summary["complete"]:
        return "\n".join([*lines, f"{summary['out']}: interrupted; the same command goes on"])
    lines.append(
        f"{summary['states']} states, {summary['contacts_mean']:.1f} contacts each; "
        f"{100.0 * summary['label_reached']:.1f} % of the labels reached their tolerance"
    )
    if summary["flags"]:
        names = ", ".join(str(flag.name) for flag in dc.Flag if flag & summary["flags"])
        lines.append(f"worlds stopped ({names}); step/flags marks their states")
    lines.append(
        f"{summary['out']}: {summary['bytes'] / 1e6:.1f} MB, {summary['bytes_per_state']:.0f} bytes a state; "
        f"{shards.INDEX} shows all shards as one"
    )
    return "\n".join(lines)
