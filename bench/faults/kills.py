"""Kills: ``generate``, ``simulate`` and ``train`` end by SIGKILL at random times, again and again, until they complete.

What was complete before a kill has to be there after it, whole; and what is complete in the end has to be what a run
gives that nobody killed.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bench.faults.common import CORES, ROOT, Ended, environment, run

SECONDS = 180.0  # for a run that nobody kills
WORK = 1.5  # kills fall within so many seconds after the first file of a run has changed [s]
GENERATE = "generate thesis --bodies 20 --worlds 24 --steps 60 --shard-worlds 2 --threads 1 --label-sweeps 200 --json"
SIMULATE = "simulate thesis --bodies 30 --steps 300 --json"
TRAIN = (
    "train pressure --width 0.25 --nodes 17 --stride 4 --batch-size 8 --epochs 4 --log-every 1 --save-every 2 --json"
)


class Victim(NamedTuple):
    """A command that is killed."""

    name: str
    """Of the command."""
    arguments: Callable[[Path, Path], list[str]]
    """Of the run that goes on in a folder, beside a folder of data."""
    complete: Callable[[Path], dict[str, Any]]
    """What a folder holds that is complete, by name; raises for what has its final name and is not whole."""
    same: Callable[[Any, Any], bool]
    """Whether two values of one name, of a later and an earlier look, lose nothing."""
    wrong: Callable[[dict[str, Any], dict[str, Any]], list[str]]
    """What of a folder differs from that of a whole run, before all is complete."""
    kills: int
    """In the full form."""
    quick: int
    """In the quick form."""


def shards(folder: Path) -> dict[str, Any]:
    """The shards of a data set, each of them checked, and its index."""
    from pipeline.data.layout import INDEX
    from pipeline.data.shards import check_shard, config_of, opened

    found: dict[str, Any] = {}
    for path in sorted(folder.glob("shard-*.h5")):
        with opened(path) as file:
            config, seed, worlds = config_of(file), int(file.attrs["seed"]), int(file.attrs["worlds"])
        check_shard(path, config, seed, worlds)
        found[path.name] = path.read_bytes()
    if (folder / INDEX).exists():
        with opened(folder / INDEX) as file:
            found[INDEX] = file["contact/impulse"][...].tobytes()
    return found


def trajectory(folder: Path) -> dict[str, Any]:
    """What the run's files hold: every dataset of the trajectory, and the summary."""
    import h5py

    def arrays(path: Path) -> dict[str, np.ndarray]:
        read: dict[str, np.ndarray] = {}
        with h5py.File(path, "r") as file:
            file.visititems(lambda name, node: read.update({name: node[...]}) if hasattr(node, "shape") else None)
            read["complete"] = np.array(bool(file.attrs["complete"]))
        return read

    found: dict[str, Any] = {path.name: arrays(path) for path in folder.glob(".trajectory.*.h5")}
    if (folder / "trajectory.h5").exists():
        found["trajectory.h5"] = arrays(folder / "trajectory.h5")
    if (folder / "summary.json").exists():
        found["steps"] = np.array(json.loads((folder / "summary.json").read_text())["steps"])
    return found


def frames_differ(found: dict[str, Any], reference: dict[str, Any]) -> list[str]:
    """What a killed run left: its frames and steps have to be the first ones of a whole run."""
    whole = reference["trajectory.h5"]
    return [
        f"{name}: {dataset} is not what a whole run begins with"
        for name, arrays in found.items()
        if name.startswith(".")
        for dataset, values in arrays.items()
        if dataset != "complete" and not equal(values, whole[dataset][: len(values)])
    ]


def trained(folder: Path) -> dict[str, Any]:
    """Networks and training of a folder, with the steps that they have come to, and the steps logged."""
    import safetensors.numpy

    found: dict[str, Any] = {}
    for name in ("best", "last", "training"):
        path = folder / f"{name}.safetensors"
        if path.exists():
            found[name] = safetensors.numpy.load_file(path)
    if "training" in found:
        with safetensors.safe_open(folder / "training.safetensors", framework="np") as file:
            found["step"] = json.loads(file.metadata()["state"])["progress"]["step"]
        rows = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines() if line.endswith("}")]
        found["logged"] = sorted({row["step"] for row in rows if row["step"] <= found["step"]})
    return found


def never_less(later: Any, earlier: Any) -> bool:
    """Whether steps did not fall, and no logged one is gone; weights may have changed."""
    if isinstance(earlier, int):
        return bool(later >= earlier)
    return set(later) >= set(earlier)


def nothing(found: dict[str, Any], reference: dict[str, Any]) -> list[str]:
    """Nothing is compared before all is complete."""
    return []


