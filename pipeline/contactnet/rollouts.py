"""Calls of a network recorded where it makes them: solves of falling and settling worlds, with the network in the loop.

A network meets the errors that its own earlier corrections leave, so it has to be trained on those (on policy).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import dc_kernels as dc
from dc_kernels.learn.differentiable import ContactProblem
from pipeline.contactnet.loss import BODY_FIELDS, CONTACT_FIELDS
from pipeline.options import RunOptions
from pipeline.scenes import Thesis
from pipeline.seeds import check_training_seeds
from pipeline.starts.learned import CallOptions, LearnedSolve

THESES_SETTINGS = {"slop": 5e-3, "speculative": 0.0, "speculative_max": 0.0}
LABEL = {"tolerance": 2e-6, "max_sweeps": 4000, "acceleration": "aitken"}
LABEL_CHANGE = 1e-5
"""Impulse change below which a solve counts as a solution [N s]."""
FALL = 0.4
"""Time in which discs fall before many of them touch [s]."""


@dataclass(frozen=True, kw_only=True)
class Setting:
    """Worlds of one kind in which calls are recorded."""

    bodies: int
    """Discs in each world [1]."""
    worlds: int
    """Number of worlds [1]."""
    acceleration: str
    """Acceleration of the solver."""
    solves: int
    """Solves of each world in which calls are recorded [1]."""
    calls: int
    """Calls that are kept of each of these solves, in the mean over the worlds [1]."""
    steps: int = 250
    """Steps of each world [1]."""
    max_sweeps: int = 1000
    """Largest number of sweeps of a solve [1]."""


SETTINGS = (
    Setting(bodies=100, worlds=24, acceleration="none", solves=20, calls=1),
    Setting(bodies=100, worlds=24, acceleration="aitken", solves=20, calls=1),
    Setting(bodies=300, worlds=4, acceleration="aitken", solves=20, calls=4, steps=300, max_sweeps=2000),
    Setting(bodies=1000, worlds=2, acceleration="aitken", solves=15, calls=6, steps=350, max_sweeps=3000),
)


def seeds_of(settings: tuple[Setting, ...]) -> int:
    """Count the worlds, and so the seeds, of a round of all settings."""
    return sum(setting.worlds for setting in settings)


def record(model: Any, setting: Setting, seed: int, generator: np.random.Generator) -> list[dict[str, Any]]:
    """Record calls of the network in some solves of worlds of the seeds from ``seed`` on.

    Solves between them run without it. A third of the batches has the solver's own margins, the others the theses'.

    Args:
        model: a ContactNet.
        setting: what runs.
        seed: of the first world.
        generator: which solves and calls are kept.

    Returns:
        For each call its world's features, contacts in the order of a sweep, and its ``problem`` with the solution.

    Raises:
        ValueError: for held-out seeds.
    """
    check_training_seeds(seed, setting.worlds)
    margins = THESES_SETTINGS if generator.random() < 2 / 3 else {}
    settings = {"acceleration": setting.acceleration, "max_sweeps": setting.max_sweeps, "min_sweeps": 1, **margins}
    config = dc.SolverConfig.preset("accurate", **settings)  # type: ignore[arg-type]
    run = RunOptions(worlds=setting.worlds, seed=seed)
    sim = run.simulation(Thesis(bodies=setting.bodies), config)
    solve = LearnedSolve(sim, model, CallOptions(begin=True, pays=0.0))
    recorder = Recorder(solve, generator)
    solve.watch = recorder.watch
    fall = int(FALL / run.dt)
    recorded = np.sort(generator.choice(np.arange(fall, setting.steps), setting.solves, replace=False))
    calls: list[dict[str, Any]] = []
    done = 0
    for step in recorded:
        sim.run(int(step) - done, run.dt)
        sim.collide(run.dt)
        solve.solve()
        calls += recorder.take(setting.calls * setting.worlds)
        sim.advance()
        done = int(step) + 1
    return calls


class Recorder:
    """Keeps what the network reads until the solve is over and its solution known."""

    def __init__(self, solve: LearnedSolve, generator: np.random.Generator) -> None:
        self.solve, self.generator = solve, generator
        self.label_config = replace(solve.sim.config, **LABEL)  # type: ignore[arg-type]
        self.share = 4  # of the worlds that call, one in so many is kept
        self.pending: list[dict[str, Any]] = []

    def watch(self, worlds: np.ndarray, begin: bool) -> None:
        """Copy the features of some of these worlds."""
        reader, sim = self.solve.reader, self.solve.sim
        first = sim.contacts.numpy("contact_start")
        for k in self.generator.permutation(len(worlds))[: max(2, len(worlds) // self.share)]:
            w = int(worlds[k])
            own = slice(reader.packed_start[k], reader.packed_start[k + 1])
            count = own.stop - own.start
            self.pending.append(
                {
                    "world": w,
                    "scale": reader.scale[k].copy(),
                    "impulse": sim.contacts.numpy("impulse")[first[w] : first[w] + count].copy(),
                    **{name: getattr(reader, name)[own].copy() for name in ("local", "image_value", "step", "rate")},
                    "places": np.stack([place[own] for place in (reader.place, reader.place_a, reader.place_b)]),
                }
            )

    def take(self, most: int) -> list[dict[str, Any]]:
        """Return up to ``most`` calls of the solve that is over, with their problems; its result stays as it is."""
        pending, self.pending = self.pending, []
        if not pending:
            return []
        sim = self.solve.sim
        impulse, solved = sim.contacts.numpy("impulse").copy(), sim.motion.numpy("solved").copy()
        sim.solve(self.label_config)
        label = sim.contacts.numpy("impulse").copy()
        known = sim.stats.numpy("change") < LABEL_CHANGE
        sim.contacts.numpy("impulse")[...] = impulse
        sim.motion.numpy("solved")[...] = solved
        problem = ContactProblem.from_simulation(sim)
        slot = np.asarray(problem.slot)
        start, body_start = np.asarray(problem.contact_start), np.asarray(problem.body_start)
        problems: dict[int, dict[str, Any]] = {}
        kept = []
        for i in self.generator.permutation(len(pending))[:most]:
            call = pending[i]
            w = call["world"]
            if not known[w]:
                continue
            if w not in problems:
                own, bodies = slice(start[w], start[w + 1]), slice(body_start[w], body_start[w + 1])
                problems[w] = {
                    **{name: np.asarray(getattr(problem, name))[own].copy() for name in CONTACT_FIELDS},
                    **{name: np.asarray(getattr(problem, name))[own] - body_start[w] for name in ("body_a", "body_b")},
                    **{name: np.asarray(getattr(problem, name))[bodies].copy() for name in BODY_FIELDS},
                    "label": label[slot[own]],
                    "order": slot[own] - sim.contacts.numpy("contact_start")[w],
                }
            order = problems[w]["order"]
            for name in ("local", "image_value", "step", "rate", "impulse"):
                call[name] = call[name][order]
            call["places"] = call["places"][:, order]
            kept.append({**call, "problem": problems[w]})
        return kept
