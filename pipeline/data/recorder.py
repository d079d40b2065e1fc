"""One shard of a data set: its worlds simulated, every state solved on to a label, all of it kept."""

from __future__ import annotations

import itertools
import json
import threading
import weakref
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

import dc_kernels as dc
from dc_kernels.grid.channels import BODY_CHANNELS, CONTACT_CHANNELS, IMPULSES
from dc_kernels.model.room import used_slots, world_of
from dc_kernels.solve.rows import SURFACED, read_column, variant_of
from pipeline.data.layout import LAYOUT, MOTION, STAGES, DatasetSpec, offsets
from pipeline.data.packing import Spread, one_by_one
from pipeline.data.recipe import Recipe
from pipeline.data.shards import shard_image
from pipeline.scenes.base import parameter_docs


class Stopped(Exception):
    """Tells that a shard was given up because the run is to end."""


class Halt(threading.Event):
    """Tells the threads that make shards to give them up."""

    def __init__(self) -> None:
        """Begin with no shard in the making."""
        super().__init__()
        self._sims: weakref.WeakSet[dc.Simulation] = weakref.WeakSet()

    def watch(self, sim: dc.Simulation) -> None:
        """Let ``hurry`` end the solves of a simulation."""
        self._sims.add(sim)

    def hurry(self) -> None:
        """Give up all shards: also solves under way end, whose results nobody gets."""
        self.set()
        for sim in list(self._sims):
            sim.cut_short()


def make_shard(
    recipe: Recipe,
    number: int,
    progress: Callable[[int], None] | None = None,
    stop: Halt | None = None,
    *,
    compression: str = "zstd",
    spread: Spread = one_by_one,
) -> memoryview:
    """Simulate the worlds of a shard.

    Args:
        recipe: of the data set.
        number: of the shard.
        progress: called with the steps done after each.
        stop: ends the shard early, by ``Stopped``.
        compression: of its file, a key of ``packing.CODECS``.
        spread: what shares the compression among threads.

    Returns:
        The bytes of its file.

    Raises:
        ValueError: for a scene that cannot be built, or has joints or belts.
    """
    seeds = recipe.options.seeds(number)
    builder, drawn, dt = build_worlds(recipe, seeds)
    recorder = Recorder(recipe, builder)
    if stop is not None:
        stop.watch(recorder.sim)
    for step in range(recipe.options.steps):
        recorder.step(dt)
        if stop is not None and stop.is_set():
            raise Stopped
        if progress is not None:
            progress(step + 1)
    config = recipe.config()
    del config["worlds"]  # so that a data set can grow
    own = {"world/seed": np.array(seeds), "world/dt": dt}
    own |= {f"drawn/{name}": np.array([world[name] for world in drawn]) for name in drawn[0]}
    extra = {f"drawn/{name}": _drawn_spec(recipe, name) for name in drawn[0]}
    attributes = {
        "config": json.dumps(config),
        "seed": seeds[0],
        "worlds": len(seeds),
        "steps": recipe.options.steps,
        "flags": recorder.flags,
        "label_reached": recorder.label_reached / (len(seeds) * recipe.options.steps),
    }
    arrays = itertools.chain(own.items(), recorder.arrays())
    return shard_image(arrays, {**extra, **recorder.extra}, attributes, compression, spread)


def _drawn_spec(recipe: Recipe, name: str) -> DatasetSpec:
    """Describe what is drawn for each world, in the unit that the scene's parameter has."""
    dtype = np.dtype(np.int64 if recipe.is_whole(name) else np.float64)
    what, unit = ("time step", "s") if name == "dt" else parameter_docs(type(recipe.scene))[name]
    return DatasetSpec(dtype, unit, f"{'' if name == 'dt' else f'scene.{name}: '}{what}; drawn from the world's seed")


def build_worlds(
    recipe: Recipe, seeds: Sequence[int]
) -> tuple[dc.ModelBuilder, list[dict[str, float | int]], np.ndarray]:
    """Build the worlds of some seeds; returns them, what was drawn for each, and their time steps."""
    drawn = [recipe.draw(seed) for seed in seeds]
    dt = np.array([world.get("dt", recipe.options.dt) for world in drawn], np.float32)
    if isinstance(seeds, range) and {name for name, _, _ in recipe.options.ranges} <= {"dt"}:
        return recipe.scene.build(len(seeds), seeds[0]), drawn, dt
    builder = dc.ModelBuilder()
    for seed, world in zip(seeds, drawn):
        own = replace(recipe.scene, **{name: value for name, value in world.items() if name != "dt"})
        own.add_worlds(builder, [np.random.Generator(np.random.PCG64(seed))])
    return builder, drawn, dt