def equal(one: Any, other: Any) -> bool:
    """Whether two values have the same bits, whatever holds them."""
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(equal(one[key], other[key]) for key in one)
    if isinstance(one, np.ndarray):
        return one.shape == other.shape and one.tobytes() == other.tobytes()
    return bool(one == other)


def training(out: Path, data: Path) -> list[str]:
    """A training that goes on where the folder holds one."""
    resume = ["--resume"] if (out / "training.safetensors").exists() else []
    return [*TRAIN.split(), "--data", str(data), "--out", str(out), *resume]


VICTIMS = (
    Victim("generate", lambda out, data: [*GENERATE.split(), "--out", str(out)], shards, equal, nothing, 22, 2),
    Victim(
        "simulate", lambda out, data: [*SIMULATE.split(), "--out", str(out)], trajectory, equal, frames_differ, 14, 1
    ),
    Victim("train", training, trained, never_less, nothing, 16, 0),
)


def command(arguments: list[str]) -> list[str]:
    """The command line as Python starts it."""
    return ["-m", "pipeline.cli", *arguments]


def kill(victim: Victim, out: Path, data: Path, rng: np.random.Generator) -> bool:
    """Start a run and kill it; False where it had ended before.

    Raises:
        RuntimeError: where it had failed.
    """
    before = stamp(out)
    with tempfile.TemporaryFile("w+") as error:
        process = subprocess.Popen(
            [sys.executable, *command(victim.arguments(out, data))],
            stdout=subprocess.DEVNULL,
            stderr=error,
            cwd=ROOT,
            env=environment(),
            start_new_session=True,
        )
        try:
            until = time.monotonic() + SECONDS
            while stamp(out) == before and process.poll() is None and time.monotonic() < until:
                time.sleep(0.005)
            time.sleep(float(rng.uniform(0.0, WORK)))
        finally:
            killed = process.poll() is None
            if killed:
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        if not killed and process.returncode != 0:
            error.seek(0)
            raise RuntimeError(f"it ended with {process.returncode}: {error.read()[-500:]}")
    return killed


def stamp(folder: Path) -> list[tuple[str, int, int]]:
    """What tells whether anything in a folder has changed."""
    found = []
    for path in sorted(folder.glob("**/*")):
        try:
            status = path.stat()
        except FileNotFoundError:
            continue
        found.append((str(path), status.st_mtime_ns, status.st_size))
    return found


def torment(victim: Victim, folder: Path, data: Path, kills: int) -> tuple[int, list[str]]:
    """Kill a command so often, and let it end; how many kills there were, and what was lost."""
    rng = np.random.default_rng(len(victim.name))
    finish(victim, folder / "whole", data)
    reference, done, attempt = victim.complete(folder / "whole"), 0, 0
    lost: list[str] = []
    while done < kills:
        out = folder / f"{attempt}"
        attempt += 1
        known: dict[str, Any] = {}
        while done < kills:
            try:
                killed = kill(victim, out, data, rng)
                done += killed
                found = victim.complete(out)
            except Exception as error:  # whatever it is: it does not go on, or what has its final name is not whole
                return done, [*lost, f"{victim.name}, kill {done}: {type(error).__name__}: {error}"]
            gone = [name for name, value in known.items() if name not in found or not victim.same(found[name], value)]
            lost += [f"{victim.name}, kill {done}: {name} is gone" for name in gone]
            lost += [f"{victim.name}, kill {done}: {text}" for text in victim.wrong(found, reference)]
            known = found
            if not killed:
                break
        if done >= kills:
            finish(victim, out, data)
            known = victim.complete(out)
        lost += [
            f"{victim.name}: {name} differs from that of a run without a kill"
            for name, value in reference.items()
            if name not in known or not equal(known[name], value)
        ]
    return done, lost


def finish(victim: Victim, out: Path, data: Path) -> Ended:
    """Let a run end.

    Raises:
        RuntimeError: where it fails.
    """
    ended = run(command(victim.arguments(out, data)), SECONDS)
    if ended.code != 0:
        raise RuntimeError(f"{victim.name} ended with {ended.code}: {ended.error[-500:]}")
    return ended


def measure(quick: bool) -> dict[str, Any]:
    """Count kills and what they lost; ``kill_faults`` says what."""
    wanted = [(victim, victim.quick if quick else victim.kills) for victim in VICTIMS]
    with tempfile.TemporaryDirectory() as name, ThreadPoolExecutor(CORES) as pool:
        folder = Path(name)
        if not quick:
            finish(VICTIMS[0], folder / "data", folder)
        runs = [
            pool.submit(torment, victim, folder / victim.name, folder / "data", count)
            for victim, count in wanted
            if count
        ]
        ended = [one.result() for one in runs]
    faults = [text for _, lost in ended for text in lost]
    return {"kills": sum(count for count, _ in ended), "lost": len(faults), "kill_faults": faults}
