"""What must not matter: side, direction and numbering; threads, runs, schedule, backend and dtype; a break in a run."""

from __future__ import annotations

import hashlib
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import dc_kernels as dc
from bench.cases import DT, contact_count, dynamic_count, settled, side_by_side
from bench.stability import fuzz as stability_fuzz
from bench.stability.input import DTYPES, STATE, pile, state_bits
from bench.verdicts import Cases, Check
from dc_kernels.model.shapes import edge_normals
from pipeline import scenes

cases = Cases()
EXACT = dc.SolverConfig(tolerance=1e-12, max_sweeps=20_000)
HORIZON = 10  # steps from contact on, in which round-off has not grown yet


def begun(name: str, dtype: str, steps: int = 120, bodies: int = 20, config: dc.SolverConfig | None = None) -> Any:
    """Builder and state of a scene in which bodies have met: positions and velocities after some steps."""
    builder = scenes.scene(name, bodies=bodies).build()
    sim = dc.Simulation(*builder.finalize(dtype), config=config)
    sim.run(steps, DT)
    return builder, {field: sim.state.numpy(field).copy() for field in STATE}


def with_state(builder: dc.ModelBuilder, dtype: str, state: dict[str, Any], **options: Any) -> dc.Simulation:
    """A simulation that begins from a state, without cached impulses."""
    sim = dc.Simulation(*builder.finalize(dtype), **options)
    for name, values in state.items():
        sim.state.assign(name, values.astype(sim.dtype))
    return sim


def mirror(sim: dc.Simulation) -> dc.Simulation:
    """The mirror image at x = 0 of a scene without steps: numbers stay, vertices run the other way round."""
    model, state = sim.model.copy(), sim.state.copy()
    flip = np.array((-1.0, 1.0), sim.dtype)
    for group, name in ((model, "gravity"), (model, "shape_center"), (model, "center_of_mass")):
        group.assign(name, group.numpy(name) * flip)
    for name in ("position", "velocity"):
        state.assign(name, state.numpy(name) * flip)
    for name in ("angle", "angular_velocity"):
        state.assign(name, -state.numpy(name))
    vertices, normals = model.numpy("vertices").copy(), model.numpy("vertex_normals").copy()
    starts, kinds = model.numpy("vertex_start"), model.numpy("shape_type")
    for shape, kind in enumerate(kinds):
        first, last = starts[shape : shape + 2]
        if kind == dc.ShapeType.SEGMENT:  # ends and neighbours change places
            vertices[first:last] = vertices[first:last][[1, 0, 3, 2]] * flip
            normals[first : first + 2] = edge_normals(vertices[first : first + 2])
        else:
            vertices[first:last] = (vertices[first:last] * flip)[::-1]
            normals[first:last] = edge_normals(vertices[first:last])
    model.assign("vertices", vertices)
    model.assign("vertex_normals", normals)
    return dc.Simulation(model, state, sim.joints, config=sim.config)


@cases.add
def mirrored(quick: bool) -> Iterator[Check]:
    """A mirrored scene moves as the mirror image does.

    Discs bit for bit (no sum changes its order); polygons start at another vertex, so contacts have another order, and
    agree to round-off while it has not grown: 10 steps, solved to 1e-12 in float64, from 0.6 s on, as they begin to
    pile up: in a pile an impact of corners can multiply it a millionfold (1.2e-6 m, from 1 s on).
    """
    for dtype in DTYPES:
        builder, state = begun("thesis", dtype, steps=80, bodies=50)
        sims = [with_state(builder, dtype, state) for _ in range(2)]
        sims[1] = mirror(sims[1])
        for sim in sims:
            sim.run(50 if quick else 170, DT)
        flip = np.array((-1.0, 1.0), sims[0].dtype)
        differ = (sims[0].state.numpy("position") != sims[1].state.numpy("position") * flip).sum()
        differ += (sims[0].state.numpy("angle") != -sims[1].state.numpy("angle")).sum()
        yield Check(f"50 discs, {dtype}: numbers that are not the mirrored ones [1]", int(differ), 0.0, sims[1])
    builder, state = begun("mixed", "float64", steps=60, config=EXACT)
    sims = [with_state(builder, "float64", state, config=EXACT) for _ in range(2)]
    sims[1] = mirror(sims[1])
    for sim in sims:
        sim.run(HORIZON, DT)
    off = np.abs(sims[0].state.numpy("position") - sims[1].state.numpy("position") * (-1.0, 1.0)).max()
    yield Check(f"20 mixed bodies, float64: positions off after {HORIZON} steps [m]", off, 1e-9, sims[1])


