"""Data sets from a Dask cluster: a real one of two worker processes, of which one is killed in mid-run."""

from __future__ import annotations

import os
import signal
import threading
import time
from pathlib import Path

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
    scene=Thesis(bodies=40), options=GenerateOptions(worlds=3 * SHARDS, seed=5, steps=150, dt=0.01, shard_worlds=3)
)


def test_a_killed_worker_loses_and_doubles_nothing(tmp_path):
    """SIGKILL for the process of a worker that is at a shard."""
    killed: list[int] = []

    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, worker_dashboard_address=None
        ) as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
    ):
        processes = client.run(os.getpid)
        assert len(set(processes.values()) - {os.getpid()}) == 2

        def kill() -> None:
            """Once something is finished, whoever works on what is not."""
            while not list(tmp_path.glob("shard-*.h5")):
                time.sleep(0.005)
            while not killed:
                busy = [address for address, tasks in client.processing().items() if tasks]
                if busy:
                    killed.append(processes[busy[0]])
                    os.kill(killed[0], signal.SIGKILL)

        thread = threading.Thread(target=kill, daemon=True)
        thread.start()
        summary = generate(RECIPE, tmp_path, scheduler=cluster.scheduler_address, progress=False)
        thread.join(10)
        assert killed and killed[0] not in client.run(os.getpid).values()
    assert summary["complete"] and summary["worlds_made"] == 3 * SHARDS
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        layout.INDEX,
        *(layout.shard_path(tmp_path, n).name for n in range(SHARDS)),
    ]
    with h5py.File(tmp_path / layout.INDEX) as file:
        assert file["world/seed"][...].tolist() == list(range(5, 5 + 3 * SHARDS))
        assert file["motion/angle"].shape == (3 * SHARDS * 150 * 41,)
    for number in range(SHARDS):
        image = layout.shard_path(tmp_path, number).read_bytes()
        assert image == bytes(make_shard(RECIPE, number)), "a worker's shard differs from that of a thread"


def test_a_scheduler_that_is_not_there_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(generation, "CONNECT", 1)
    with pytest.raises(OSError, match=r"tcp://127\.0\.0\.1:9"):
        generate(RECIPE, tmp_path, scheduler="tcp://127.0.0.1:9", progress=False)
    assert not list(tmp_path.glob("*.h5"))


def test_a_bad_address_is_named(tmp_path: Path):
    with pytest.raises(ValueError, match="nowhere"):
        generate(RECIPE, tmp_path, scheduler="nowhere", progress=False)
