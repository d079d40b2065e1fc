"""Settings that every test runs with."""

from __future__ import annotations

import gc
import importlib
import os
import signal
import threading
from collections import Counter
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from unittest import mock

import pytest
import warp as wp
from hypothesis import HealthCheck, settings

from dc_kernels._warp import common
from dc_kernels.runtime import stepping

wp.config.log_level = wp.LOG_WARNING
common.OPTIMIZATION["float64"] = 1  # a quarter less to compile; float32 has the level that users have
stepping.WORTH_THREADS = 0  # scenes of tests are small, and still their threads are to be tested

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN and threading.current_thread() is threading.main_thread():
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell has it ignored by what it runs in the background

# Kernels compile in the first example of a property test, so neither a deadline nor a slow start means anything.
settings.register_profile(
    "ci",
    deadline=None,
    derandomize=True,
    max_examples=40,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.register_profile("thorough", settings.get_profile("ci"), derandomize=False, max_examples=1000)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "ci"))


@pytest.fixture(autouse=True)
def wakeup_descriptor():
    """Holds each test to leave the descriptor for signals' numbers as it was, which is the process's."""
    yield
    if threading.current_thread() is threading.main_thread():
        left = signal.set_wakeup_fd(-1)
        assert left == -1, f"the test leaves signals going to descriptor {left}"


ROOT = Path(__file__).parent
TOGETHER = (
    "driving/test_population.py",
    "driving/test_population_worlds.py",
    "parity/test_taichi.py",
    "parity/test_taichi_joints.py",
    "parity/test_taichi_solve.py",
    "parity/test_taichi_steps.py",
    "solve/test_contact_calls.py",
    "solve/test_contact_inputs.py",
    "solve/test_contacts.py",
    "solve/test_own_rows.py",
    "solve/test_surfaces.py",
)
"""Files whose tests compile the same kernels of Taichi, which another process finds only when this one has ended."""
FIRST = (
    "runtime/test_ptx.py",
    "grid/test_transfer.py",
    "parity/test_parity.py",
    "project/test_extend.py",
    "pipeline/evaluate/test_evaluate.py",
    "pipeline/contactnet/test_contact_training.py",
    "pipeline/training/test_grid_training.py",
    "project/test_docs.py",
    "taichi/test_grid.py",
    "taichi/test_program.py",
    "bench/test_stability.py",
    "bench/test_stability_fuzz.py",
)
"""Few tests that take long: at the end one process would be at work on them, and the others idle."""


@pytest.fixture(autouse=True)
def taichi_as_in_whole_steps(request):
    """Compile stages for Taichi with the options of whole steps, in half the time, in the files of ``TOGETHER``."""
    if request.path.relative_to(ROOT).as_posix() not in TOGETHER or find_spec("taichi") is None:
        yield
        return
    program = importlib.import_module("dc_kernels._taichi.runtime.program")
    with mock.patch.dict(program.OPTIONS, program.OF_LARGE):
        yield


@pytest.hookimpl(wrapper=True)
def pytest_collection(session: pytest.Session) -> Any:
    """Look for no garbage while tests are collected; later seldom, and not among what is there by then."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.set_threshold(10_000)
        gc.enable()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Where several processes share the tests, put first those files that take long, then those of many tests."""
    if not hasattr(config, "workerinput"):
        return
    files = [item.nodeid.split("::", 1)[0].removeprefix("tests/") for item in items]
    count = Counter(files)
    rank = {file: i for i, file in enumerate((*TOGETHER, *FIRST))}
    place = {id(item): (rank.get(file, len(rank)), -count[file]) for item, file in zip(items, files)}
    items.sort(key=lambda item: place[id(item)])


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Give whole files to the processes in the order that they are collected in, and those ``TOGETHER`` to one."""
    if config.getvalue("dist") != "loadfile":
        return None
    from xdist.scheduler import LoadFileScheduling

    class Scheduling(LoadFileScheduling):
        def _split_scope(self, nodeid: str) -> str:
            file = super()._split_scope(nodeid)
            return "together" if file.removeprefix("tests/") in TOGETHER else file

    config.option.loadscopereorder = False
    return Scheduling(config, log)
