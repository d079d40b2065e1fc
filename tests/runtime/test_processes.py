"""Processes: forked, spawned and served children work, and say what is wrong when kernels cannot be kept."""

from __future__ import annotations

import multiprocessing
import os
import pty
import subprocess
import sys

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels.runtime import threads

GRID = dc.Grid(rows=61, columns=61, spacing=0.25)
POINTS = np.random.default_rng(0).uniform(0.0, 15.0, (200, 2)).astype(np.float32)
BUILD = """
import dc_kernels as dc
builder = dc.ModelBuilder()
for _ in range(2):
    builder.add_world()
    builder.add_discs([(0, 0), (2, 0)], 0.5)
"""
STEP = BUILD + "dc.Simulation(*builder.finalize()).run(3, 0.01)\nprint('stepped')"
FORK = (
    BUILD
    + """
import multiprocessing
from dc_kernels.runtime import stepping
stepping.WORTH_THREADS = 0
sim = dc.Simulation(*builder.finalize(), threads=2)
sim.step(0.01)  # starts the pool's threads
child = multiprocessing.get_context("fork").Process(target=lambda: (sim.step(0.01), print("stepped", flush=True)))
child.start()
child.join(100.0)
hangs = child.is_alive()
child.kill()
assert not hangs and child.exitcode == 0, (hangs, child.exitcode)
"""
)
FORK_AT_WORK = (
    BUILD
    + """
import os, threading, time
from dc_kernels.runtime.building import building
sim = dc.Simulation(*builder.finalize())
sim.step(0.01)
def make():
    with building():
        made.set()
        time.sleep(0.3)
made = threading.Event()
threading.Thread(target=make).start()
made.wait()
child = os.fork()
if not child:
    builder.finalize("float64")
    with building():
        dc.Simulation(*builder.finalize()).step(0.01)
    os._exit(7)
for _ in range(1000):
    done, status = os.waitpid(child, os.WNOHANG)
    if done:
        break
    time.sleep(0.1)
else:
    os.kill(child, 9)
assert os.waitstatus_to_exitcode(status) == 7
print("stepped")
"""
)


def splat(threads=2):
    """Onto two worlds; at the top of the module, where other processes find it."""
    return dc.splat(POINTS, POINTS, GRID, start=[0, 100, 200], threads=threads)


def run(code, **environment):
    """A new Python process; its environment changed, None taking a variable away."""
    changed = {**os.environ, **environment}
    changed = {name: value for name, value in changed.items() if value is not None}
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=280, env=changed
    )


@pytest.mark.parametrize("code", [FORK, FORK_AT_WORK])
def test_a_forked_child_steps_whatever_the_parents_threads_do(code):
    """The child has no threads but its own, nor the lock of one that was making kernels."""
    found = run(code)
    assert found.returncode == 0, found.stderr
    assert found.stdout == "stepped\n"


@pytest.mark.parametrize("method", ["spawn", "forkserver"])
def test_a_child_that_starts_anew_has_the_same_bits(method):
    with multiprocessing.get_context(method).Pool(1) as pool:
        found = pool.apply_async(splat).get(280.0)
    np.testing.assert_array_equal(found, splat(1))


def test_workers_of_a_data_loader_splat_after_the_parent_did():
    data = pytest.importorskip("torch").utils.data
    assert threads.thread_pool(1) and splat().any()

    class Splats(data.Dataset):
        def __len__(self):
            return 3

        def __getitem__(self, index):
            return splat()

    loader = data.DataLoader(Splats(), num_workers=1, timeout=280, multiprocessing_context="fork")
    images = np.concatenate([batch.numpy() for batch in loader])
    np.testing.assert_array_equal(images, np.stack(3 * [splat(1)]))


@pytest.mark.parametrize("where", ["home", "cache"])
def test_a_cache_that_cannot_be_written_is_named(tmp_path, where):
    file = tmp_path / "file"
    file.touch()
    nowhere = str(file / "folder")
    if where == "home":
        found = run(STEP, HOME=nowhere, XDG_CACHE_HOME=None, WARP_CACHE_PATH=None)
    else:
        found = run(STEP, WARP_CACHE_PATH=nowhere)
    assert found.returncode == 1
    last = found.stderr.strip().splitlines()[-1]
    assert last.startswith("OSError: Warp cannot write its compiled kernels to ")
    assert nowhere in last and "WARP_CACHE_PATH" in last


def test_nothing_of_warp_is_printed_on_the_output():
    assert run(STEP).stdout == "stepped\n"


def terminal(code):
    """What a new process writes on the terminal that its error stream is."""
    reader, writer = pty.openpty()
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=writer) as process:
        os.close(writer)
        shown = b""
        while True:
            try:
                part = os.read(reader, 4096)
            except OSError:  # the other end was closed
                break
            if not part:
                break
            shown += part
        os.close(reader)
        assert process.wait(280.0) == 0
        assert process.stdout.read() == b"stepped\n"
    return shown.decode()


def test_loading_shows_one_line_on_a_terminal_and_none_where_warp_is_quiet():
    shown = terminal(STEP)
    assert "\r\x1b[Kloading kernels: broadphase.float32" in shown
    assert shown.count("\n") <= 1  # one of Warp on a missing driver
    assert shown.endswith("\r\x1b[K")
    quiet = terminal("import warp as wp\nwp.config.log_level = wp.LOG_WARNING\n" + STEP)
    assert "loading" not in quiet