@cases.add
def rotated(quick: bool) -> Iterator[Check]:
    """A scene turned with its gravity by any angle moves as the turned scene does: 10 steps, 1e-12, float64."""
    for name in ("thesis", "mixed"):
        builder, state = begun(name, "float64", config=EXACT)
        base = with_state(builder, "float64", state, config=EXACT)
        base.run(HORIZON, DT)
        for angle in (1.0,) if quick else (1.0, 0.5 * np.pi, np.pi, 4.0, -0.1):
            c, s = np.cos(angle), np.sin(angle)
            turn = np.array(((c, -s), (s, c)))
            turned = {n: v @ turn.T if v.ndim == 2 else v for n, v in state.items()}
            turned["angle"] = state["angle"] + angle
            sim = with_state(builder, "float64", turned, config=EXACT)
            sim.model.assign("gravity", sim.model.numpy("gravity") @ turn.T)
            sim.run(HORIZON, DT)
            off = np.abs(sim.state.numpy("position") @ turn - base.state.numpy("position")).max()
            yield Check(f"20 bodies, {name}, turned by {angle:.3g} rad: positions off [m]", off, 1e-9, sim)


@cases.add
def permuted(quick: bool) -> Iterator[Check]:
    """Bodies numbered otherwise: rows come in another order, velocities are the same to the tolerance, 1e-12.

    (Impulses are not: piles are hyperstatic.) Of two faces that are parallel to 5 % of the slop, 2.5e-5 of a size, the
    first body's is the reference; position correction is three Gauss-Seidel sweeps, so what it leaves of overlaps
    depends on their order. Both limits are in the README.
    """
    for kinds, correction, limit in (("discs", "none", 1e-9), ("mixed", "none", 1e-4), ("mixed", "ngs", 2e-3)):
        config = replace(EXACT, position_correction=correction)  # type: ignore[arg-type]
        worst, shown, seeds = 0.0, None, 2 if quick else 24
        for seed in range(seeds):
            order = np.random.default_rng(seed).permutation(16)
            start = numbered(seed, kinds, np.arange(16), EXACT)
            start.run(60, DT)
            sims = []
            for ranks in (np.arange(16), order):
                sim = numbered(seed, kinds, ranks, config)
                for name in STATE:
                    values = start.state.numpy(name)
                    sim.state.assign(name, np.concatenate([values[:1], values[1:][ranks]]))
                sim.run(HORIZON, DT)
                sims.append(sim)
            position = [sim.state.numpy("position")[1:] for sim in sims]
            off = float(np.abs(position[0][order] - position[1]).max())
            worst, shown = max(worst, off), sims[1]
        what = f"16 {kinds}, {seeds} numberings, correction {correction}"
        yield Check(f"{what}: positions off after {HORIZON} steps [m]", worst, limit, shown)


def numbered(seed: int, kinds: str, order: Any, config: dc.SolverConfig) -> dc.Simulation:
    """Discs, or bodies of all kinds, of some 0.7 m above a box, added in an order."""
    draw = np.random.default_rng(seed)
    names = ("disc",) if kinds == "discs" else stability_fuzz.KINDS
    bodies = [
        stability_fuzz.Body(
            names[i % len(names)], dc.BodyType.DYNAMIC, draw.uniform(0.25, 0.45), 3 + i % 6, 1.0,
            (-1.5 + i % 4, 0.6 + i // 4), draw.uniform(-3.0, 3.0), (0.0, 0.0), 0.0, 0.5, 0.0,
        )
        for i in range(16)
    ]  # fmt: skip
    builder = dc.ModelBuilder()
    builder.add_world(length_scale=0.7)
    ground = builder.add_body(type=dc.BodyType.STATIC)
    builder.add_chain(ground, ((-2.2, 5.0), (-2.2, 0.0), (2.2, 0.0), (2.2, 5.0)))
    for i in order:
        stability_fuzz.add_body(builder, bodies[i], bodies[i].position)
    return dc.Simulation(*builder.finalize("float64"), config=config)


@cases.add
def determinism(quick: bool) -> Iterator[Check]:
    """One result whatever the threads, the schedule, the other worlds of the batch, and the process: bit for bit."""
    steps = 60 if quick else 250
    for dtype in DTYPES:
        base = pile(dtype, worlds=4)
        base.run(steps, DT)
        bits = state_bits(base, range(4))
        for what, options in (
            ("2 threads", {"threads": 2}),
            ("schedule color", {"schedule": "color"}),
            ("again", {}),
        ):
            sim = pile(dtype, worlds=4, **options)  # type: ignore[arg-type]
            sim.run(steps, DT)
            yield Check(f"{dtype}, {what}: bits differ [1]", state_bits(sim, range(4)) != bits, 0.0, sim)
        alone = pile(dtype, worlds=1)
        alone.run(steps, DT)
        differ = state_bits(alone, [0]) != state_bits(base, [0])
        yield Check(f"{dtype}, a world alone: bits differ [1]", differ, 0.0, alone)
    yield Check("float32, another process: bits differ [1]", elsewhere(steps) != digest(steps), 0.0)


def digest(steps: int) -> str:
    """What two worlds end with."""
    sim = pile("float32", worlds=2)
    sim.run(steps, DT)
    return hashlib.sha256(b"".join(state_bits(sim, range(2)))).hexdigest()


def elsewhere(steps: int) -> str:
    """The same from a process of its own."""
    code = f"from bench.stability.invariance import digest; print(digest({steps}))"
    root = Path(__file__).resolve().parents[2]
    done = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=True)
    return done.stdout.split()[-1]


