"""Points of time and error: the Pareto front, times to an error level, lines of JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bench.error_time.solve import ERRORS, Curve, Setting

DIGITS = 3  # of a figure in the lines


def front(seconds: Sequence[float], errors: Sequence[float]) -> np.ndarray:
    """Which points are on the Pareto front: none other is as fast and as accurate, and better in one, bool (n,).

    Points that are not finite are not; of equal points all are.
    """
    time, error = np.asarray(seconds, np.float64), np.asarray(errors, np.float64)
    on = np.zeros(len(time), bool)
    finite = np.flatnonzero(np.isfinite(time) & np.isfinite(error))
    least, last = math.inf, math.inf  # error of the front so far, and the time that it was reached at
    for i in finite[np.lexsort((error[finite], time[finite]))]:
        if error[i] < least:
            least, last, on[i] = error[i], time[i], True
        elif error[i] == least and time[i] == last:
            on[i] = True
    return on


def time_to(level: float, seconds: Sequence[float], errors: Sequence[float]) -> float | None:
    """When an error stays at or below a level from then on, between the points of a curve by powers; None: never.

    Args:
        level: of the error.
        seconds: of the points, ascending.
        errors: of the points.
    """
    # what an error will be at most from here on, so that one that passes below by chance does not count
    ahead = np.maximum.accumulate(np.asarray(errors, np.float64)[::-1])[::-1]
    below = np.flatnonzero(ahead <= level)
    if not len(below):
        return None
    i = int(below[0])
    if i == 0:
        return float(seconds[0])
    share = math.log(ahead[i - 1] / level) / math.log(ahead[i - 1] / ahead[i])
    return float(seconds[i - 1] * (seconds[i] / seconds[i - 1]) ** share)


def geometric_mean(values: Iterable[float]) -> float | None:
    """Of what is finite and positive; None if nothing is."""
    logs = [math.log(value) for value in values if math.isfinite(value) and value > 0.0]
    return math.exp(sum(logs) / len(logs)) if logs else None


def mean_points(curves: Sequence[Mapping[Setting, Curve]], caps: Sequence[int]) -> list[dict[str, Any]]:
    """A point for each setting and number of sweeps: geometric means over the states, of sweeps the mean.

    Args:
        curves: of each state; an error that is NaN there (no reference) is left out of its mean.
        caps: sweeps allowed; points beyond the end of all states' curves are left out.
    """
    points = []
    for setting in curves[0]:
        longest = max(curve[setting].caps[-1] for curve in curves)
        for cap in caps:
            if cap > longest:
                break
            found = [at for at in (curve[setting].at(cap) for curve in curves) if at is not None]
            point: dict[str, Any] = {"kind": "solve", "setting": setting.label, **setting.fields(), "max_sweeps": cap}
            point["sweeps"] = float(np.mean([sweeps for _, sweeps, _ in found]))
            point["seconds"] = geometric_mean(seconds for seconds, _, _ in found)
            for name in ERRORS:
                point[name] = geometric_mean(errors[name] for _, _, errors in found)
            points.append(point)
    return points


def mark(points: Sequence[dict[str, Any]], errors: Sequence[str]) -> None:
    """Set ``front_in`` (the errors for which a point is on the front) and ``front``, where there are any."""
    for name in errors:
        values = [math.nan if point.get(name) is None else point[name] for point in points]
        for point, on in zip(points, front([point["seconds"] for point in points], values), strict=True):
            if on:
                point.setdefault("front_in", []).append(name)
                point["front"] = True


def race(curves: Sequence[Mapping[Setting, Curve]], level: float, error: str = "velocity") -> dict[str, dict[str, Any]]:
    """Time to an error level of each setting, by label: mean of the states, a missed one at the time of its last point.

    Args:
        curves: of each state; left out are those without this error, and those where no setting comes there.
        level: of the error.
        error: one of ``ERRORS``.

    Returns:
        ``seconds``; ``missed``, in how many states it never came there, and of how many, ``states``; ``over_front``,
        geometric mean over the states where it came there of its time over the fastest setting's, None where it came
        to none. The fewest missed first, then the fastest.
    """
    arrivals = []
    for state in curves:
        if not all(np.isfinite(curve.errors[error]).all() for curve in state.values()):
            continue
        times = {setting: curve.times() for setting, curve in state.items()}
        reached = {setting: time_to(level, times[setting], state[setting].errors[error]) for setting in state}
        if any(time is not None for time in reached.values()):
            arrivals.append({setting: (reached[setting], times[setting][-1]) for setting in state})
    found: dict[str, dict[str, Any]] = {}
    for setting in arrivals[0] if arrivals else ():
        pairs = [arrival[setting] for arrival in arrivals]
        seconds = float(np.mean([last if time is None else time for time, last in pairs]))
        missed = sum(time is None for time, _ in pairs)
        ratios = [
            time / min(other for other, _ in arrival.values() if other is not None)
            for arrival, (time, _) in zip(arrivals, pairs, strict=True)
            if time is not None
        ]
        found[setting.label] = {"seconds": seconds, "missed": missed, "states": len(pairs)}
        found[setting.label]["over_front"] = geometric_mean(ratios)
    return dict(sorted(found.items(), key=lambda item: (item[1]["missed"], item[1]["seconds"])))


def rounded(value: Any) -> Any:
    """A figure as a line keeps it; what is not finite is null."""
    if isinstance(value, float):
        return float(f"{value:.{DIGITS - 1}e}") if math.isfinite(value) else None
    return value


def write(points: Iterable[Mapping[str, Any]], path: Path) -> None:
    """A line for each point; the file is replaced as a whole."""
    from pipeline.files import atomic_path

    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_path(path) as target:
        lines = [
            json.dumps({name: rounded(value) for name, value in point.items()}, separators=(",", ":"))
            for point in points
        ]
        target.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
