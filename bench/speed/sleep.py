"""What sleep saves, what it costs where nothing sleeps, and what is different after it.

The scenes are piles that have come to rest, as in the bench ``games``. Alternatives are stepped in turn.
"""

from __future__ import annotations

import dataclasses
import itertools
import statistics
from collections.abc import Callable
from typing import Any

import numpy as np

import dc_kernels as dc
from bench import timing
from bench.cases import DT
from bench.games.engines import Handed
from bench.games.rows import ROWS, hand_over

SUMMARY = "steps of piles asleep, asleep in half, and awake with sleep allowed; what waking changes [us, mm]"
KEYS = ("asleep_us", "asleep_step_us", "awake_slowdown", "half_share", "wake_difference", "hit_difference")
THREADS = 1

SCENES = ("settled_discs_10000", "settled_mixed_1000", "pyramid_1275", "boxes_1024_worlds", "one_disc_run")
QUICK = ("settled_discs_1000", "settled_mixed_1000", "pyramid_1275", "boxes_64_worlds", "one_disc_run")
SETTLE = 300  # steps by which all of a scene has come to rest; what has not is let sleep by a call
ROUNDS, ROUNDS_QUICK = 15, 7
# of what is awake the ratios are within some percent of 1, as is the noise: simulations are made anew so often, in both
# orders, as one is up to 6 % slower than another of equal settings, by where its arrays lie
PAIRS, PAIRS_QUICK = 8, 2
ASLEEP_STEPS = 1_000  # timed together
AWAKE_STEPS, AWAKE_BODIES = 10, 50_000  # timed together: at least so many steps, and bodies times steps
AFTER = 50  # steps after which what woke is compared with what never slept
SPEED = 5.0  # of the ball shot into a pile [m/s]


def measure(quick: bool) -> dict[str, Any]:
    """Values of each scene, and the worst of all."""
    found = {}
    for name in QUICK if quick else SCENES:
        timing.progress(name)
        found[name] = measure_scene(name, *((ROUNDS_QUICK, PAIRS_QUICK) if quick else (ROUNDS, PAIRS)))

    def worst(key: str) -> float:
        return max(values[key] for values in found.values() if values[key] is not None)

    return {**{key: worst(key) for key in KEYS}, "scenes": found}


def measure_scene(name: str, rounds: int, pairs: int) -> dict[str, Any]:
    """Values of one scene of the bench ``games``."""
    handed = hand_over(ROWS[name])
    config = dc.SolverConfig()
    asleep = simulation(handed, dataclasses.replace(config, sleep=True))
    asleep.run(SETTLE, DT)
    by_itself = float(asleep.asleep.sum() / max(dynamic(asleep).sum(), 1))
    asleep.sleep()
    spent = timing.interleave(
        {"run": lambda: asleep.run(ASLEEP_STEPS, DT), "step": steps(asleep, ASLEEP_STEPS)}, rounds
    )
    values: dict[str, Any] = {"bodies": int(dynamic(asleep).sum()), "asleep_by_itself": by_itself}
    for key, way in (("asleep_us", "run"), ("asleep_step_us", "step")):
        values[key] = 1e6 * statistics.median(spent[way]) / ASLEEP_STEPS
    values |= measure_awake(handed, config, rounds, pairs)
    values |= differences(handed, config)
    return values


def simulation(handed: Handed, config: dc.SolverConfig) -> dc.Simulation:
    """A simulation of the bodies of a scene at rest."""
    sim = dc.Simulation(*handed.fresh(), config=config)
    sim.warmup()
    return sim


def dynamic(sim: dc.Simulation) -> np.ndarray:
    """Bodies that are dynamic, bool (bodies,)."""
    return np.asarray(sim.model.numpy("body_type") == dc.BodyType.DYNAMIC)


def steps(sim: dc.Simulation, count: int) -> Callable[[], None]:
    """Steps one by one, as a game takes them."""

    def take() -> None:
        for _ in range(count):
            sim.step(DT)

    return take