@cases.add
def specialised(quick: bool) -> Iterator[Check]:
    """Kernels for discs only leave out the normal's arm, which general ones compute to round-off: 10 steps, 1e-12.

    They are steps whose solves all converge: those that friction leads in a circle, to the cap, part by 1e-5 m.
    """
    builder, state = begun("thesis", "float64", steps=114, bodies=50, config=EXACT)
    sims = [with_state(builder, "float64", state, config=EXACT, specialize=special) for special in (True, False)]
    most = 0
    for sim in sims:
        for _ in range(HORIZON):
            sim.step(DT)
            most = max(most, int(sim.stats.numpy("sweeps")[0]))
    yield Check("50 discs: sweeps of a step over the cap", most / EXACT.max_sweeps, 0.9, sims[0])
    off = np.abs(sims[0].state.numpy("position") - sims[1].state.numpy("position")).max()
    yield Check(f"50 discs, rows {sims[0].variant} and {sims[1].variant}: positions off [m]", off, 1e-9, sims[1])


@cases.add
def save_and_continue(quick: bool) -> Iterator[Check]:
    """A run saved and loaded in its middle, with another dt in each step, ends with the bits of one that went on."""
    steps = 40 if quick else 200
    times = 10.0 ** np.random.default_rng(1).uniform(-2.7, -1.7, 2 * steps)
    for dtype in DTYPES:
        sim = pile(dtype)
        for dt in times[:steps]:
            sim.step(float(dt))
        with tempfile.TemporaryDirectory() as folder:
            sim.save(Path(folder) / "middle.h5")
            loaded = dc.Simulation.load(Path(folder) / "middle.h5", threads=2)
        for dt in times[steps:]:
            sim.step(float(dt))
            loaded.step(float(dt))
        yield Check(f"{dtype}: bits differ [1]", state_bits(sim, range(3)) != state_bits(loaded, range(3)), 0.0, loaded)


@cases.add
def both_dtypes(quick: bool) -> Iterator[Check]:
    """float32 beside float64 from one state, 10 steps: within 1e-4 of a size, some 1000 units in the last place."""
    for name in ("thesis", "mixed", "stack", "chain"):
        builder, state = begun(name, "float32", steps=100)
        config = dc.SolverConfig(tolerance=1e-6, max_sweeps=20_000)
        sims = [with_state(builder, dtype, state, config=config) for dtype in DTYPES]
        for sim in sims:
            sim.run(HORIZON, DT)
        position = [sim.state.numpy("position").astype(np.float64) for sim in sims]
        yield Check(f"{name}: positions off [size of 1 m]", np.abs(position[0] - position[1]).max(), 1e-4, sims[0])


@cases.add
def backends(quick: bool) -> Iterator[Check]:
    """Warp beside the NumPy oracle, written from the formulas: positions within 1e-9 m over a run in float64.

    Extrapolating solves that end before they converge doubles a rounding in each step of a stack: a run with the
    default acceleration is short, a long one takes plain sweeps.
    """
    runs: tuple[tuple[Any, int], ...] = (("adaptive", 15), ("none", 15 if quick else 80))
    for acceleration, steps in runs:
        for name in ("mixed", "stack", "chain"):
            found = []
            for backend in ("warp", "numpy"):
                made = scenes.scene(name, bodies=8).build().finalize("float64", backend=backend)
                sim = dc.Simulation(*made, config=dc.SolverConfig(max_sweeps=50, acceleration=acceleration))
                sim.run(steps, DT)
                found.append(sim.state.numpy("position").copy())
            what = f"8 bodies, {name}, {acceleration}, {steps} steps: positions off [m]"
            yield Check(what, np.abs(found[0] - found[1]).max(), 1e-9)


@cases.add_slow
def linear_in_size(quick: bool) -> Iterator[Check]:
    """A settled pile of 1e5 discs in one world, and ten of 1e4 in worlds of their own: a world may be large.

    Median of steps of one sweep, taken in turn; per disc at most 1.5 times the time and 1.2 times the bytes. Caches
    hold the rows of 1e4 discs, but not those of 1e5: with more sweeps these take 1.3 to 1.6 times as long, by how fast
    the core is beside its memory.
    """
    one = settled(10_000)
    small, large = side_by_side(one, 1, worlds=10), side_by_side(one, 10)
    for sim in (small, large):
        sim.config = dc.SolverConfig(max_sweeps=1)
    times: list[list[float]] = [[], []]
    for _ in range(15):
        for sim, taken in zip((small, large), times, strict=True):
            begin = time.perf_counter()
            sim.step(DT)
            taken.append(time.perf_counter() - begin)
    counts = [dynamic_count(sim) for sim in (small, large)]
    pace = [np.median(taken) / count for taken, count in zip(times, counts, strict=True)]
    room = [sum(sim.memory().values()) / count for sim, count in zip((small, large), counts, strict=True)]
    what = f"{counts[1]} discs ({contact_count(large)} contacts) in one world over ten"
    yield Check(f"{what}: time per disc, {pace[1] * 1e6:.3g} us, ratio [1]", pace[1] / pace[0], 1.5)
    yield Check(f"{what}: memory per disc, {room[1]:.0f} bytes, ratio [1]", room[1] / room[0], 1.2)
