"""README and docs stay true: their examples run, and the files, modules, commands and options that they name exist."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import importlib
import io
import re
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import get_args, get_type_hints

import numpy as np
import pytest

import dc_kernels as dc
from bench.__main__ import NAMES
from dc_kernels import stages
from dc_kernels.runtime import backends
from pipeline import cli
from pipeline.scenes import SCENES

ROOT = Path(__file__).resolve().parents[2]
PAGES = [
    *(ROOT / name for name in ("README.md", "CHANGELOG.md", "bench/README.md")),
    *sorted((ROOT / "docs").glob("*.md")),
]
TEXTS = {path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8") for path in PAGES}
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```", re.DOTALL | re.MULTILINE)
FOLDERS = "dc_kernels|pipeline|bench|docs|tests"
# options of other programs that the pages name
FOREIGN = {"--nproc-per-node", "--no-python", "--quick", "--pages"}


def blocks(page: str, language: str) -> list[str]:
    """The code blocks of a language on a page, in order."""
    return [code for found, code in BLOCK.findall(TEXTS[page]) if found == language]


def prose(page: str) -> str:
    """A page without its code blocks, in one line."""
    return " ".join(BLOCK.sub("", TEXTS[page]).split())


def quoted(page: str) -> list[str]:
    """What stands between backticks in the prose of a page."""
    return re.findall(r"`([^`]+)`", prose(page))


def every(words: Callable[[str], list[str]]) -> list[tuple[str, str]]:
    """(page, word) of all pages."""
    return [(page, word) for page in TEXTS for word in dict.fromkeys(words(page))]


def check_readme(scope: dict) -> None:
    sim = scope["sim"]
    assert not sim.state.numpy("flags").any()
    assert sim.state.numpy("time") == pytest.approx(2.51)  # 250 steps, and the one in phases
    assert len(scope["start"]) >= sim.contacts.numpy("contact_count").sum() > 64 * 6


def check_solver(scope: dict) -> None:
    sim = scope["sim"]
    assert float(sim.stats.numpy("change")[0]) < 1e-5
    assert sim.state.numpy("time")[0] == pytest.approx(0.11)
    assert scope["other"].config.start == "zero"
    assert np.abs(scope["velocity"]).max() < 1e-3  # ten discs stand on each other
    np.testing.assert_allclose(scope["impulse"][:10, 0], 0.01 * 9.81 * np.arange(10, 0, -1), rtol=1e-2)


def check_transfer(scope: dict) -> None:
    assert scope["pixels"].shape == (4, 6, 61, 61) and scope["label"].shape == (4, 2, 61, 61)
    assert float(scope["leaf"].grad.abs().max()) > 0


def check_stages(scope: dict) -> None:
    impulse = np.arange(6.0).reshape(3, 2)  # contacts 2 and 9 stay, 5 goes, 1, 7 and 11 come
    carried = scope["carry"](np.array([2, 5, 9]), impulse, np.array([1, 2, 7, 9, 11]))
    assert carried.tolist() == [[0, 0], [0, 1], [0, 0], [4, 5], [0, 0]]
    assert np.abs(scope["velocity"]).max() * scope["dt"] < scope["reach"]
    assert (scope["bodies"] == [[i, i + 1] for i in range(4) for _ in range(2)]).all()
    assert scope["height"] == pytest.approx([0.5 * i for i in range(4) for _ in range(2)], abs=1e-6)
    assert scope["touching"].numpy("gap") == pytest.approx([-0.1, -0.005], abs=1e-6)
    assert np.abs(scope["velocity"]).max() < 1e-3  # the tower stands
    assert scope["position"][1:, 1] == pytest.approx(0.25 + 0.5 * np.arange(4), abs=1e-3)
    weight = 9.81 * 0.01 / scope["model"].numpy("inv_mass")[1]
    pairs = scope["solver"].exchange.numpy("impulse")[:8, 0].reshape(4, 2).sum(axis=1)
    assert pairs == pytest.approx(weight * np.arange(4, 0, -1), rel=1e-2)
    near = scope["second_world"]
    assert near.min() >= 120 and (near == scope["search"].numpy()[-len(near) :]).all()
    assert len(scope["search"].numpy()) > len(scope["before"]) > 0


def check_data(scope: dict) -> None:
    batch = scope["batch"]
    assert scope["image"].shape == (len(batch), 6, 61, 61) and scope["target"].shape == (len(batch), 2, 61, 61)
    assert len(scope["speed"]) == len(scope["approach"]) == len(scope["error"]) == len(batch.gap) > 0
    assert float(scope["error"].max()) > 0.0


def check_driving(scope: dict) -> None:
    sim, other = scope["sim"], scope["other"]
    assert sim.state.numpy("time").tolist() == pytest.approx([0.2, 0.4, 0.2, 0.4])
    assert other.state.numpy("time").tolist() == pytest.approx([0.1, 0.3, 0.1, 0.3])
    assert (sim.model.numpy("shape_friction") == np.float32(0.1)).all()
    assert (sim.model.numpy("mass") == other.model.numpy("mass")).all()
    weight = 9.81 * np.pi / 4
    assert scope["observed"].shape == (4, 3, 2) and len(scope["pressing"]) == 4
    assert scope["force"].reshape(4, 3, 2)[:, 0, 1] == pytest.approx(-2 * weight, rel=0.1)
    assert len(scope["events"].touching.impulse) == 8 and not len(scope["struck"])
    first = sim.contacts.numpy("contact_start")[:-1]
    found = sim.contacts.numpy("impulse")[first, 0] / weight / 0.01
    assert found == pytest.approx([1, 2, 2, 2], rel=0.1)  # both discs on the floor; one on the frozen one


def check_sleep(scope: dict) -> None:
    sim = scope["sim"]
    assert sim.asleep.sum() == 4 and sim.state.numpy("time")[0] == pytest.approx(1.01)


def check_stepping(scope: dict) -> None:
    sim, crate = scope["sim"], scope["crate"]
    sim.run(100, 0.01)
    assert sim.state.numpy("velocity")[crate, 0] == pytest.approx(-2.0, abs=0.01)
    assert scope["tower"].stats.numpy("sweeps").tolist() == [8]


def check_events(scope: dict) -> None:
    assert sorted(scope["entered"]) == [0, 1, 2] and scope["inside"].world.tolist() == [0, 1, 2]
    hits = [speed for speeds in scope["hits"] for speed in speeds]
    assert hits == pytest.approx(3 * [np.sqrt(2 * 9.8 * 3.75)], rel=0.02)
    assert scope["crate"].state.numpy("position")[scope["box"], 1] == pytest.approx(2.2, abs=2e-3)
    assert scope["crate"].state.numpy("velocity")[scope["slider"], 0] == pytest.approx(3.0 - 0.05 * 9.8 * 2.0, rel=1e-2)


def check_population(scope: dict) -> None:
    sim, left = scope["sim"], scope["tower"][[0, 2, 3]]
    assert scope["height"] == pytest.approx(0.5, abs=0.02)
    assert sim.joints.sizes["joint"] == 0 and (sim.ids.numpy("body_id") >= 0).sum() == 4
    assert sim.state.numpy("position")[sim.index(bodies=left), 1] == pytest.approx([0.5, 1.5, 2.5], abs=0.05)


def check_joints(scope: dict) -> None:
    sim, arm = scope["sim"], scope["arm"]
    assert sim.state.numpy("angle")[arm] == pytest.approx(0.5, abs=1e-3)  # the motor has turned it to its limit
    weight = sim.model.numpy("mass")[arm] * 9.8
    reactions = dc.joint_reactions(sim)
    assert reactions.force[scope["hinge"]] == pytest.approx([0.0, weight], abs=1e-4)
    assert reactions.torque[scope["hinge"]] == pytest.approx(0.5 * np.cos(0.5) * weight, rel=1e-3)
    sim.run(100, 0.01)
    assert sim.state.numpy("angle")[arm] == pytest.approx(-0.5, abs=1e-3)


CHECKS = {
    "docs/events.md": check_events,
    "docs/joints.md": check_joints,
    "docs/population.md": check_population,
    "docs/stepping.md": check_stepping,
    "docs/sleep.md": check_sleep,
    "docs/driving.md": check_driving,
    "docs/data.md": check_data,
    "README.md": check_readme,
    "docs/stages.md": check_stages,
    "docs/solver.md": check_solver,
    "docs/transfer.md": check_transfer,
}


@pytest.mark.parametrize("page", [page for page in TEXTS if blocks(page, "python") and page != "docs/extend.md"])
def test_the_examples_run(page, capsys):
    """The blocks of a page, one after the other: each goes on where the one before ends."""
    scope: dict = {"__name__": __name__}  # dataclasses look their module up
    for code in blocks(page, "python"):
        exec(compile(code, page, "exec"), scope)
    CHECKS[page](scope)
    if page == "README.md":
        assert "broadphase" in capsys.readouterr().out


@pytest.mark.parametrize(("page", "code"), [(page, code) for page in TEXTS for code in blocks(page, "py")])
def test_the_fragments_compile(page, code):
    compile(code, page, "exec")


@pytest.mark.parametrize("page", TEXTS)
def test_every_link_leads_to_a_file(page):
    for target in re.findall(r"\]\((?!https?://)([^)\s]+)\)", TEXTS[page]):
        path, _, anchor = target.partition("#")
        found = (ROOT / page).parent / path if path else ROOT / page
        assert found.exists(), target
        if anchor:
            titles = re.findall(r"^#+ (.*)$", found.read_text(encoding="utf-8"), re.MULTILINE)
            assert anchor in [re.sub(r"[^\w -]", "", title).lower().replace(" ", "-") for title in titles], target


def test_every_path_exists():
    paths = every(lambda page: [word for word in quoted(page) if re.fullmatch(rf"(?:{FOLDERS})/[\w./]*", word)])
    assert len(paths) > 30
    missing = [(page, path) for page, path in paths if not (ROOT / path).exists()]
    assert not missing


def resolve(name: str) -> None:
    """Import what a dotted name begins with and look the rest up in it; a file that is a program is only found.

    Raises:
        AttributeError: where there is no such name.
    """
    parts = name.split(".")
    if parts[0] == "dc":
        module, rest = dc, parts[1:]
    else:
        if ROOT.joinpath(*parts).with_suffix(".py").exists():
            return
        known = [i for i in range(1, len(parts) + 1) if is_module(parts[:i])]
        module, rest = importlib.import_module(".".join(parts[: known[-1]])), parts[known[-1] :]
    functools.reduce(getattr, rest, module)


def is_module(parts: list[str]) -> bool:
    """Whether a dotted name is a file or a folder of the tree."""
    return ROOT.joinpath(*parts).is_dir() or ROOT.joinpath(*parts).with_suffix(".py").exists()


def test_every_module_and_name_can_be_imported():
    dotted = every(lambda page: re.findall(r"(?<![\w/.])(?:dc_kernels|pipeline|bench|dc)\.\w[\w.]*\w", prose(page)))
    assert len(dotted) > 12
    for _, name in dotted:
        resolve(name)
    with pytest.raises(AttributeError, match="nonsense"):
        resolve("dc_kernels.model.nonsense")


def test_every_member_of_a_simulation_exists():
    known = {*dir(dc.Simulation), *dc.Simulation.__annotations__, "state", "model", "joints", "config"}
    members = every(lambda page: re.findall(r"\bsim\.(\w+)", TEXTS[page]))
    assert len(members) > 10
    assert not [(page, member) for page, member in members if member not in known]


def test_every_setting_of_the_solver_exists():
    """The first column of the settings' table, and keywords in backticks: fields of SolverConfig."""
    fields = {field.name for field in dataclasses.fields(dc.SolverConfig)}
    table = TEXTS["docs/solver.md"].split("| setting |")[1].split("\n\n")[0]
    settings = re.findall(r"`(\w+)`", " ".join(re.findall(r"^\| ([^|]+) \|", table, re.MULTILINE)))
    assert len(settings) > 5 and set(settings) <= fields
    for values, field in ((choices("method"), "method"), (choices("acceleration"), "acceleration")):
        row = next(line for line in table.splitlines() if line.startswith(f"| `{field}`"))
        assert all(f"`{value}`" in row for value in values), field


