"""The program that kernels run in: the user's own beside it, threads, forks, and what is compiled how."""

import os
import subprocess
import sys
from types import SimpleNamespace

import pytest

pytest.importorskip("dc_kernels._taichi.runtime.compiler", exc_type=ImportError)

from dc_kernels._taichi.runtime import compiler, program

PACKAGES = [name for name in compiler.PACKAGES if compiler.importlib.util.find_spec(name)]
KERNEL = """
import os, sys, threading
import numpy as np
from types import SimpleNamespace
from dc_kernels.runtime.backends import bind, make_kernels
def launch(threads=1, worlds=40):
    model = SimpleNamespace(body_start=np.arange(worlds + 1, dtype=np.int32))
    state = SimpleNamespace(flags=np.zeros(worlds, np.int32))
    raw = np.zeros(8 * worlds + 8, np.float64)
    raw = raw[-raw.ctypes.data % 64 // 8 :][: 8 * worlds].reshape(2, worlds, 4)
    motion = SimpleNamespace(step_dt=np.full(worlds, 0.1), solved=raw[0], displacement=raw[1])
    motion.solved[:] = 3.0
    values = dict(launch=SimpleNamespace(world_offset=0), model=model, state=state, motion=motion, threads=threads)
    return bind(make_kernels("taichi", "solve.integrate", "float64")["displace"], worlds, values, "cpu"), motion
def check(made):
    made[1].displacement[:] = 0.0
    made[0]()
    assert (made[1].displacement[:, 0] == 0.1 * 3.0).all()
"""
BESIDE = """
import {package} as ti
ti.init(arch=ti.cpu, default_fp=ti.f32, fast_math=True, log_level=ti.ERROR)
field = ti.field(ti.f32, 4)
@ti.kernel
def fill():
    for i in field:
        field[i] = 0.1 * i
fill()
from dc_kernels._taichi.runtime.program import OPTIONS, running
options = [*OPTIONS, "default_fp", "default_ip"]
before = [str(getattr(running().config(), name)) for name in options]
made = launch()
check(made)
assert [str(getattr(running().config(), name)) for name in options] == before
assert before[0] == "True" != OPTIONS["fast_math"]
fill()
assert field.to_numpy()[3] == np.float32(0.1) * np.float32(3)
ti.init(arch=ti.cpu, log_level=ti.ERROR)  # all that was compiled is gone
check(made)
ti.reset()
check(made)
print("done")
"""
SUBNORMAL = """
def product():
    return float(np.float32(1e-30) * np.float32(1e-10))
assert product() > 0.0
made = launch()  # the program is started here
assert product() > 0.0
for made in (made, launch(threads=2)):
    made[1].solved[:] = 1e-310
    made[0]()
    assert (made[1].displacement[:, 0] == 0.1 * 1e-310).all()
assert product() > 0.0
print("done")
"""
THREADS = """
made = launch(threads=2)  # the program is started here
check(made)
def elsewhere():
    check(made)
    check(launch(worlds=41))  # and compiled again on another thread
    ran.append(1)
ran = []
threads = [threading.Thread(target=elsewhere) for _ in range(2)]
[thread.start() for thread in threads]
[thread.join() for thread in threads]
assert ran == [1, 1]
child = os.fork()
if not child:
    check(launch(threads=2))  # the threads are the parent's: this process works alone
    check(launch(worlds=50))
    check(made)
    os._exit(7)
for _ in range(1000):
    done, status = os.waitpid(child, os.WNOHANG)
    if done:
        break
    threading.Event().wait(0.1)
else:
    os.kill(child, 9)
    raise SystemExit("the child hangs")
assert os.waitstatus_to_exitcode(status) == 7, status
print("done")
"""
LATE = """
import {package} as ti
thread = threading.Thread(target=lambda: ti.init(arch=ti.cpu, log_level=ti.CRITICAL))
thread.start()
thread.join()
try:
    launch()
except RuntimeError as error:
    print(error)
"""


def run(path, code, package="taichi"):
    """What a process of its own prints; the compilers read sources from files."""
    path.write_text(KERNEL + code.replace("{package}", package))
    environment = {**os.environ, compiler.VARIABLE: package, "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run([sys.executable, str(path)], capture_output=True, text=True, env=environment, timeout=280)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


@pytest.mark.parametrize("package", PACKAGES)
def test_a_users_program_goes_on_beside(tmp_path, package):
    assert run(tmp_path / "beside.py", BESIDE, package).endswith("done\n")


def test_threads_and_forks(tmp_path):
    assert run(tmp_path / "threads.py", THREADS) == "done\n"  # and no banner


@pytest.mark.parametrize("package", PACKAGES)
def test_subnormal_numbers_are_kept(tmp_path, package):
    assert run(tmp_path / "subnormal.py", SUBNORMAL, package).endswith("done\n")


def test_a_program_of_another_thread_is_named(tmp_path):
    assert "taichi.init was called on another thread than MainThread" in run(tmp_path / "late.py", LATE)


def test_a_program_on_another_device_is_refused(monkeypatch):
    other = SimpleNamespace(config=lambda: SimpleNamespace(arch=SimpleNamespace(name="cuda")))
    monkeypatch.setattr(program, "running", lambda: other)
    with pytest.raises(RuntimeError, match="taichi runs on cuda; backend='taichi' needs"):
        program.program()


@pytest.mark.parametrize(("value", "error"), [("warp", ValueError), ("quadrants", ImportError)])
def test_the_package_is_named_by_the_environment(monkeypatch, value, error):
    monkeypatch.setenv(compiler.VARIABLE, value)
    monkeypatch.setattr(compiler.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(error, match=value):
        compiler.package()
