"""Data sets from a Dask cluster: a real one of two worker processes, of which one is killed in mid-run."""

from __future__ import annotations

import os
import signal
import threading
import time
from pathlib import Path
from typing import Any

import h5py
import pytest

distributed = pytest.importorskip("distributed")

from pipeline.data import generate as generation  # noqa: E402
from pipeline.data import layout  # noqa: E402
from pipeline.data.generate import generate  # noqa: E402
from pipeline.data.recipe import GenerateOptions, Recipe  # noqa: E402
from pipeline.data.recorder import make_shard  # noqa: E402
from pipeline.scenes import Thesis  # noqa: E402

SHARDS = 8
RECIPE = Recipe(
    scene=Thesis(bodies=20), options=GenerateOptions(worlds=3 * SHARDS, seed=5, steps=60, dt=0.01, shard_worlds=3)
)


def test_a_killed_worker_loses_and_doubles_nothing(tmp_path):
    """SIGKILL for the process of a worker that is at a shard: from the third on both wait there until it was sent."""
    killed: list[int] = []
    out, go = tmp_path / "out", tmp_path / "go"

    def hold(go: Path) -> None:
        from pipeline.data import generate as generation

        def held(recipe: Recipe, number: int, **options: Any) -> memoryview:
            while number > 1 and not go.exists():
                time.sleep(0.01)
            return make_shard(recipe, number, **options)

        generation.make_shard = held  # type: ignore[attr-defined]

    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, worker_dashboard_address=None
        ) as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
    ):
        processes = client.run(os.getpid)
        assert len(set(processes.values()) - {os.getpid()}) == 2
        client.run(hold, go)

        def kill() -> None:
            """Once something is finished, whoever works on what is not."""
            while not list(out.glob("shard-*.h5")):
                time.sleep(0.005)
            busy = [address for address, tasks in client.processing().items() if tasks]
            os.kill(processes[busy[0]], signal.SIGKILL)
            killed.append(processes[busy[0]])
            go.touch()

        thread = threading.Thread(target=kill, daemon=True)
        thread.start()
        summary = generate(RECIPE, out, scheduler=cluster.scheduler_address, progress=False)
        thread.join(100)
        assert killed and killed[0] not in client.run(os.getpid).values()
    assert summary["complete"] and summary["worlds_made"] == 3 * SHARDS
    assert sorted(path.name for path in out.iterdir()) == [
        layout.INDEX,
        *(layout.shard_path(out, n).name for n in range(SHARDS)),
    ]
    with h5py.File(out / layout.INDEX) as file:
        assert file["world/seed"][...].tolist() == list(range(5, 5 + 3 * SHARDS))
        assert file["motion/angle"].shape == (3 * SHARDS * 60 * 21,)
    for number in range(SHARDS):
        image = layout.shard_path(out, number).read_bytes()
        assert image == bytes(make_shard(RECIPE, number)), "a worker's shard differs from that of a thread"


def test_a_scheduler_that_is_not_there_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(generation, "CONNECT", 1)
    with pytest.raises(OSError, match=r"tcp://127\.0\.0\.1:9"):
        generate(RECIPE, tmp_path, scheduler="tcp://127.0.0.1:9", progress=False)
    assert not list(tmp_path.glob("*.h5"))


def test_a_bad_address_is_named(tmp_path: Path):
    with pytest.raises(ValueError, match="nowhere"):
        generate(RECIPE, tmp_path, scheduler="nowhere", progress=False)
