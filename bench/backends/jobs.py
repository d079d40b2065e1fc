"""What the backends are timed at: steps, stages, sweeps, splats, gathers and searches, as jobs that one engine does.

An engine is a backend with its compiler, or ``peer``: torch and SciPy where they do such a job.
"""

from __future__ import annotations

import functools
import math
import statistics
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bench import timing

ENGINES = ("warp", "taichi", "quadrants", "numpy", "peer")
BACKEND = {"warp": "warp", "taichi": "taichi", "quadrants": "taichi", "numpy": "numpy"}
UNITS = {"step": "us", "stages": "us", "sweep": "ns", "splat": "ns", "gather": "ns", "neighbors": "ns"}
WORK = 2_000_000  # contact updates between the short and the long solve of a sweep's time
REPEATS = 3  # calls of a round, where one may follow the other
SPACING, CHANNELS, NEIGHBORS = 0.25, 4, 6.0


@dataclass(frozen=True)
class Case:
    """One thing to time."""

    kind: str
    """A key of ``UNITS``."""
    what: str
    """Scene of a step (a key of ``SCENES``), else the number of points; for people."""
    threads: int = 1
    dtype: str = "float32"
    calls: int = 1
    """Steps of a timed run."""
    quick: bool = False
    """Whether the quick form has it."""
    oracle: bool = False
    """Whether the numpy backend ends within seconds, and is measured."""

    @property
    def name(self) -> str:
        """Name the case for people."""
        suffix = "" if self.dtype == "float32" else f", {self.dtype}"
        return f"{self.kind}, {self.what}{suffix}, {self.threads} thread{'s' if self.threads > 1 else ''}"

    def engines(self) -> list[str]:
        """Name the engines whose cells are to be filled."""
        found = ["warp", "taichi", "quadrants"]
        if self.oracle:
            found.append("numpy")
        if self.kind in ("splat", "gather", "neighbors") and self.threads == 1:
            found.append("peer")
        return found


SCENES = ("1 world", "64 worlds", "1000 worlds", "1000 discs", "10000 discs", "100000 discs", "1000 mixed", "pyramid")
CALLS = (300, 9, 1, 20, 2, 1, 5, 10)
QUICK_STEPS = {("1 world", 1), ("64 worlds", 1), ("64 worlds", 2), ("10000 discs", 1)}
CASES = (
    *(
        Case("step", scene, threads, calls=calls, quick=(scene, threads) in QUICK_STEPS, oracle=scene == "1 world")
        for scene, calls in zip(SCENES, CALLS, strict=True)
        for threads in ((1, 2) if scene.endswith("worlds") else (1,))
    ),
    Case("stages", "1 world", oracle=True),
    Case("stages", "64 worlds", quick=True),
    Case("stages", "64 worlds", 2),
    Case("stages", "1000 mixed"),
    Case("sweep", "1000 discs", quick=True),
    Case("sweep", "1000 discs", dtype="float64", quick=True),
    *(
        Case(kind, size, threads, quick=(size, threads) == ("100000", 1), oracle=size == "1000")
        for kind in ("splat", "gather")
        for size, threads in (("1000", 1), ("100000", 1), ("100000", 2), ("1000000", 1), ("1000000", 2))
    ),
    *(Case("neighbors", size, quick=size == "100000", oracle=size == "1000") for size in ("1000", "100000", "1000000")),
)  # fmt: skip
"""Everything that is timed, in order."""


class Job:
    """A case as an engine does it, with everything made beforehand."""

    def __init__(self, once: Callable[[], dict[str, float]], result: Callable[[], np.ndarray]) -> None:
        """Keep what to call.

        Args:
            once: does it, and returns seconds of its parts in the case's units of work, by the names of their rows.
            result: the numbers that a first call leaves, the bits of which are compared; called once, before ``once``.
        """
        self.once, self.result = once, result