def measure_awake(handed: Handed, config: dc.SolverConfig, rounds: int, pairs: int) -> dict[str, float | None]:
    """A step with all awake though they might sleep, and one with every second world asleep, over one without sleep.

    Returns the means over simulations that are made anew of their medians over rounds.
    """
    found = [awake_shares(handed, config, rounds, 1 if k % 2 else -1) for k in range(pairs)]
    return {
        key: statistics.fmean(shares[name] for shares in found) if name in found[0] else None
        for key, name in (("awake_slowdown", "on"), ("half_share", "half"))
    }


def awake_shares(handed: Handed, config: dc.SolverConfig, rounds: int, order: int) -> dict[str, float]:
    """The time of a step over that without sleep, by name; simulations are made in an order (1) or its reverse (-1).

    Where all are awake they rest and are timed, but for too short to sleep: both simulations take the same steps, to
    the bit.
    """
    awake = dataclasses.replace(config, sleep=True, sleep_time=1e6)
    configs = {"off": config, "on": awake, **({"half": awake} if handed.worlds > 1 else {})}
    sims = {name: simulation(handed, configs[name]) for name in list(configs)[::order]}
    for sim in sims.values():
        sim.run(SETTLE, DT)
    if "half" in sims:
        world = np.repeat(np.arange(handed.worlds), np.diff(sims["half"].model.numpy("body_start")))
        sims["half"].sleep(np.flatnonzero(world % 2 == 0))
    count = max(AWAKE_STEPS, AWAKE_BODIES // handed.groups[0].body_count)
    times: dict[str, list[float]] = {name: [] for name in sims}
    for k in range(rounds):
        for name in list(sims)[:: -1 if k % 2 else 1]:
            times[name].append(timing.seconds(lambda sim=sims[name]: sim.run(count, DT)))  # type: ignore[misc]
    if (sims["on"].state.numpy("position") != sims["off"].state.numpy("position")).any():
        raise RuntimeError("bodies that might sleep, and are awake, move differently")
    shares = {name: [one / off for one, off in zip(times[name], times["off"], strict=True)] for name in sims}
    return {name: statistics.median(ratios) for name, ratios in shares.items()}


def differences(handed: Handed, config: dc.SolverConfig) -> dict[str, float]:
    """Distances [mm] between bodies that slept and those of a simulation that never did, in the mean and at most.

    ``wake_difference`` is the largest, some steps after all were woken; ``hit_difference`` the mean, as long after the
    topmost body of each world was thrown onto the others.
    """
    sims = [simulation(handed, config), simulation(handed, dataclasses.replace(config, sleep=True))]
    found = {}
    for key in ("wake_difference", "hit_difference"):
        for sim in sims:
            sim.reset()
            sim.run(SETTLE, DT)
        still, slept = sims
        for name in ("position", "angle", "velocity", "angular_velocity"):
            slept.state.assign(name, still.state.numpy(name))  # from the same places: piles creep
        slept.sleep()
        slept.run(SETTLE, DT)
        for sim in sims:
            if key == "hit_difference":
                throw(sim)
            elif sim is slept:
                sim.wake()
            sim.run(AFTER, DT)
        gone = np.linalg.norm(still.state.numpy("position") - slept.state.numpy("position"), axis=1)[dynamic(still)]
        found[key] = 1e3 * float(gone.max() if key == "wake_difference" else gone.mean())
    return found


def throw(sim: dc.Simulation) -> None:
    """Throw the topmost dynamic body of each world down."""
    height = np.where(dynamic(sim), sim.state.numpy("position")[:, 1], -np.inf)
    start = sim.model.numpy("body_start")
    for first, last in itertools.pairwise(start):
        sim.state.numpy("velocity")[first + height[first:last].argmax()] = (0.0, -SPEED)


def report(values: dict[str, Any]) -> str:
    """A table for people."""
    rows = [
        (
            name,
            f"{found['bodies']}",
            f"{found['asleep_us']:.2f}",
            f"{found['asleep_step_us']:.1f}",
            f"{found['awake_slowdown']:.3f}",
            found["half_share"],
            f"{found['wake_difference']:.4f}",
            f"{found['hit_difference']:.4f}",
        )
        for name, found in values["scenes"].items()
    ]
    head = ("scene", "bodies", "asleep: run [us]", "step() [us]", "awake, on over off", "half asleep over awake")
    return timing.table((*head, "woken [mm]", "hit [mm]"), rows)
