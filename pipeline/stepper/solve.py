"""A network that replaces the contact solver, followed by the solver if needed.

    model, manifest = load_checkpoint(WEIGHTS)
    stepper = NetworkStepper(sim, model, manifest, StepperOptions(project=3))
    sim.run(250, 0.01, stepper=stepper)  # or between sim.collide and sim.advance: stepper.solve()

All worlds with contacts go through the network as one batch. ``advance`` moves the bodies with its velocities.
With ``project`` the solver first makes sweeps. If the velocities follow from the network's own impulses, the
sweeps start from these impulses. Other networks output no impulses: the sweeps then start from the cached ones, and the
part of the velocities that these do not explain remains, like a force in the step. ``"tolerance"`` drops
that part and lets the solver continue to its tolerance: the step is then the solver's, whatever the network outputs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

import dc_kernels as dc
from dc_kernels.learn.layers import MOST_SCALES
from dc_kernels.learn.step_channels import CHANNELS
from dc_kernels.learn.step_network import StepNetworkInLanes
from dc_kernels.measure import contact_slots
from dc_kernels.model.enums import BodyType
from dc_kernels.model.settings import shown
from dc_kernels.runtime.imports import require
from pipeline.networks.weights import Watch
from pipeline.starts.learned import grid_of
from pipeline.starts.start import Clock, Report, Started
from pipeline.stepper.answer import answer, reads_views
from pipeline.stepper.choice import StepperOptions
from pipeline.stepper.view import StepReader

torch = require("torch", "pipeline")

PARTS = ("start", "features", "network", "solve")
COUNTS = ("calls", "skipped", "not_finite", "too_fast")


class NetworkStepper:
    """Steps a simulation by a network.

    A world falls back to the solver for the step if the output is not finite or would give its bodies more kinetic
    energy than contacts allow: these are passive, so it is at most that of the predicted velocities.

    Attributes:
        counts: counts over worlds and steps: "calls" of the network; "skipped", without contacts; "not_finite" and
            "too_fast", in which the world fell back to the solver.
    """

    def __init__(
        self, sim: dc.Simulation, model: Any, manifest: Mapping[str, Any], options: StepperOptions | None = None
    ) -> None:
        """Allocate what the network reads.

        Args:
            sim: a simulation in float32, on the CPU, without joints and sleep.
            model: a network that ``train_stepper`` has trained.
            manifest: manifest of its checkpoint.
            options: number of sweeps afterwards, bound of the energy.

        Raises:
            ValueError: a network cannot step the simulation, or the network is not a stepper.
        """
        self.sim, self.options = sim, options or StepperOptions()
        self.model = model.eval()
        self.reader = StepReader(sim, _grid(sim, model, manifest))
        self._lanes = _in_lanes(self.reader, self.model)
        self._watch = Watch(self.model)
        self._trained = _time_steps(manifest)
        self.clock = Clock(dict.fromkeys(PARTS, 0.0))
        self.counts = dict.fromkeys(COUNTS, 0)
        self._world = self.reader.world

    def solve(self, started: Started | None = None) -> None:
        """Run the solve phase of a step, between ``collide`` and ``advance``; see ``Start.solve``.

        Raises:
            ValueError: see ``Simulation.solve``.
        """
        with self.clock.part("start"):
            self._solve()
            if started is not None:
                started()

    def _solve(self) -> None:
        """Ask the network, let the solver sweep, and let worlds whose answer is no good fall back."""
        sim, project = self.sim, self.options.project
        if self.reader.refresh():
            self._world = self.reader.world
            if self._lanes is not None:
                self._lanes.set_walls(self.reader.walls[:, 0])
        cached = sim.contacts.numpy("impulse").copy()
        with self.clock.part("solve"):
            sim.solve(pause=0)  # what the start impulses make of the predicted velocities
        count = sim.contacts.numpy("contact_count")
        live = sim.state.numpy("flags") == 0
        asked = np.flatnonzero((count > 0) & live)
        self.counts["skipped"] += int(live.sum()) - len(asked)
        if not len(asked):
            return
        self.counts["calls"] += len(asked)
        solved = sim.motion.numpy("solved")
        predicted = sim.motion.numpy("predicted")
        bodies = len(self._world)
        before = solved[:bodies, :3].copy()
        velocity = self._ask(asked, before)
        sound = self._sound(velocity, asked)
        if not sound.all():
            own = ~sound[self._world]
            velocity[own] = before[own]
            own = ~np.repeat(sound, count)
            slots = contact_slots(sim.contacts)[0][own]
            sim.contacts.numpy("impulse")[slots] = cached[slots]
        if project == 0:
            solved[:bodies, :3] = velocity
        elif project == "tolerance":
            with self.clock.part("solve"):
                sim.solve()
        else:
            kept = predicted[:bodies, :3].copy()
            if not reads_views(self.model):
                predicted[:bodies, :3] += velocity - before
            with self.clock.part("solve"):
                config = sim.config
                sim.solve(replace(config, max_sweeps=project, min_sweeps=min(config.min_sweeps, project)))
            predicted[:bodies, :3] = kept
            left = self._sound(solved[:bodies, :3], np.flatnonzero(sound & (count > 0) & live))
            sound &= left
        if not sound.all() and project != "tolerance":
            self._fall_back(sound, cached)

    def _ask(self, asked: np.ndarray, before: np.ndarray) -> np.ndarray:
        """Return the network's velocities of all bodies, (N, 3), and write its impulses, if it answers any.

        Those of worlds that it is not asked for are ``before``.
        """
        if self._lanes is not None:
            with self.clock.part("network"):
                if self._watch.changed():
                    self._lanes.load(self.model.in_lanes())
                chosen = np.zeros(self.sim.model.world_count, bool)
                chosen[asked] = True
                found = self._lanes(chosen)
                return np.where(chosen[self._world, None], found, before)
        worlds = None if len(asked) == self.sim.model.world_count else asked
        with self.clock.part("features"):
            view = self.reader.read(worlds)
        with self.clock.part("network"), torch.inference_mode():
            answered = answer(self.model, view, self.reader.grid)
            way = (answered.way * view.speed).numpy()
        velocity = before.copy()
        velocity[self.reader.rows(worlds)] = way
        if answered.impulse is not None:
            speed = view.speed[view.body_start[:-1].long(), 0].repeat_interleave(view.contact_start.diff())
            self.reader.write_impulses(worlds, (answered.impulse * speed[:, None]).numpy())
        return velocity

    def _sound(self, velocity: np.ndarray, asked: np.ndarray) -> np.ndarray:
        """Tell which worlds have good velocities, bool (W,), and count the others among those ``asked``."""
        model, worlds = self.sim.model, self.sim.model.world_count
        finite = np.isfinite(velocity).all(axis=1)
        lost = np.bincount(self._world[~finite], minlength=worlds) > 0
        predicted = self.sim.motion.numpy("predicted")[: len(velocity), :3]
        mass, inertia = (model.numpy(name).astype(np.float64) for name in ("mass", "inertia"))
        moving = model.numpy("body_type") == BodyType.DYNAMIC
        weight = np.where(moving[:, None], np.stack([mass, mass, inertia], axis=1), 0.0)

        def energy(values: np.ndarray) -> np.ndarray:
            square = (weight * np.nan_to_num(values.astype(np.float64), posinf=0.0, neginf=0.0) ** 2).sum(axis=1)
            return 0.5 * np.bincount(self._world, square, worlds)

        # what a kinematic body may give: twice its speed, to all
        driven = np.zeros(worlds)
        others = ~moving
        np.maximum.at(driven, self._world[others], (predicted[others].astype(np.float64) ** 2).sum(axis=1))
        most = self.options.energy * (energy(predicted) + 2.0 * np.bincount(self._world, weight[:, 0], worlds) * driven)
        chosen = np.zeros(worlds, bool)
        chosen[asked] = True
        lost &= chosen
        fast = chosen & ~lost & (energy(velocity) > most)
        self.counts["not_finite"] += int(lost.sum())
        self.counts["too_fast"] += int(fast.sum())
        return ~(lost | fast)

    def _fall_back(self, sound: np.ndarray, cached: np.ndarray) -> None:
        """Let the solver make the step of the worlds that are not ``sound``, from their cached impulses."""
        sim = self.sim
        impulse, solved = sim.contacts.numpy("impulse"), sim.motion.numpy("solved")
        slots, world = contact_slots(sim.contacts)
        kept = impulse[slots[sound[world]]].copy(), solved.copy()
        impulse[slots] = cached[slots]
        with self.clock.part("solve"):
            sim.solve()
        impulse[slots[sound[world]]] = kept[0]
        own = np.flatnonzero(sound[self._world])
        solved[own] = kept[1][own]

    def report(self) -> Report:
        """Return how often the network answered, what fell back to the solver, and what it took."""
        counts = self.counts
        fallen = counts["not_finite"] + counts["too_fast"]
        text = (
            f"network in the solver's place: {counts['calls']} answers for a world and step, "
            f"{self._project()}\n"
            f"  skipped: {counts['skipped']} without contacts; {fallen} fell back to the solver: "
            f"{counts['not_finite']} not finite, {counts['too_fast']} with too much energy"
        )
        dt, (least, most) = self.sim.motion.numpy("step_dt"), self._trained
        other = dt[(dt > 0) & ((dt < 0.99 * least) | (dt > 1.01 * most))]
        if len(other):
            text += f"\n  dt {other[0]:g} s lies beyond {least:g} to {most:g} s, which the network was trained on"
        return Report(
            seconds=dict(self.clock.seconds),
            is_network=True,
            counts={**counts, "dropped": fallen},
            text=text,
        )

    def _project(self) -> str:
        """Say what the solver does afterwards."""
        project = self.options.project
        if project == "tolerance":
            return "then the solver to its tolerance"
        return f"then up to {project} sweeps of the solver" if project else "no sweep of the solver"


def _in_lanes(reader: StepReader, model: Any) -> StepNetworkInLanes | None:
    """Return what answers in lanes; None: torch does, as the network is no StepNet, or the backend has no lanes."""
    found = model.in_lanes() if hasattr(model, "in_lanes") and reads_views(model) else None
    if found is None or reader.sim.backend != "warp" or len(found.widths) > MOST_SCALES:
        return None
    return StepNetworkInLanes(reader.sim, reader.grid, reader.walls[:, 0], found)


def _time_steps(manifest: Mapping[str, Any]) -> tuple[float, float]:
    """Return the shortest and the longest time step that a network was trained on [s].

    Raises:
        ValueError: the manifest does not say.
    """
    found = manifest["stepper"].get("dt")
    if not isinstance(found, (list, tuple)) or not found or not all(isinstance(dt, (int, float)) for dt in found):
        raise ValueError(f"the manifest's dt is {shown(found)}; it must be a list of time steps")
    return float(min(found)), float(max(found))


def _grid(sim: dc.Simulation, model: Any, manifest: Mapping[str, Any]) -> dc.Grid:
    """Return the grid of a network's image.

    Raises:
        TypeError: the manifest is no mapping.
        ValueError: the network is none of a stepper, or its grid is another than its manifest says.
    """
    if not isinstance(manifest, Mapping):
        raise TypeError(f"manifest is a {type(manifest).__name__}; it must be the mapping that load_checkpoint returns")
    described = manifest.get("stepper")
    if not isinstance(described, Mapping):
        raise ValueError("the manifest has no 'stepper': the network was not trained by train-stepper")
    if reads_views(model):
        return grid_of(sim, model.config.spacing)
    try:
        values = dict(described["grid"])
        grid = dc.Grid(**{**values, "origin": tuple(values["origin"])})
    except (KeyError, TypeError) as error:
        raise ValueError(f"the manifest's grid is {described.get('grid')!r}: {error}") from None
    shape = (len(CHANNELS), *grid.shape)
    if getattr(model, "shape", shape) != shape:
        raise ValueError(f"the manifest's images are {shape}, channels first; the network reads {model.shape}")
    return grid
