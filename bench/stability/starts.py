"""Starts of a solve that nothing sane would give it: where it ends, and whether its velocities are its impulses'.

Bodies are 1 m wide and weigh 1 kg; g = 9.8 m/s^2.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

import dc_kernels as dc
from bench.accuracy.common import G
from bench.stability.common import DT, finite, simulate
from bench.verdicts import Cases, Check
from dc_kernels import measure
from pipeline import scenes

cases = Cases()

EXACTLY: dict[str, Any] = {"tolerance": 1e-10, "max_sweeps": 20_000}


def starts(cache: np.ndarray) -> dict[str, np.ndarray]:
    """Impulses to start from, by name, (contacts, 2) [N s]."""
    rng = np.random.default_rng(1)
    return {
        "zero": np.zeros_like(cache),
        "random": rng.normal(0.0, 5.0, cache.shape),
        "1e6 N s": np.full_like(cache, 1e6),
        "-50 N s": np.full_like(cache, -50.0),
        "tangential only": np.tile([0.0, 100.0], (len(cache), 1)).astype(cache.dtype),
        "opposite": -cache,
    }


@cases.add
def adversarial_starts(quick: bool) -> Iterator[Check]:
    """A solve ends at a solution whatever impulses it starts from, and its velocities are the impulses' own.

    The step at 1.5 s of a pile that still moves. Without friction the problem is convex in the impulses and has one
    velocity: the same from all starts to 1e-6 m/s (float64, 1e-10 N s). With friction: see ``solutions_with_friction``.

    In float32 at default settings velocities are the predicted ones plus what the impulses give, to 1e-3 m/s: after
    one solve where the start allows it, else after a second ``solve()``, which begins with the impulses of the first.
    What a start adds to a velocity and the sweeps take away again may leave its rounding behind, a limit of float32:
    4 eps times the sum of what the start's impulses add.
    """
    for name, friction, dtype, settings in (
        ("mixed", 0.0, "float64", EXACTLY),
        ("mixed", 0.5, "float32", {}),
        ("thesis", 0.5, "float32", {}),
    ):
        sim = simulate(scenes.scene(name, friction=friction).build(), dtype, **settings)
        sim.run(150, DT)
        sim.collide(DT)
        slots, _ = measure.contact_slots(sim.contacts)
        cache = sim.contacts.numpy("impulse")[slots].copy()
        sim.solve()
        reference = resolved(sim)
        for what, start in starts(cache).items():
            where = f"{name}, mu {friction:g}, {dtype}, from {what}"
            sim.collide(DT)
            rounding = 4.0 * float(np.finfo(dtype).eps * velocity_of(sim, slots, start).max())
            sim.contacts.numpy("impulse")[slots] = start
            sim.solve()
            if dtype == "float64":
                off = float(np.abs(resolved(sim) - reference).max())
                yield Check(f"{where}: velocities off those from the cache [m/s]", off, 1e-6, sim)
                yield Check(f"{where}: natural map", float(sim.stats.numpy("residual")[0]), 1e-6, sim)
            off = float(np.abs(resolved(sim) - velocity_of(sim, slots)).max())
            yield Check(f"{where}: velocities off those of the impulses [m/s]", off, max(1e-3, rounding), sim)
            if rounding > 1e-3:
                sim.solve()
                off = float(np.abs(resolved(sim) - velocity_of(sim, slots)).max())
                yield Check(f"{where}, solved again: the same [m/s]", off, 1e-3, sim)
        sim.advance()
        yield finite(sim)


@cases.add
def solutions_with_friction(quick: bool) -> Iterator[Check]:
    """With Coulomb's law a solve may end at several solutions; it ends at one from any start, and none gains energy.

    In one of eight steps of the mixed pile solves to a natural map of 4e-11 end up to 2 m/s apart, where bodies are
    wedged; so eleven steps are looked at, from 1 s to 2 s (float64, 1e-10 N s). In each of them the natural map falls
    below 1e-6 from each start (from the cache sweeps may go in a circle: one step of thesis ends at the cap with 2e-6),
    velocities are those of the impulses, and their kinetic energy does not exceed that of the predicted ones: what a
    solution's impulses do at gaps that close and at points that slide is never positive. In the median step velocities
    lie within one step of free fall, g dt, of those from the cache.
    """
    for name in ("mixed", "thesis"):
        sim = simulate(scenes.scene(name, friction=0.5).build(), "float64", **EXACTLY)
        sim.run(98, DT)
        apart, rows = [], []
        for _ in range(11):
            sim.run(9, DT)
            sim.collide(DT)
            slots, _ = measure.contact_slots(sim.contacts)
            cache = sim.contacts.numpy("impulse")[slots].copy()
            start_energy = kinetic(sim, "predicted")
            sim.solve()
            reference = resolved(sim)
            apart.append(0.0)
            for start in starts(cache).values():
                sim.collide(DT)
                sim.contacts.numpy("impulse")[slots] = start
                sim.solve()
                apart[-1] = max(apart[-1], float(np.abs(resolved(sim) - reference).max()))
                off = np.abs(resolved(sim) - velocity_of(sim, slots)).max()
                rows.append((sim.stats.numpy("residual")[0], kinetic(sim, "solved") / start_energy - 1.0, off))
            sim.advance()
        residual, gained, off = np.max(rows, axis=0).tolist()
        where = f"{name}, mu 0.5, eleven steps, all starts"
        middle = float(np.median(apart))
        yield Check(f"{where}: velocities off those from the cache, median step [m/s]", middle, G * DT, sim)
        yield Check(f"{where}: kinetic energy over that predicted, less 1", gained, 1e-9, sim)
        yield Check(f"{where}: natural map", residual, 1e-6, sim)
        yield Check(f"{where}: velocities off those of the impulses [m/s]", off, 1e-6, sim)
        yield finite(sim)


def resolved(sim: dc.Simulation) -> np.ndarray:
    """Solved velocities, (bodies, 3) in float64."""
    return sim.motion.numpy("solved")[: sim.model.body_count, :3].astype(float)


def kinetic(sim: dc.Simulation, name: str) -> float:
    """Kinetic energy of the velocities ``motion.<name>`` [J]."""
    velocity = sim.motion.numpy(name)[: sim.model.body_count, :3].astype(float)
    inertia = np.column_stack([sim.model.numpy(field) for field in ("mass", "mass", "inertia")])
    return 0.5 * float((inertia * velocity**2).sum())


def velocity_of(sim: dc.Simulation, slots: np.ndarray, start: np.ndarray | None = None) -> np.ndarray:
    """Predicted velocities plus what the impulses of the contacts add, in float64, (bodies, 3).

    With ``start``: the sum of the sizes of what these impulses add instead.
    """
    contacts, model = sim.contacts, sim.model
    n = contacts.numpy("normal")[slots].astype(float)
    axes = (n, np.stack((n[:, 1], -n[:, 0]), axis=1))
    velocity = np.zeros((model.body_count, 3))
    if start is None:
        velocity += sim.motion.numpy("predicted")[: model.body_count, :3]
    impulse = (contacts.numpy("impulse")[slots] if start is None else start).astype(float)
    for side, sign in (("a", -1.0), ("b", 1.0)):
        body, arm = contacts.numpy(f"body_{side}")[slots], contacts.numpy(f"arm_{side}")[slots].astype(float)
        for k, axis in enumerate(axes):
            push = sign * impulse[:, k, None] * axis * model.numpy("inv_mass")[body][:, None]
            turn = sign * impulse[:, k] * (arm[:, 0] * axis[:, 1] - arm[:, 1] * axis[:, 0])
            part = np.column_stack((push, turn * model.numpy("inv_inertia")[body]))
            np.add.at(velocity, body, part if start is None else np.abs(part))
    return velocity