def choices(name: str) -> tuple[str, ...]:
    """The values that a field of SolverConfig takes."""
    return get_args(get_type_hints(dc.SolverConfig)[name])


def test_the_fields_of_a_model_that_act_at_the_next_step_are_named():
    sentence = TEXTS["docs/architecture.md"].split("Of a model that a simulation uses ")[1].split(" may be")[0]
    assert re.findall(r"`(\w+)`", sentence) == list(dc.Model.live)


def test_every_flag_is_named():
    found = TEXTS["docs/limits.md"].split("## Worlds that stopped")[1].split("##")[0]
    assert set(re.findall(r"[A-Z_]{5,}", found)) == {flag.name for flag in dc.Flag if flag}


def test_every_scene_is_named():
    sentence = TEXTS["docs/command-line.md"].split("Scenes:")[1].split(". ")[0]
    assert set(re.findall(r"`([\w-]+)`", sentence)) == set(SCENES)


def test_every_make_target_exists():
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    targets = every(lambda page: re.findall(r"(?:`|^)make (\w+)", TEXTS[page], re.MULTILINE))
    assert {"demo", "test", "lint", "bench"} <= {target for _, target in targets}
    for page, target in targets:
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), (page, target)


def test_every_bench_exists():
    named = every(lambda page: re.findall(r"python -m bench (\w+)", TEXTS[page]))
    assert len(named) > 15
    assert not [(page, name) for page, name in named if name not in NAMES]
    rows = re.findall(r"^\| `(\w+)` \|", TEXTS["bench/README.md"], re.MULTILINE)
    assert sorted(rows) == sorted(NAMES)


