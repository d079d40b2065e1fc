"""The README stays true: its code runs, its links and commands exist."""

import re
from pathlib import Path

import pytest

from pipeline import cli

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```(\w+)\n(.*?)```", TEXT, re.DOTALL)


def test_the_python_examples_run(capsys):
    examples = [code for language, code in BLOCKS if language == "python"]
    assert len(examples) == 2
    scope: dict = {}
    for code in examples:  # the second goes on where the first ends
        exec(compile(code, "README.md", "exec"), scope)
    sim = scope["sim"]
    assert not sim.state.numpy("flags").any()
    # 250 steps, the one in phases, and the one started from an image
    assert sim.state.numpy("time") == pytest.approx(2.52)
    assert scope["pixels"].shape == (64, 6, 61, 61) and scope["label"].shape == (64, 2, 61, 61)
    assert float(scope["leaf"].grad.abs().max()) > 0
    assert "broadphase" in capsys.readouterr().out


def test_every_path_it_names_exists():
    for path in re.findall(r"\]\(([^)#:]+)\)", TEXT):
        assert (ROOT / path).exists(), path
    places = re.findall(r"^\| (.*?) \|", TEXT.split("| place in `dc_kernels/` |")[1].split("###")[0], re.MULTILINE)
    for place in re.findall(r"`([\w./]+)`", " ".join(places)):
        assert (ROOT / "dc_kernels" / place).exists(), place


def test_every_make_target_it_names_exists():
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    targets = set(re.findall(r"`?make (\w+)", TEXT))
    assert {"demo", "test"} <= targets
    for target in targets:
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), target


def test_every_command_it_names_is_understood(capsys):
    lines = [line for language, code in BLOCKS if language == "sh" for line in code.splitlines()]
    commands = [line.split("#")[0].split() for line in lines if line.startswith("deep-contact")]
    assert len(commands) >= 4
    for words in commands:
        cli.parse(words[1:])  # parses, and exits where it does not understand
    with pytest.raises(SystemExit):
        cli.parse([*commands[0][1:], "--nonsense"])
    capsys.readouterr()