def snapshot(folder: Path, what: str, dtype: str) -> Path:
    """Path of the snapshot that all engines start from."""
    return folder / f"{what.replace(' ', '_')}_{dtype}.h5"


@functools.cache
def pile() -> Any:
    """A settled thesis pile of 1 000 discs."""
    from bench import cases

    return cases.settled(1_000)


def settle(what: str) -> Any:
    """A simulation of a scene, on Warp, with its contacts at rest."""
    import dc_kernels as dc
    from bench import cases
    from pipeline import scenes

    config = dc.SolverConfig(max_sweeps=cases.SWEEPS)
    if what.endswith(("world", "worlds")):
        count = int(what.split()[0])
        sim, steps = cases.simulation(scenes.Thesis(), count, config=config), 300 if count < 1000 else 150
    elif what == "1000 discs":
        return pile()
    elif what.endswith("discs"):
        return cases.side_by_side(pile(), int(what.split()[0]) // 1_000)
    elif what == "1000 mixed":
        sim, steps = cases.simulation(scenes.Mixed(bodies=1_000), config=config), 600
    else:
        sim, steps = cases.simulation(scenes.Pyramid(rows=20), config=config), 50
    sim.run(steps, cases.DT)
    return sim


def make(case: Case, engine: str, folder: Path, dtype: str | None = None) -> Job:
    """Make the job of a case for an engine; ``dtype`` other than the case's for the reference."""
    dtype = dtype or case.dtype
    kinds: dict[str, Callable[..., Job]] = {
        "step": step,
        "stages": stages,
        "sweep": sweep,
        "splat": transfer,
        "gather": transfer,
        "neighbors": neighbors,
    }
    return kinds[case.kind](case, engine, folder, dtype)


def loaded(case: Case, engine: str, folder: Path, dtype: str) -> Any:
    """The simulation of a case's snapshot on an engine's backend."""
    import dc_kernels as dc

    path = snapshot(folder, case.what, dtype)
    return dc.Simulation.load(path, threads=case.threads, backend=BACKEND[engine])


def bodies(sim: Any) -> np.ndarray:
    """Velocities, spins and places of all bodies, one after the other."""
    return np.concatenate([sim.state.numpy(name).ravel() for name in ("velocity", "angular_velocity", "position")])


def step(case: Case, engine: str, folder: Path, dtype: str) -> Job:
    """Whole steps by ``run``."""
    from bench import cases

    sim = loaded(case, engine, folder, dtype)
    calls = 1 if engine == "numpy" else case.calls

    def once() -> dict[str, float]:
        return {f"step, {case.what}": timing.seconds(lambda: sim.run(calls, cases.DT)) / calls}

    def result() -> np.ndarray:
        sim.run(1, cases.DT)
        return bodies(sim)

    return Job(once, result)


def stages(case: Case, engine: str, folder: Path, dtype: str) -> Job:
    """A step kernel by kernel, the launches of each timed."""
    from bench import cases
    from dc_kernels.runtime.backends import host_threads
    from dc_kernels.runtime.threads import run_shards, shard_worlds
    from dc_kernels.stages import STEP

    sim = loaded(case, engine, folder, dtype)
    sim.run(1, cases.DT)  # sets the time step
    threads = host_threads(BACKEND[engine], case.threads)
    shares = shard_worlds(sim.model.world_count, threads)
    launches = {stage.kernel: [sim.bind(stage.kernel, *share) for share in shares] for stage in STEP}

    def once() -> dict[str, float]:
        return {
            f"{name}, {case.what}": timing.seconds(functools.partial(run_shards, shards, threads))
            for name, shards in launches.items()
        }

    def result() -> np.ndarray:
        once()
        return bodies(sim)

    return Job(once, result)


def sweep(case: Case, engine: str, folder: Path, dtype: str) -> Job:
    """A sweep of projected Gauss-Seidel for one contact: the difference of a long solve and a short one."""
    from bench import cases

    sim = loaded(case, engine, folder, dtype)
    sim.collide(cases.DT)
    contacts = cases.contact_count(sim)
    more = WORK // contacts
    base = replace(sim.config, acceleration="none", tolerance=0.0)
    sim.config = base
    short, long = (replace(base, max_sweeps=sweeps) for sweeps in (more // 4, more // 4 + more))

    def once() -> dict[str, float]:
        spent = [timing.seconds(functools.partial(sim.solve, config)) for config in (short, long)]
        return {f"sweep of a contact, {case.dtype}": (spent[1] - spent[0]) / (more * contacts)}

    def result() -> np.ndarray:
        sim.solve(short)
        sim.solve(long)
        return np.concatenate([sim.contacts.numpy("impulse").ravel(), bodies(sim)])

    return Job(once, result)


def seconds(call: Callable[[], Any]) -> float:
    """Median of a few calls in a row [s], the first of which finds the caches full of another engine's numbers."""
    return statistics.median(timing.seconds(call) for _ in range(REPEATS))


def cloud(count: int, dtype: str) -> tuple[Any, np.ndarray, np.ndarray]:
    """A grid with four nodes a particle, random particles, and their values."""
    from dc_kernels.grid.grid import Grid

    side = round((4.0 * count) ** 0.5)
    draw = np.random.default_rng(0)
    points = draw.uniform(0, SPACING * (side - 1), (count, 2)).astype(np.float32)
    values = draw.normal(size=(count, CHANNELS)).astype(np.float32)
    return Grid(rows=side, columns=side, spacing=SPACING), points.astype(dtype), values.astype(dtype)


def transfer(case: Case, engine: str, folder: Path, dtype: str) -> Job:
    """A splat by poly6, or a bilinear gather of an image of random numbers, of points and arrays that are bound."""
    from bench.speed.transfer import Cloud, grid_sample, index_add
    from dc_kernels.grid.splat import allocate_image
    from dc_kernels.grid.stencil import BILINEAR, POLY6
    from dc_kernels.grid.transfer import Transfer

    count = int(case.what)
    row = f"{case.kind}, {case.what} particles"
    if engine == "peer":
        import torch

        torch.set_num_threads(case.threads)
        theirs = Cloud(count)
        theirs.splat()
        call = (index_add if case.kind == "splat" else grid_sample)(theirs)
        found = (
            (lambda: call().numpy().ravel()) if case.kind == "splat" else (lambda: call().numpy()[0, :, 0].T.ravel())
        )
        return Job(lambda: {row: seconds(call) / count}, found)
    grid, points, values = cloud(count, dtype)
    image = allocate_image(1, CHANNELS, grid, dtype)
    backend = BACKEND[engine]
    if case.kind == "splat":
        call = Transfer(grid, POLY6, threads=case.threads, backend=backend).at(points).splat(values, image)
        filled = image
    else:
        Transfer(grid, POLY6).splat(points, values, out=image)  # by Warp for all engines
        filled = np.zeros_like(values)
        call = Transfer(grid, BILINEAR, threads=case.threads, backend=backend).at(points).gather(image, filled)

    def result() -> np.ndarray:
        call()
        return np.asarray(filled).ravel().copy()

    return Job(lambda: {row: seconds(call) / count}, result)


def neighbors(case: Case, engine: str, folder: Path, dtype: str) -> Job:
    """All pairs within a radius in which a point has six others."""
    from scipy.spatial import cKDTree

    from dc_kernels.neighbors.search import neighbor_pairs

    count = int(case.what)
    points = np.random.default_rng(count).random((count, 2), np.float32).astype(dtype)
    radius = math.sqrt(NEIGHBORS / count / math.pi)

    def call() -> np.ndarray:
        if engine == "peer":
            return cKDTree(points).query_pairs(radius, output_type="ndarray")
        return neighbor_pairs(points, radius, backend=BACKEND[engine])

    row = f"neighbors, {case.what} points"
    return Job(lambda: {row: seconds(call) / count}, lambda: call().ravel())