def command_lines() -> list[tuple[str, str]]:
    """(page, line) of every deep-contact command in a shell block."""
    return [
        (page, line.split("#")[0].strip())
        for page in TEXTS
        for code in blocks(page, "sh")
        for line in code.splitlines()
        if line.startswith("deep-contact")
    ]


def test_every_command_line_is_understood(capsys, monkeypatch):
    monkeypatch.setattr(cli, "load_plugin", lambda path: None)  # the files are those of the page
    lines = command_lines()
    assert len(lines) >= 12
    for _, line in lines:
        cli.parse(shlex.split(line)[1:])  # exits where it does not understand
    with pytest.raises(ValueError, match="--nonsense is no option of deep-contact simulate thesis"):
        cli.parse(["simulate", "thesis", "--nonsense"])
    capsys.readouterr()


HELPS = (
    *(("train", "mine"), ("simulate", "thesis")),
    *((name,) for name in ("simulate", "generate", "train", "train-contactnet", "train-stepper")),
    *((name,) for name in ("evaluate", "protocol", "explain")),
    *(("demo",), ("figures", "kernels"), ("fclib", "export"), ("fclib", "solve"), ("simulate", "mixed")),
    *(("generate", "mixed"), ("generate", "thesis"), ("train", "unet")),
)


@pytest.fixture(scope="module")
def helps():
    """The text that --help prints for each command and subcommand that a page names."""
    return {" ".join(words): help_text(*words) for words in HELPS}


