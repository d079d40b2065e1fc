"""The command line: what commands print and write, and what they refuse."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import dc_kernels as dc
from pipeline.cli import main
from pipeline.run.summary import describe
from pipeline.scenes import SCENES
from pipeline.starts import registry
from pipeline.starts.impulses import ImpulseStart

ROOT = Path(__file__).resolve().parents[2]
PNG = b"\x89PNG"


def last_json(text: str) -> dict:
    return json.loads(text.strip().splitlines()[-1])


def test_command_simulate(tmp_path, capsys):
    options = "--worlds 2 --steps 5 --start copy2 --acceleration sor --dtype float64 --bodies 6"
    assert main(["simulate", "settled", *options.split(), "--out", str(tmp_path), "--json"]) == 0
    summary = last_json(capsys.readouterr().out)
    assert (summary["scene"], summary["worlds"], summary["steps"]) == ("settled", 2, 5)
    assert summary == json.loads((tmp_path / "summary.json").read_text())
    assert summary["config"]["options"]["start"] == "copy2"
    assert summary["config"]["options"]["acceleration"] == "sor"
    assert summary["config"]["scene"]["bodies"] == 6
    main(["simulate", "stack", "--steps", "2", "--out", str(tmp_path)])
    assert "stack: 2 steps of 1 world(s)" in capsys.readouterr().out


def test_command_simulate_with_a_network(tmp_path, contactnet, capsys):
    options = ["settled", "--worlds", "2", "--steps", "5", "--bodies", "12", "--start", str(contactnet)]
    assert main(["simulate", *options, "--out", str(tmp_path), "--json"]) == 0
    summary = last_json(capsys.readouterr().out)
    assert summary == json.loads((tmp_path / "summary.json").read_text())
    found = summary["network"]
    assert found["solves"] == 10 and found["calls"] >= 10
    assert set(found["seconds"]) == {"solve", "splat", "network", "gather", "start"}
    assert 0.0 < sum(found["seconds"].values()) < summary["simulation_s"]
    main(["simulate", *options, "--out", str(tmp_path)])
    text = capsys.readouterr().out
    assert found["explain"] in text  # the run is the same
    assert re.search(r"wall time: solve [0-9.]+ s, splat [0-9.]+ s, network [0-9.]+ s, gather [0-9.]+ s", text)
    main(["simulate", "settled", "--steps", "1", "--bodies", "12", "--out", str(tmp_path), "--json"])
    assert "network" not in last_json(capsys.readouterr().out)


def test_networks_have_the_threads_of_the_run(tmp_path, contactnet, monkeypatch, capsys):
    from pipeline.starts.learned import LearnedSolve

    torch, seen, solve = sys.modules["torch"], [], LearnedSolve.solve
    monkeypatch.setattr(LearnedSolve, "solve", lambda *given: (seen.append(torch.get_num_threads()), solve(*given)))
    torch.set_num_threads(2)
    try:
        for command in (["simulate", "--out", str(tmp_path)], ["explain"]):
            main([command[0], "settled", "--bodies", "5", "--steps", "1", "--start", str(contactnet), *command[1:]])
        assert seen == [1, 1] and torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(1)
    capsys.readouterr()


def test_command_protocol(tmp_path, capsys):
    options = "--worlds 2 --steps 60 --bodies 5 --starts none bad --accelerations none aitken"
    assert main(["protocol", *options.split(), "--out", str(tmp_path)]) == 0
    text = capsys.readouterr().out
    for label in ("None, PGS", "Bad, PGS", "None, PGS + aitken", "Bad, PGS + aitken", "median", "<=1000"):
        assert label in text
    assert (tmp_path / "protocol.png").read_bytes()[:4] == PNG
    rows = json.loads((tmp_path / "protocol.json").read_text())["runs"]
    assert [row["start"] for row in rows] == ["none", "bad", "none", "bad"]
    assert main(["protocol", *options.split(), "--no-history", "--json", "--out", str(tmp_path)]) == 0
    assert [row["mean_sweeps"] for row in last_json(capsys.readouterr().out)["runs"]] == [
        row["mean_sweeps"] for row in rows
    ]


def test_command_demo(tmp_path, capsys):
    assert main(["demo", "--worlds", "2", "--bodies", "6", "--steps", "70", "--out", str(tmp_path)]) == 0
    assert "Copy, PGS" in capsys.readouterr().out
    for name in ("demo.png", "protocol.png", "grids.png", "world/summary.png"):
        assert (tmp_path / name).read_bytes()[:4] == PNG
    assert (tmp_path / "world" / "trajectory.h5").exists()


def test_command_explain(capsys):
    assert main(["explain", "chain", "--bodies", "3"]) == 0
    text = capsys.readouterr().out
    assert text.strip()
    main(["explain", "chain", "--bodies", "3", "--json"])
    assert last_json(capsys.readouterr().out)["explain"].strip() == text.strip()


def test_command_scenes(tmp_path, capsys, monkeypatch):
    for name in SCENES.keys() - {"thesis", "arch"}:
        monkeypatch.delitem(SCENES, name)
    main(["scenes"])
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == ["thesis", "arch"]
    main(["scenes", "--out", str(tmp_path), "--seconds", "0.05", "--json"])
    result = last_json(capsys.readouterr().out)
    assert result["scenes"]["arch"]["parameters"]["radius"] == {
        "default": 5.0,
        "meaning": "Mean radius of the arch",
        "unit": "m",
    }
    assert result["scenes"]["thesis"]["bodies"] == 100
    assert Path(result["path"]).read_bytes().startswith(b"\x89PNG")


def test_command_explain_with_a_network(capsys, contactnet):
    for steps in (0, 20):
        main(["explain", "settled", "--bodies", "12", "--start", str(contactnet), "--steps", str(steps), "--json"])
        text = last_json(capsys.readouterr().out)["explain"]
        assert "broadphase" in text and f"calls a solve, of {steps} solves" in text


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("simulate thesis --bodies 0", "thesis.bodies is 0"),
        ("simulate thesis --steps -1", "steps is -1"),
        ("simulate thesis --record-every 0", "record_every is 0"),
        ("simulate thesis --dt nan", "dt is nan"),
        ("simulate thesis --threads 0", "threads is 0"),
        ("simulate thesis --worlds 0", "worlds is 0"),
        ("simulate thesis --start best", "start is 'best'"),
        ("simulate thesis --start none.safetensors", "none.safetensors"),
        ("explain thesis --start best", "start is 'best'"),
        ("explain thesis --steps -1", "steps is -1"),
        ("simulate thesis --tolerance -1", "tolerance is -1.0"),
        ("simulate thesis --bodies 4 --steps 1 --out /dev/null/x", "Not a directory"),
        ("protocol --steps 0", "steps is 0"),
        ("explain incline --angle 2", "incline.angle is 2.0"),
    ],
)
def test_wrong_values_are_one_line_and_exit_2(arguments, message, capsys):
    with pytest.raises(SystemExit) as caught:
        main(arguments.split())
    assert caught.value.code == 2
    output = capsys.readouterr()
    assert not output.out
    lines = [line for line in output.err.splitlines() if line.startswith("deep-contact: ")]
    assert len(lines) == 1
    assert message in lines[0]
    assert "Traceback" not in output.err


def test_interrupted_protocol_is_one_line(monkeypatch, capsys, tmp_path):
    class Interrupted(ImpulseStart):
        def write(self):
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setitem(registry.STARTS, "none", lambda sim, seed: Interrupted(sim))
    with pytest.raises(SystemExit) as caught:
        main(["protocol", "--worlds", "1", "--bodies", "3", "--json", "--out", str(tmp_path)])
    assert caught.value.code == 130
    assert capsys.readouterr().err.splitlines()[-1] == "deep-contact: interrupted"


def test_missing_dependency_names_the_extra(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "tyro", None)
    with pytest.raises(SystemExit) as caught:
        main(["explain", "stack"])
    assert caught.value.code == 2
    assert "this needs tyro: in a clone of deep-contact, pip install -e '.[pipeline]'" in capsys.readouterr().err


def test_help_names_units_and_defaults():
    def text(*arguments: str) -> str:
        command = [sys.executable, "-m", "pipeline.cli", *arguments, "--help"]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, env={"COLUMNS": "100", "PATH": ""})
        assert done.returncode == 0, done.stderr
        return done.stdout

    overview = text()
    for command in ("simulate", "demo", "protocol", "explain"):
        assert command in overview
    options = text("simulate", "thesis")
    for wanted in (
        "[s]. (default: 0.01)",
        "--bodies INT",
        "(default: builtin)",
        "--max-sweeps",
        "--video",
        "[N s or 1]",
    ):
        assert wanted in options
    told = options.count("(default:") + options.count("(repeatable)")
    assert told == len(re.findall("^│ --", options, re.MULTILINE)) > 20


def test_scene_commands_have_the_scenes_names(capsys):
    with pytest.raises(SystemExit):
        main(["simulate", "--help"])
    text = capsys.readouterr().out
    for name in SCENES:
        assert f"• {name}" in text


@pytest.mark.parametrize(
    "command",
    [
        "simulate thesis --out {}",
        "demo --out {}",
        "protocol --out {}",
        "evaluate --out {}",
        "generate --out {}",
        "figures kernels --out {}",
        "train-contactnet --out {}",
        "train-stepper --out {}",
        "fclib export thesis --out {}/a.hdf5",
    ],
)
@pytest.mark.parametrize("kind", ["below a file", "a file of its name"])
def test_what_cannot_be_written_is_known_before_computing(command, kind, tmp_path, capsys, monkeypatch):
    (tmp_path / "file").write_text("not a folder")
    out = tmp_path / "file" / "out" if kind == "below a file" else tmp_path / "file"
    monkeypatch.setattr(dc.Simulation, "step", None)
    monkeypatch.setattr(dc.Simulation, "collide", None)
    with pytest.raises(SystemExit) as raised:
        main([*command.format(out).split(), "--json"])
    assert raised.value.code == 2
    text = capsys.readouterr().err.strip()
    assert len(text.splitlines()) == 1 and str(out) in text
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_a_folder_in_the_place_of_a_file_is_known_before_computing(tmp_path, capsys, monkeypatch):
    (tmp_path / "trajectory.h5").mkdir()
    monkeypatch.setattr(dc.Simulation, "step", None)
    with pytest.raises(SystemExit):
        main(["simulate", "thesis", "--out", str(tmp_path)])
    assert "trajectory.h5 is a folder, not a file" in capsys.readouterr().err


def test_a_scene_with_joints_is_refused_before_anything_is_made(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(dc.Simulation, "collide", None)
    with pytest.raises(SystemExit):
        main(["generate", "chain", "--out", str(tmp_path / "out")])
    assert capsys.readouterr().err == "deep-contact: scene chain has joints, whose impulses a data set does not hold\n"
    assert not (tmp_path / "out").exists()


def test_a_file_in_the_place_of_a_folder_of_data_is_named(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    with pytest.raises(SystemExit):
        main(["generate", "--out", str(tmp_path / "file")])
    assert "file is a file; it must be a folder" in capsys.readouterr().err


@pytest.mark.parametrize("start", ["cnnn", "folder", "index.h5"])
def test_an_unknown_start_is_told_all_there_are(start, tmp_path):
    with pytest.raises(ValueError, match=r"'none', .*'cnn', 'cnn-start'.*copyN .*ends with \.safetensors"):
        registry.maker(start)


@pytest.mark.parametrize(("seconds", "shown"), [(0.00123456, "0.00123 s of"), (12.3456, "12.35 s of")])
def test_a_short_run_tells_its_time_with_digits(seconds, shown):
    counts = ["steps", "worlds", "bodies", "mean_sweeps", "median_sweeps", "unconverged_share", "contacts_last"]
    summary = dict.fromkeys([*counts, "penetration_max_mm", "penetration_last_mean_mm"], 1)
    more = {"simulation_s": seconds, "complete": True, "scene": "stack", "flagged_worlds": {}, "out": "o", "files": []}
    text = describe({**summary, **more})
    assert shown in text and "contacts with an impulse, per world at the end: 1.0" in text


def refused(capsys, *arguments: object) -> str:
    """The one line on stderr with which a command line is refused."""
    with pytest.raises(SystemExit) as caught:
        main([str(word) for word in arguments])
    output = capsys.readouterr()
    assert caught.value.code == 2 and not output.out and len(output.err.splitlines()) == 1
    return output.err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("simulat", r"'simulat' is no command \(did you mean simulate\?\); there are simulate, .*, train-contactnet"),
        ("simulate stak", r"'stak' is no scene \(did you mean stack\?\); there are thesis, .*, chain"),
        ("fclib exprt", r"'exprt' is no action of fclib \(did you mean export\?\); there are export, solve"),
        ("fclib export stak", "'stak' is no scene"),
        (
            "simulate thesis --step 10",
            r"--step is no option of deep-contact simulate thesis \(did you mean --steps\?\)",
        ),
        ("simulate --step 10 thesis", r"--step is no option of deep-contact simulate thesis"),
        ("fclib export stack --bodis 3", r"--bodis is no option of .* fclib export stack \(did you mean --bodies\?\)"),
        ("explain stack --quite=3", r"--quite is no option of deep-contact explain stack; deep"),
        ("generate stack --ranges friction 0.2", r"--ranges: \['friction', '0.2'\] is not of .*: name, low, high"),
        ("simulate stack --bodies 20.5", "--bodies: '20.5' is no integer$"),
        ("simulate stack --dt x", "--dt: 'x' is no number$"),
        ("generate --out=", "--out is empty"),
        (
            "simulate --stepper a.safetensors",
            "--stepper is 'a.safetensors'; .* network --weights a.safetensors",
        ),
        ("explain thesis --stepper=net", r"--stepper is 'net'; it must be solver or network$"),
    ],
)
def test_a_wrong_word_is_named_with_what_there_is(arguments, message, capsys):
    assert re.search(message, refused(capsys, *arguments.split()))


def test_an_empty_value_is_no_folder(capsys):
    assert "--out is empty; it must have a value" in refused(capsys, "generate", "--out", "")


@pytest.fixture
def scene_file(tmp_path, monkeypatch) -> Path:
    """A file that registers a scene and starts, which are forgotten afterwards."""
    for table in (SCENES, registry.STARTS):
        for name in ("piled", "short", "three"):
            monkeypatch.setitem(table, name, None)  # so that it is taken out
            table.pop(name)
    path = tmp_path / "piled_scene.py"
    path.write_text(PILED)
    yield path
    sys.modules.pop("deep_contact_plugin_piled_scene", None)


PILED = '''
from dataclasses import dataclass
from typing import ClassVar

from pipeline.scenes import Stack, register
from pipeline.starts.impulses import Builtin
from pipeline.starts.registry import STARTS


@register
@dataclass(frozen=True, kw_only=True)
class OfBoxes(Stack):
    """Boxes on each other."""

    name: ClassVar[str] = "piled"
    gap: float = 3.0
    """Nothing [m]."""


STARTS["short"] = Builtin
STARTS["three"] = lambda sim, seed: 3
'''


def test_a_plugin_brings_scenes_to_every_command(scene_file, tmp_path, capsys):
    plugin, out = ["--plugin", str(scene_file)], ["--out", str(tmp_path / "out"), "--json"]
    assert main(["simulate", "piled", *plugin, "--bodies", "3", "--gap", "2", "--steps", "2", *out]) == 0
    found = last_json(capsys.readouterr().out)["config"]["scene"]
    assert (found["name"], found["bodies"], found["gap"]) == ("piled", 3, 2.0)
    assert main(["explain", f"--plugin={scene_file}", "piled"]) == 0
    (tmp_path / "a.toml").write_text('[scene]\nname = "piled"\nbodies = 4\n')
    data = ["--worlds", "1", "--steps", "1", "--out", str(tmp_path / "data"), "--json"]
    capsys.readouterr()
    assert main(["generate", *plugin, "--config", str(tmp_path / "a.toml"), *data]) == 0
    assert last_json(capsys.readouterr().out)["config"]["scene"]["bodies"] == 4


def test_plugins_are_named_with_what_they_must_give(scene_file, tmp_path, capsys):
    run = ["simulate", "piled", "--plugin", scene_file, "--steps", "1", "--out", tmp_path / "out", "--start"]
    assert "start 'short' must take a simulation and a seed" in refused(capsys, *run, "short")
    assert "start 'three' makes 3; it must have the methods solve and report" in refused(capsys, *run, "three")
    bad = tmp_path / "bad_plugin.py"
    bad.write_text("\n1 / 0\n")
    assert f"{bad}, line 2 raises ZeroDivisionError: division" in refused(capsys, "explain", "stack", "--plugin", bad)
    bad.write_text("from pipeline.scenes import Stack, register\nregister(type('Other', (Stack,), {}))\n")
    assert "must be a dataclass that derives from Scene" in refused(capsys, "explain", "stack", "--plugin", bad)


def test_a_file_and_a_command_line_agree_on_the_scene(tmp_path, capsys):
    named, nameless = tmp_path / "named.toml", tmp_path / "nameless.toml"
    named.write_text('worlds = 1\nsteps = 1\n[scene]\nname = "mixed"\nbodies = 8\n')
    nameless.write_text("worlds = 1\nsteps = 1\n[scene]\nbodies = 8\n")
    message = "scene.name is 'mixed', but 'stack' is asked for"
    assert message in refused(capsys, "generate", "stack", "--config", named)
    assert message in refused(capsys, "generate", f"--config={named}", "--out", "thesis", "stack")
    assert "it must say whose ('bodies',) are" in refused(capsys, "generate", "--config", nameless)
    for number, config in enumerate((named, nameless)):
        out = str(tmp_path / str(number))
        assert main(["generate", "mixed", "--config", str(config), "--out", out, "--friction", "0.3", "--json"]) == 0
        scene = last_json(capsys.readouterr().out)["config"]["scene"]
        assert (scene["name"], scene["bodies"], scene["friction"]) == ("mixed", 8, 0.3)
