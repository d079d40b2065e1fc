"""Scenes of games beside the engines of games: what a step takes, and how well bodies hold still in it.

All engines get the same bodies with the same velocities, and none any impulse of before. In scenes at rest each
settles by itself first. Rounds of steps are timed in turn.
"""

from __future__ import annotations

import functools
import importlib.util
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

import dc_kernels as dc
from bench import timing
from bench.cases import DT
from bench.games import program
from bench.games.engines import PEERS, Engine, Foreign, Handed, Ours, Peer
from bench.games.rows import ROWS, Row, hand_over
from bench.peers.gauge import Gauge
from dc_kernels.model.config import PRESETS
from dc_kernels.model.enums import BodyType
from dc_kernels.model.settings import UnknownName

SUMMARY = "steps of piles, impacts, pyramids, a tumbler and small worlds, beside pymunk, pybox2d and a program of yours"
KEYS = ("scenes", "configs", "engines")
TAKES = "SCENE ..."
THREADS = 1

ROUNDS, ROUNDS_QUICK = 7, 3
SHARE_STEPS = 10  # steps whose stages are timed one by one
CONFIGS: Mapping[str, Callable[[], dc.SolverConfig]] = {
    **{name: functools.partial(dc.SolverConfig.preset, name) for name in PRESETS},
    "sweeps_10": lambda: dc.SolverConfig(max_sweeps=10, acceleration="none"),
    "soft_4": lambda: dc.SolverConfig(method="tgs_soft", substeps=4),
}
"""Settings of ours by name: the presets, ten sweeps without acceleration, and four substeps with soft rows."""
FOREIGN = "peer"


def measure(quick: bool, *names: str, config: str = "default,sweeps_10") -> dict[str, Any]:
    """Measure the scenes of these names, without a name all (``quick``: but the large ones).

    Args:
        quick: fewer rounds.
        names: keys of ``ROWS``.
        config: keys of ``CONFIGS`` with commas between; the values of a scene are of the first.

    Raises:
        UnknownName: for what is no scene or no config.
    """
    configs = config.split(",")
    for what, given, known in (("scene", names, ROWS), ("config", configs, CONFIGS)):
        for name in given:
            if name not in known:
                raise UnknownName(f"there is no {what} {name!r}; there are: {', '.join(known)}")
    chosen = names or [name for name, row in ROWS.items() if not (quick and row.large)]
    words = program.command()
    peer = program.Program(words) if words else None
    engines = {name: f"deep-contact, {name}" for name in configs}
    engines |= {name: text for name, (_, _, text) in PEERS.items() if _installed(name)}
    try:
        if peer:
            engines[FOREIGN] = peer.name
        found = {}
        for name in chosen:
            timing.progress(name)
            found[name] = measure_row(ROWS[name], configs, peer, ROUNDS_QUICK if quick else ROUNDS)
            timing.progress(", ".join(f"{key} {of['ms']:.3g} ms" for key, of in found[name]["engines"].items()))
    finally:
        if peer:
            peer.close()
    return {"scenes": found, "configs": configs, "engines": engines}


def _installed(name: str) -> bool:
    return importlib.util.find_spec({"pybox2d": "Box2D"}.get(name, name)) is not None


def engines_of(row: Row, handed: Handed, configs: Sequence[str], peer: program.Program | None) -> dict[str, Engine]:
    """Make the engines of a row by name."""
    made: dict[str, Engine] = {
        name: Ours(handed, replace(CONFIGS[name](), sleep=row.asleep), stepwise=row.stepwise) for name in configs
    }
    worlds = min(row.peer_worlds or row.worlds, row.worlds)
    made |= {name: Peer(name, handed, worlds) for name in PEERS if _installed(name) and not row.asleep}
    if peer:
        made[FOREIGN] = Foreign(peer, handed, (("sleep", int(row.asleep)), ("threads", 1)))
    return made