def check_scene(recipe: Recipe) -> None:
    """Build the first world of a data set, without any kernel, to know what is wrong with its scene before it is made.

    Raises:
        ValueError: for a scene that cannot be built, or has joints or belts.
    """
    builder, _, _ = build_worlds(recipe, recipe.options.seeds(0)[:1])
    _refuse_others(recipe, builder.finalize("float32", backend="numpy")[0])


def _refuse_others(recipe: Recipe, model: dc.Model) -> None:
    """Raise ``ValueError`` for a model with joints, or with surfaces whose speeds the contacts of a data set lack."""
    if model.joint_count:
        raise ValueError(f"scene {recipe.scene.name} has joints, whose impulses a data set does not hold")
    if variant_of(model, only_discs=False) in SURFACED:
        raise ValueError(
            f"scene {recipe.scene.name} has surfaces that move or resist rolling, of which a data set says nothing"
        )


class Recorder:
    """Steps a simulation and keeps every state, its solution and its label."""

    def __init__(self, recipe: Recipe, builder: dc.ModelBuilder) -> None:
        """Put the worlds to their start.

        Raises:
            ValueError: where there are joints or belts.
        """
        model, state, joints = builder.finalize("float32")
        _refuse_others(recipe, model)
        self.sim = sim = dc.Simulation(model, state, joints, config=recipe.solver)
        self.recipe = recipe
        self.label_config = recipe.label_config
        self.measure = recipe.solver.ends_at[0]
        self.flags = self.label_reached = 0
        self.world = world_of(model.numpy("body_start"))  # of each body
        self.kept: dict[str, list[np.ndarray]] = {}
        self.images: dc.Images | None = None
        self.extra: dict[str, DatasetSpec] = {}
        if recipe.options.grids:
            self.images = dc.Images(sim, dc.ImageSpec(recipe.options.grid))
            self.extra = {
                "grid/input": self._image_spec(
                    "bodies and contacts before the solve; walls as 100 kg", self.images.channels
                ),
                "grid/label": self._image_spec("the label", IMPULSES),
            }

    def _image_spec(self, meaning: str, channels: Sequence[str]) -> DatasetSpec:
        """Describe images of some channels, each with a unit of its own."""
        units = [{**BODY_CHANNELS, **CONTACT_CHANNELS}[name].unit for name in channels]
        shape = (len(channels), *self.recipe.options.grid.shape)
        notes = {"channels": list(channels), "units": units}
        unit = ", ".join(dict.fromkeys(units))
        return DatasetSpec(np.dtype(np.float32), unit, f"{meaning}: {', '.join(channels)}", shape, notes=notes)

    def step(self, dt: np.ndarray) -> None:
        """Make a step of dt [s] in each world, (worlds,)."""
        sim = self.sim
        sim.collide(dt)
        contacts = sim.contacts
        for name in MOTION:
            self._keep(f"motion/{name}", sim.state.numpy(name).copy())
        live = sim.state.numpy("flags") == 0  # others keep the contacts of the step in which they stopped
        count = np.where(live, contacts.numpy("contact_count"), 0).astype(np.int64)
        world = np.repeat(np.arange(len(count)), count)
        slots = used_slots(contacts.numpy("contact_start"), count)
        self._keep("count", count)
        for name in ("key", "normal", "gap", "friction", "restitution", "age"):
            self._keep(f"contact/{name}", contacts.numpy(name).take(slots, 0))
        self._keep("contact/color", contacts.numpy("color").take(slots).astype(np.uint8))
        body, first = contacts.numpy("body_a").take(slots), sim.model.numpy("body_start").take(world)
        self._keep("contact/body_a", body - first)
        self._keep("contact/body_b", contacts.numpy("body_b").take(slots) - first)
        rows = sim.rows
        bias = read_column(rows.numpy("column"), sim.variant, "bias", rows.numpy("slot").take(slots))
        self._keep("contact/bias", bias)
        self._keep("contact/point", sim.state.numpy("position").take(body, 0) + contacts.numpy("arm_a").take(slots, 0))
        impulse, solved = contacts.numpy("impulse"), sim.motion.numpy("solved")
        stages = np.empty((len(STAGES), len(slots), 2), np.float32)
        impulse.take(slots, 0, stages[0])
        if self.images is not None:
            self._keep("grid/input", dc.to_numpy(self.images.splat()).copy())
        sim.solve()
        impulse.take(slots, 0, stages[1])
        self._note("")
        stages[2] = self._label(impulse, solved, slots)
        self._keep("contact/impulse", stages)
        sim.advance()
        self._keep_correction(dt)
        flags = sim.state.numpy("flags").copy()
        self._keep("step/flags", flags)
        self.flags |= int(np.bitwise_or.reduce(flags))

    def _keep_correction(self, dt: np.ndarray) -> None:
        """Keep what position phase and continuous detection added to the way that the solved velocities go."""
        motion, count = self.sim.motion, len(self.world)
        way = motion.numpy("solved")[:count] * dt.take(self.world)[:, None]  # whole rows, as parts of them take longer
        correction = np.subtract(motion.numpy("displacement")[:count], way, out=way)
        stopped = self.sim.state.numpy("flags") != 0
        if stopped.any():
            correction[stopped.take(self.world)] = 0.0
        self._keep("motion/position_correction", correction[:, :2])
        self._keep("motion/angle_correction", correction[:, 2])

    def _label(self, impulse: np.ndarray, solved: np.ndarray, slots: np.ndarray) -> np.ndarray:
        """Solve on to the label, which is returned, (contacts, 2) [N s], and put back what the step goes on from."""
        before = impulse.copy(), solved.copy()
        self.sim.solve(self.label_config)
        self._note("label_")
        reached = self.sim.stats.numpy(self.measure) <= self.label_config.ends_at[1]
        self._keep("step/label_reached", reached)
        self.label_reached += int(reached.sum())
        label = impulse.take(slots, 0)
        if self.images is not None:
            self._keep("grid/label", dc.to_numpy(self.images.impulse_image()).copy())
        impulse[...], solved[...] = before
        return label

    def _note(self, prefix: str) -> None:
        """Keep how the latest solve ended."""
        for name in ("sweeps", "change", "residual"):
            self._keep(f"step/{prefix}{name}", self.sim.stats.numpy(name).copy())

    def _keep(self, name: str, values: np.ndarray) -> None:
        """Keep values of a step."""
        self.kept.setdefault(name, []).append(values)

    def arrays(self) -> Iterator[tuple[str, np.ndarray]]:
        """Go through all datasets but seeds and time steps, path and values; what was kept is given up one by one."""
        model, kept = self.sim.model, self.kept
        worlds, steps = model.world_count, self.recipe.options.steps
        body_start, shape_start = (model.numpy(name).astype(np.int64) for name in ("body_start", "shape_start"))
        bodies = np.diff(body_start)
        count = np.stack(kept.pop("count"))  # (steps, worlds)
        first = np.cumsum(count) - count.ravel()  # contacts lie step after step; they are wanted world after world
        wanted = count.T.ravel()
        order = np.arange(wanted.sum())
        order += np.repeat(first.reshape(count.shape).T.ravel() - (np.cumsum(wanted) - wanted), wanted)
        fixed = {
            **{f"world/{name}": model.numpy(name) for name in ("gravity", "origin", "length_scale")},
            "world/slop": self.recipe.solver.slop * model.numpy("length_scale"),
            "world/restitution_threshold": self.recipe.solver.restitution_speed(
                model.numpy("gravity"), model.numpy("length_scale")
            ),
            "world/body_start": body_start,
            "world/shape_start": shape_start,
            "world/step_start": np.arange(worlds + 1) * steps,
            **{f"body/{name}": model.numpy(name) for name in LAYOUT["body"]},
            **{f"shape/{name}": model.numpy(name) for name in LAYOUT["shape"] if name.startswith("shape_")},
            "shape/shape_body": model.numpy("shape_body") - np.repeat(body_start[:-1], np.diff(shape_start)),
            "shape/vertex_start": model.numpy("vertex_start"),
            "vertex/vertices": model.numpy("vertices"),
            **{f"end/{name}": self.sim.state.numpy(name) for name in LAYOUT["end"]},
            "step/step": np.tile(np.arange(steps), worlds),
            "step/motion_start": offsets(np.repeat(bodies, steps)),
            "step/contact_start": offsets(count.T.ravel()),
        }
        yield from fixed.items()
        for name in list(kept):
            parts, axis = kept.pop(name), name.split("/")[0]
            if axis == "contact":
                lead = len(LAYOUT[axis][name.split("/")[1]].lead)
                yield name, np.concatenate(parts, lead).take(order, lead)
                continue
            whole = np.stack(parts)  # (steps, ...)
            if axis == "motion":
                own = [whole[:, a:b] for a, b in itertools.pairwise(body_start)]
                yield name, np.concatenate([part.reshape(-1, *whole.shape[2:]) for part in own])
            else:
                yield name, whole.swapaxes(0, 1).reshape(-1, *whole.shape[2:])
