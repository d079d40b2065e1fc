"""Ctrl-C and SIGTERM in every command: the exit code, one line on stderr, one of JSON on stdout, and what is kept."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import dc_kernels as dc
from pipeline.cli import main
from pipeline.process import PATIENCE, interruptible

ROOT = Path(__file__).resolve().parents[2]
SMALL = "--bodies 3 --steps 40"
COMMANDS = {
    "simulate": f"simulate thesis {SMALL} --out {{}}",
    "generate": f"generate thesis {SMALL} --worlds 4 --shard-worlds 1 --threads 1 --out {{}}",
    "protocol": f"protocol --worlds 1 {SMALL} --starts none builtin bad --accelerations none --out {{}}",
    "evaluate": f"evaluate --worlds 1 {SMALL} --starts none builtin --loops closed --out {{}}",
    "demo": f"demo --worlds 1 {SMALL} --out {{}}",
    "fclib export": "fclib export thesis --bodies 3 --step 30:40 --out {}/{{step}}.hdf5",
}
KEPT = {
    "simulate": ("trajectory.h5", "summary.json"),
    "generate": ("shard-00000.h5",),
    "protocol": ("protocol.json", "protocol.png"),
    "evaluate": ("evaluate.json",),
    "demo": ("protocol.json",),
    "fclib export": ("30.hdf5",),
}


@pytest.fixture(autouse=True)
def heeded():
    """Ctrl-C interrupts here, and in processes started here, also where tests run in the background of a shell."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def after_collides(monkeypatch, count, number):
    """Send this process a signal at a collide so many calls on."""
    collide, calls = dc.Simulation.collide, []

    def signalled(sim, dt):
        calls.append(dt)
        if len(calls) == count:
            signal.raise_signal(number)
        return collide(sim, dt)

    monkeypatch.setattr(dc.Simulation, "collide", signalled)


@pytest.mark.parametrize(
    ("command", "number"), [*((command, signal.SIGINT) for command in COMMANDS), ("simulate", signal.SIGTERM)]
)
def test_a_signal_ends_a_command_with_what_is_done_kept(command, number, tmp_path, monkeypatch, capsys):
    after_collides(monkeypatch, {"fclib export": 35, "simulate": 20}.get(command, 60), number)
    before = [signal.getsignal(each) for each in (signal.SIGINT, signal.SIGTERM)]
    with pytest.raises(SystemExit) as stopped:
        main([*COMMANDS[command].format(tmp_path).split(), "--json"])
    assert [signal.getsignal(each) for each in (signal.SIGINT, signal.SIGTERM)] == before
    assert stopped.value.code == 128 + number
    output = capsys.readouterr()
    assert output.err == f"deep-contact: {'interrupted' if number == signal.SIGINT else 'terminated'}\n"
    assert json.loads(output.out)["complete"] is False
    for name in KEPT[command]:
        assert (tmp_path / name).stat().st_size > 100
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".") or path.suffix == ".partial"]


ENDLESS = "--bodies 3 --min-sweeps 2000000000 --max-sweeps 2000000000"


@pytest.mark.parametrize(
    ("number", "options"),
    [
        (signal.SIGINT, f"simulate thesis {ENDLESS}"),
        (signal.SIGTERM, f"generate thesis {ENDLESS} --label-sweeps 2000000000 --shard-worlds 2 --threads 2"),
    ],
)
def test_a_signal_in_a_solve_of_hours_ends_the_process(number, options, tmp_path):
    """From outside: the process is at work in one launch when it is signalled."""
    command = [sys.executable, "-m", "pipeline", *options.split(), "--json", "--out", str(tmp_path)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    process = subprocess.Popen(command, cwd=ROOT, text=True, **pipes)
    try:
        end = time.monotonic() + 200.0
        while not list(tmp_path.iterdir()) and process.poll() is None and time.monotonic() < end:
            time.sleep(0.02)
        time.sleep(1.0)
        process.send_signal(number)
        out, err = process.communicate(timeout=200.0)
    finally:
        process.kill()
    assert process.returncode == 128 + number, err
    lines = [line for line in err.splitlines() if "CUDA" not in line]
    assert lines == [f"deep-contact: {'interrupted' if number == signal.SIGINT else 'terminated'}"]
    summary = json.loads(out)
    assert summary["complete"] is False
    assert summary.get("worlds_made", 0) == 0
    assert (tmp_path / "trajectory.h5").exists() or "generate" in options


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_libraries_are_loaded_is_one_line(number):
    process = subprocess.Popen(
        [sys.executable, "-c", SLOW_IMPORT], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout is not None and process.stdout.readline() == "loading\n"
    process.send_signal(number)
    out, err = process.communicate(timeout=200.0)
    assert (process.returncode, out) == (128 + number, "")
    assert err == f"deep-contact: {'interrupted' if number == signal.SIGINT else 'terminated'}\n"


SLOW_IMPORT = """
import sys, time
class Slow:
    def find_spec(self, name, path=None, target=None):
        if name == "pipeline.cli":
            print("loading", flush=True)
            time.sleep(250.0)
sys.meta_path.insert(0, Slow())
from pipeline.__main__ import main
main()
"""


def test_what_is_urgent_is_interrupted_late_and_nothing_else():
    began = time.perf_counter()
    with interruptible() as stop:
        signal.raise_signal(signal.SIGINT)
        assert stop.is_set()
        stop._timer.join()  # the reminder comes here, where nothing is urgent
        with stop.urgent():
            pass
    with pytest.raises(KeyboardInterrupt), interruptible() as stop, stop.urgent():
        began = time.perf_counter()
        signal.raise_signal(signal.SIGINT)
        time.sleep(60.0)
    assert PATIENCE <= time.perf_counter() - began < 30.0  # well before it would end by itself, on a busy machine too
    with pytest.raises(KeyboardInterrupt), interruptible():
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)  # a second Ctrl-C


def test_json_stands_alone_on_stdout_whatever_a_plugin_prints(tmp_path, capsys):
    plugin = tmp_path / "plugin.py"
    plugin.write_text("print('a plugin')\n")
    assert main(["explain", "stack", "--json", "--plugin", str(plugin)]) == 0
    output = capsys.readouterr()
    assert json.loads(output.out)["scene"] == "stack"
    assert "a plugin" in output.err


def test_a_flag_is_shown_by_its_name(tmp_path, capsys, monkeypatch):
    collide = dc.Simulation.collide

    def spoiled(sim, dt):
        if sim.state.numpy("time")[0] > 0.05:
            sim.state.numpy("velocity")[-1] = np.nan
        return collide(sim, dt)

    monkeypatch.setattr(dc.Simulation, "collide", spoiled)
    assert main(f"simulate thesis --bodies 2 --steps 10 --out {tmp_path}".split()) == 0
    assert "world 0 stopped: NONFINITE" in capsys.readouterr().out
    assert json.loads((tmp_path / "summary.json").read_text())["flagged_worlds"] == {"0": "NONFINITE"}