def measure_row(row: Row, configs: Sequence[str], peer: program.Program | None, rounds: int) -> dict[str, Any]:
    """Measure one scene: values of each engine, and those of the first settings by themselves."""
    handed = hand_over(row)
    engines = engines_of(row, handed, configs, peer)
    times: dict[str, list[float]] = {name: [] for name in engines}
    before: dict[str, np.ndarray] = {}
    for name, engine in engines.items():
        engine.run(row.rest + 1)
        if row.anew:
            _round(row, engine)
        before[name] = engine.places()[0]
    model, state, joints = handed.exact
    gauge = Gauge(*handed.exact)
    apart: dict[str, list[np.ndarray]] = {name: [] for name in engines}
    for _ in range(rounds):
        for name, engine in engines.items():
            times[name].append(_round(row, engine) * row.worlds / engine.worlds / row.steps)
            if joints.sizes["joint"]:
                apart[name].append(gauge.separations(*engine.places()))
    found: dict[str, dict[str, Any]] = {}
    start = state.numpy("position").copy()
    for name, engine in engines.items():
        position, angle = engine.places()
        values = _held(gauge, position, angle)
        if apart[name]:
            of_all = np.concatenate(apart[name])
            values["separation_mean_mm"] = 1e3 * float(of_all.mean()) if np.isfinite(of_all).all() else None
            values["separation_max_mm"] = 1e3 * float(of_all.max()) if np.isfinite(of_all).all() else None
        if row.still:
            moves = (model.numpy("body_type") == BodyType.DYNAMIC)[: len(position)]
            gone = np.linalg.norm(position - before[name], axis=1)[moves] / (rounds * row.steps * DT)
            values["creep_mm_s"] = 1e3 * float(gone.mean())
            values["drift_mm"] = 1e3 * float(np.linalg.norm(position - start[: len(position)], axis=1)[moves].max())
        found[name] = {"ms": 1e3 * statistics.median(times[name]), **values}
        found[name]["shares"] = engine.shares(SHARE_STEPS)
    for name in configs:
        for other in (*PEERS, FOREIGN):
            if name in found and other in found:
                ratios = [a / b for a, b in zip(times[name], times[other], strict=True)]
                found[name][f"over_{other}"] = statistics.median(ratios)
    first = found.get(configs[0], {})
    return {**first, "bodies": int(model.body_count), "worlds": row.worlds, "engines": found}


def _round(row: Row, engine: Engine) -> float:
    """Take the steps of a round; what is timed of it [s]."""
    spent = engine.restart() if row.anew else 0.0
    if row.anew and row.rest:
        engine.run(row.rest)
    return engine.run(row.steps) + (spent if row.created else 0.0)


def _held(gauge: Gauge, position: np.ndarray, angle: np.ndarray) -> dict[str, float | None]:
    if not np.isfinite(position).all():
        return {"overlap_mean_mm": None, "overlap_max_mm": None}
    overlap = gauge.overlaps(position, angle)
    mean = float(overlap.mean()) if len(overlap) else 0.0
    return {"overlap_mean_mm": 1e3 * mean, "overlap_max_mm": 1e3 * float(overlap.max(initial=0.0))}


COLUMNS = ("ms", "over_peer", "over_pymunk", "over_pybox2d")
HELD = ("overlap_mean_mm", "overlap_max_mm", "creep_mm_s", "drift_mm", "separation_mean_mm", "separation_max_mm")


def report(values: dict[str, Any]) -> str:
    """Tables for people: times, what holds still, shares of the stages."""
    texts = values["engines"]
    rows, shares = [], []
    for scene, row in values["scenes"].items():
        for name, found in row["engines"].items():
            cells = (found.get(key) for key in (*COLUMNS, *HELD))
            rows.append((f"{scene}, {texts[name]}", *cells))
            parts = sorted(found["shares"].items(), key=lambda item: -item[1])
            if parts:
                told = ", ".join(f"{part} {share:.0%}" for part, share in parts if share >= 0.01)
                shares.append(f"{scene}, {texts[name]}: {told}")
    header = (
        "a step", "ms", "over peer", "over pymunk", "over pybox2d",
        "overlap mean [mm]", "max [mm]", "creep [mm/s]", "drift [mm]", "joints apart, mean [mm]", "max [mm]",
    )  # fmt: skip
    return "\n".join([timing.table(header, rows), "", *shares])
