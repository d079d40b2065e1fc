"""The worked examples of docs/extend.md: those that change the package are run on a copy of it that they have changed.

A ``python`` block that begins with the path of a file is that file. A ``diff`` block names a file and edits it: lines
that begin with a space or a minus stand there one after the other, and are replaced by those that begin with a space or
a plus. An edit ends where lines that stay or go follow lines that were added.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from dc_kernels._warp.common import OPTIMIZATION
from dc_kernels.measure import contact_slots
from pipeline.cli import main
from pipeline.networks import registry
from pipeline.scenes import SCENES

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "extend.md"
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```", re.DOTALL | re.MULTILINE)
FILE = re.compile(r"# ((?:dc_kernels|pipeline)/[\w/]+\.py)\n")
SECTIONS = {text.split("\n", 1)[0]: BLOCK.findall(text) for text in PAGE.read_text(encoding="utf-8").split("\n## ")[1:]}


def changes_package(blocks: list[tuple[str, str]]) -> bool:
    """Whether a section's example changes the package."""
    return any(language == "diff" or FILE.match(code) for language, code in blocks)


def edits(diff: str) -> tuple[str, list[tuple[str, ...]]]:
    """The file of a diff, and its edits: what stands there, what is to stand there."""
    header, *lines = diff.splitlines()
    assert header.startswith("--- "), header
    found: list[tuple[list[str], list[str]]] = []
    before = "+"
    for line in lines:
        mark, text = line[:1] or " ", line[1:]
        assert mark in " +-", line
        if before == "+" and mark != "+":
            found.append(([], []))
        if mark != "+":
            found[-1][0].append(text)
        if mark != "-":
            found[-1][1].append(text)
        before = mark
    return header.removeprefix("--- "), [
        tuple("".join(f"{text}\n" for text in part) for part in edit) for edit in found
    ]


def apply(root: Path, language: str, code: str) -> str:
    """Write a file or edit one below a folder; return code that is neither."""
    new = FILE.match(code)
    if language == "diff":
        path, changes = edits(code)
        text = (root / path).read_text(encoding="utf-8")
        for old, replacement in changes:
            assert text.count(old) == 1, f"{path} holds this {text.count(old)} times:\n{old}"
            text = text.replace(old, replacement)
        (root / path).write_text(text, encoding="utf-8")
    elif language == "python" and new:
        assert not (root / new[1]).exists(), new[1]
        (root / new[1]).parent.mkdir(parents=True, exist_ok=True)
        (root / new[1]).write_text(code[new.end() :], encoding="utf-8")
    elif language == "python":
        return code
    return ""


@pytest.fixture
def funnel(monkeypatch):
    """The name of the page's scene, which is forgotten after the test."""
    monkeypatch.setitem(SCENES, "funnel", None)
    SCENES.pop("funnel")
    return "funnel"


def test_the_examples_from_outside_run(funnel):
    """Those that change nothing run one after the other: each goes on where the one before ends."""
    scope: dict = {"__name__": __name__}  # dataclasses look their module up
    for name, blocks in SECTIONS.items():
        for language, code in blocks if not changes_package(blocks) and name != "A network" else []:
            assert language == "python"
            exec(compile(code, PAGE.name, "exec"), scope)
    assert 10 < scope["fallen"].sum() < 4 * 30  # boxes through the gap of the funnel
    start, sim = scope["start"], scope["sim"]
    assert start.report().seconds["start"] > 0.0
    assert sim.state.numpy("time") == pytest.approx(2.2) and not sim.state.numpy("flags").any()
    sim.collide(0.01)
    start.write()
    slots, _ = contact_slots(sim.contacts)
    new = slots[sim.contacts.numpy("age")[slots] == 0]
    mass = sim.model.numpy("mass")[sim.contacts.numpy("body_b")[new]]
    assert len(new) and len(new) < len(slots)
    np.testing.assert_allclose(sim.contacts.numpy("impulse")[new, 0], 0.098 * mass, rtol=1e-6)


def test_sections():
    assert list(SECTIONS) == ["A scene", "A start", "A network", "An acceleration", "A joint", "A backend"]


def test_the_scene_is_run_from_the_command_line(funnel, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("page_scene.py").write_text(SECTIONS["A scene"][0][1], encoding="utf-8")
    try:
        main(["simulate", funnel, "--plugin", "page_scene.py", "--gap", "2", "--bodies", "3", "--steps", "2", "--json"])
    finally:
        sys.modules.pop(f"{registry.PLUGIN}page_scene", None)
    scene = json.loads(capsys.readouterr().out.splitlines()[-1])["config"]["scene"]
    assert (scene["name"], scene["gap"], scene["bodies"]) == ("funnel", 2.0, 3)


def test_the_network_is_trained_and_used_from_the_command_line(tmp_path, monkeypatch, capsys):
    """As the page has it, but fewer worlds and steps."""
    monkeypatch.chdir(tmp_path)
    python, shell, toml = SECTIONS["A network"]
    assert (python[0], shell[0], toml[0]) == ("python", "sh", "toml") and registry.GROUP in toml[1]
    Path("mine.py").write_text(python[1], encoding="utf-8")
    lines = shell[1].splitlines()
    small = {"generate": ["--worlds", "4"], "train": ["--epochs", "1"], "evaluate": ["--worlds", "1", "--steps", "70"]}
    for line in lines:
        words = shlex.split(line)[1:]
        main([*words, *small.get(words[0], ["--steps", "70"]), "--json"])
    results = [json.loads(line) for line in capsys.readouterr().out.splitlines() if line.startswith("{")]
    made, trained, evaluated, simulated = results
    assert made["complete"] and trained["network"] == "mine"
    assert {row["start"] for row in evaluated["runs"]} == {"none", "builtin", "mine"}
    assert simulated["network"]["calls"] > 0
    del sys.modules[f"{registry.PLUGIN}mine"], registry.NETWORKS["mine"]


def test_edits():
    path, changes = edits("--- a.py\n x\n+y\n z\n-u\n+v\n-w\n")
    assert path == "a.py" and changes == [("x\n", "x\ny\n"), ("z\nu\n", "z\nv\n"), ("w\n", "")]


# at the level that tests compile at, so that kernels which an example doesn't change are in the cache
RUN = f"""
import runpy
from dc_kernels._warp import common

common.OPTIMIZATION.update({OPTIMIZATION})
runpy.run_path("example.py", run_name="__main__")
"""


@pytest.mark.parametrize("section", [name for name, blocks in SECTIONS.items() if changes_package(blocks)])
def test_an_example_runs_on_the_package_that_it_changes(section, tmp_path):
    for package in ("dc_kernels", "pipeline"):
        shutil.copytree(ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    code = "\n".join(apply(tmp_path, *block) for block in SECTIONS[section])
    assert "assert" in code
    (tmp_path / "example.py").write_text(code, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-c", RUN],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr[-3000:]
