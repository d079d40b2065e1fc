"""Data sets in batch (``deep-contact generate``): worlds simulated on all cores, every state solved on to a label.

Worlds of consecutive seeds make a shard; a shard depends on the recipe alone, so it may be computed anywhere, in any
order, and again. On one machine shards run on threads, as launches and compression release the GIL; with the address
of a Dask scheduler the same function runs on its workers, which send the shard back: only this process writes.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, ThreadPoolExecutor, wait
from pathlib import Path
from typing import Any

from dc_kernels.model.enums import flag_names
from dc_kernels.runtime.imports import require
from dc_kernels.runtime.inputs import check_whole
from pipeline.data.index import check_index, write_index
from pipeline.data.layout import INDEX, shard_path
from pipeline.data.packing import check_compression, one_by_one
from pipeline.data.recipe import Recipe
from pipeline.data.recorder import Halt, check_scene, make_shard
from pipeline.data.shards import check_shard, opened, remove_partial
from pipeline.files import sole_writer, write_bytes
from pipeline.process import Stop, cores, interruptible, progress_bar

TICK = 0.2
"""Time between two looks at what is finished [s]."""
CONNECT = 10
"""Time after which a scheduler counts as not there [s]."""


def finished_shards(recipe: Recipe, folder: Path) -> list[int]:
    """Return the numbers of the shards that are there, each of them checked.

    One that holds fewer worlds than it is to, as the data set has grown since, is not among them: it is made again.

    Raises:
        ValueError: for a damaged or foreign one, one of another recipe, or worlds that the recipe has not.
    """
    options, found = recipe.options, []
    for path in sorted(folder.glob("shard-*.h5")):
        number = path.stem.removeprefix("shard-")
        if not number.isdecimal() or path != shard_path(folder, int(number)):
            raise ValueError(f"{path} is no shard's name; take it out of the folder")
        first, wanted = options.seed + int(number) * options.shard_worlds, len(options.seeds(int(number)))
        worlds = check_shard(path, recipe.config(), first, options.shard_worlds)
        if worlds > wanted:
            raise ValueError(
                f"{path} holds worlds up to seed {first + worlds - 1}, but worlds is {options.worlds}: a data set may "
                "grow, not shrink"
            )
        if worlds == wanted:
            found.append(int(number))
    return found


class Progress:
    """Shows the worlds done in a bar: those of whole shards, and the shares of those in the making."""

    def __init__(self, recipe: Recipe, bar: Any, done: int) -> None:
        """Begin with so many worlds done."""
        self.options, self.bar, self.done = recipe.options, bar, done
        self.steps: dict[int, int] = {}
        self.begun = False
        bar.update(done)
        bar.initial = done  # worlds per second are those of this run
        bar.set_postfix_str("loading kernels; new ones are compiled first, which may take a minute")

    def of(self, number: int) -> Callable[[int], None]:
        """Return what notes the steps done of a shard, which any thread may call."""
        return functools.partial(self.steps.__setitem__, number)

    def finish(self, number: int) -> None:
        """Count a whole shard."""
        self.steps.pop(number, None)
        self.done += len(self.options.seeds(number))
        self.show()

    def show(self) -> None:
        """Bring the bar up to date."""
        if not self.begun and (self.steps or self.bar.n < self.done):
            self.begun = True
            self.bar.set_postfix_str("")
        share = sum(n * len(self.options.seeds(i)) for i, n in list(self.steps.items())) / self.options.steps
        self.bar.update(max(self.done + int(share) - self.bar.n, 0))


Image = bytes | memoryview


def on_threads(
    threads: int, recipe: Recipe, numbers: Sequence[int], stop: Stop, progress: Progress, compression: str
) -> Iterator[tuple[int, Image]]:
    """Make shards on threads of this process; each comes as soon as it is made, until ``stop``.

    Threads that have no shard to make compress the chunks of others.
    """
    halt = Halt()
    left: list[int] = list(reversed(numbers))
    running: dict[Any, int] = {}
    with ThreadPoolExecutor(threads) as pool:

        def spread(work: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
            return _shared(pool, work, items) if len(running) < threads and not left else one_by_one(work, items)

        try:
            while (left or running) and not stop.is_set():
                while left and len(running) <= threads:  # one waits, so that no thread does while a shard is written
                    number = left.pop()
                    future = pool.submit(
                        make_shard, recipe, number, progress.of(number), halt, compression=compression, spread=spread
                    )
                    running[future] = number
                for future in wait(running, TICK, FIRST_COMPLETED).done:
                    number = running.pop(future)
                    yield number, future.result()
                    progress.finish(number)
                progress.show()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
            halt.hurry()
            begun = [future for future in running if not future.cancelled()]
            while wait(begun, TICK).not_done:
                halt.hurry()  # a shard may have begun another solve


def _shared(pool: ThreadPoolExecutor, work: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
    """Call a function for each of some arguments, on the threads of a pool from the first on, on this one from the end.

    This thread takes whatever no other has begun, so it never waits for one that is at something else.
    """
    futures = [pool.submit(work, item) for item in items]
    own = {i: work(items[i]) for i in reversed(range(len(items))) if futures[i].cancel()}
    return [own[i] if i in own else future.result() for i, future in enumerate(futures)]


def on_cluster(
    address: str, recipe: Recipe, numbers: Sequence[int], stop: Stop, progress: Progress, compression: str
) -> Iterator[tuple[int, Image]]:
    """Make shards on the workers of a Dask scheduler; a worker that dies costs what it was at, which others repeat.

    Raises:
        OSError: when the scheduler is not there, or a shard cannot be had from it.
    """
    distributed = require("distributed", "cluster")
    with distributed.Client(address, timeout=CONNECT, set_as_default=False) as client:
        running = {client.submit(_on_worker, recipe, n, compression, pure=False): n for n in numbers}
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


def _on_worker(recipe: Recipe, number: int, compression: str) -> bytes:
    """Make a shard on a worker of Dask, as bytes that can be sent."""
    return bytes(make_shard(recipe, number, compression=compression))


def generate(
    recipe: Recipe,
    out: Path | str,
    threads: int = 0,
    scheduler: str | None = None,
    progress: bool = True,
    compression: str = "zstd",
) -> dict[str, Any]:
    """Make a data set, or go on with one that was cut short: whole shards are checked and kept, the others made.

    A data set grows with more worlds in the recipe; its index shows the old ones until all new ones are there. Ctrl-C
    ends it early; what is finished stays.

    Args:
        recipe: what it holds.
        out: its folder, made if missing.
        threads: shards made at once; 0: as many as there are cores.
        scheduler: address of a Dask scheduler, tcp://..., whose workers make the shards instead.
        progress: show a bar on stderr.
        compression: of the shards that are made, "zstd" or "gzip"; those that are there stay as they are, as it is no
            part of what a data set holds.

    Returns:
        What was made and what it took.

    Raises:
        ValueError: for a recipe out of its range, a scene that cannot be built or has joints, another recipe than that
            of the shards that are there, or a foreign index or a damaged or foreign shard, which is left as it is.
        OSError: when a file cannot be written, another process is writing into the folder, or the scheduler is not
            there or lost.
        ImportError: naming the extra, without h5py, tqdm, zstandard or distributed.
    """
    threads, compression = check_whole("threads", threads), check_compression(compression)
    out = Path(out)
    options, began = recipe.options, time.perf_counter()
    check_scene(recipe)
    with sole_writer(out) as alone:
        if alone:
            remove_partial(out)
        check_index(out)
        kept = finished_shards(recipe, out)
        missing = [number for number in range(options.shard_count) if number not in kept]
        made = 0
        with (
            interruptible() as stop,
            progress_bar(
                total=options.worlds, desc=f"generate {recipe.scene.name}", unit="world", show=progress
            ) as bar,
        ):
            state = Progress(recipe, bar, sum(len(options.seeds(number)) for number in kept))
            source = (
                on_cluster(scheduler, recipe, missing, stop, state, compression)
                if scheduler
                else on_threads(threads or cores(), recipe, missing, stop, state, compression)
            )
            for number, image in source:
                write_bytes(shard_path(out, number), image)
                missing.remove(number)
                made += len(options.seeds(number))
            if not missing:  # an interrupt from now on comes too late
                write_index(out, [shard_path(out, number) for number in range(options.shard_count)])
    return _summary(recipe, out, len(kept), made, not missing, time.perf_counter() - began)


def _summary(recipe: Recipe, out: Path, kept: int, made: int, complete: bool, seconds: float) -> dict[str, Any]:
    """Say what there is: shards kept and worlds made in so many seconds, and whether that is all."""
    options = recipe.options
    paths = [shard_path(out, number) for number in range(options.shard_count)]
    files = [path for path in (*paths, out / INDEX) if path.exists()]
    summary: dict[str, Any] = {
        "scene": recipe.scene.name,
        "complete": complete,
        "worlds": options.worlds,
        "worlds_made": made,
        "seconds": seconds,
        "worlds_per_s": made / seconds,
        "shards": len(paths),
        "shards_kept": kept,
        "bytes": sum(path.stat().st_size for path in files),
        "out": str(out),
        "config": recipe.config(),
    }
    if complete:
        with opened(out / INDEX) as file:
            summary["states"] = int(file["step/step"].shape[0])
            summary["contacts_mean"] = float(file["contact/gap"].shape[0] / summary["states"])
            summary["bytes_per_state"] = summary["bytes"] / summary["states"]
            summary["label_reached"] = float(file.attrs["label_reached"])
            summary["flags"] = flag_names(file.attrs["flags"])
    return summary


def describe(summary: dict[str, Any]) -> str:
    """Say what ``generate`` did, in a few lines."""
    lines = [
        f"{summary['scene']}: {summary['worlds_made']} of {summary['worlds']} worlds made in "
        f"{summary['seconds']:.1f} s, {summary['worlds_per_s']:.1f} a second; "
        f"{summary['shards_kept']} of {summary['shards']} shards existed before"
    ]
    if not summary["complete"]:
        return "\n".join([*lines, f"{summary['out']}: interrupted; the same command goes on"])
    lines.append(
        f"{summary['states']} states, {summary['contacts_mean']:.1f} contacts each; "
        f"{100.0 * summary['label_reached']:.1f} % of the labels reached their tolerance"
    )
    if summary["flags"]:
        lines.append(f"worlds stopped ({summary['flags']}); step/flags marks their states")
    lines.append(
        f"{summary['out']}: {summary['bytes'] / 1e6:.1f} MB, {summary['bytes_per_state']:.0f} bytes a state; "
        f"{INDEX} shows all shards as one"
    )
    return "\n".join(lines)