def help_text(*words: str) -> str:
    """What --help prints for a command."""
    with contextlib.redirect_stdout(io.StringIO()) as out, pytest.raises(SystemExit):
        cli.parse([*words, "--help"])
    return out.getvalue()


def test_every_option_is_known_to_the_help(helps):
    options = {option for text in helps.values() for option in re.findall(r"--[a-z][\w-]*", text)}
    named = every(lambda page: re.findall(r"(?<!\S)--[a-z][\w-]*", " ".join(quoted(page))))
    assert len({option for _, option in named}) > 6
    assert not [(page, option) for page, option in named if option not in options | FOREIGN]
    for page, line in command_lines():
        words = shlex.split(line)[1:]
        known = "".join(text for name, text in helps.items() if " ".join(words).startswith(name))
        assert not [(page, word) for word in words if word.startswith("--") and word not in known]


def test_the_table_of_stages_is_that_of_the_code():
    assert stages.markdown() in (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")


def test_the_table_of_what_sleep_adds_is_that_of_the_code():
    assert stages.markdown(stages.SLEEP) in (ROOT / "docs" / "sleep.md").read_text(encoding="utf-8")
    stepping = (ROOT / "docs" / "stepping.md").read_text(encoding="utf-8")
    assert stages.markdown(stages.SOFT) in stepping
    assert stages.markdown(stages.FOLLOWED) in stepping
    assert stages.markdown(stages.ROLLED) in stepping


def test_the_table_of_what_joints_add_is_that_of_the_code():
    assert stages.markdown((*stages.EVENTS, *stages.SWITCHED)) in (ROOT / "docs" / "events.md").read_text(
        encoding="utf-8"
    )
    assert stages.markdown(stages.LINKED) in (ROOT / "docs" / "joints.md").read_text(encoding="utf-8")


def test_the_table_of_backends_is_that_of_the_code():
    assert backends.markdown() in (ROOT / "docs" / "taichi.md").read_text(encoding="utf-8")
