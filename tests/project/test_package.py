"""What importing costs and needs, the public names, and the extras."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import dc_kernels
from dc_kernels.runtime.imports import require

ROOT = Path(__file__).resolve().parents[2]
OPTIONAL = (
    "torch",
    "h5py",
    "scipy",
    "matplotlib",
    "taichi",
    "quadrants",
    "tyro",
    "tqdm",
    "pymunk",
    "Box2D",
    "imageio_ffmpeg",
)

try:
    import tomllib
except ImportError:  # Python 3.10
    import tomli as tomllib


def run_python(code: str) -> str:
    """What a fresh interpreter prints, started in the repository."""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def pyproject() -> dict:
    return tomllib.loads((ROOT / "pyproject.toml").read_text())


def requirement_names(requirements: list[str]) -> set[str]:
    return {re.split(r"[\[<>=!~; ]", text, maxsplit=1)[0] for text in requirements}


def installed_by(extra: str, extras: dict[str, list[str]]) -> set[str]:
    """Distributions that an extra installs, those of the extras it includes among them."""
    names = requirement_names(extras[extra]) - {"deep-contact"}
    for text in extras[extra]:
        if text.startswith("deep-contact["):
            for other in text.removeprefix("deep-contact[").removesuffix("]").split(","):
                names |= installed_by(other, extras)
    return names


def test_import_loads_neither_warp_nor_an_extra():
    loaded = run_python("import sys, dc_kernels; print(*{name.split('.')[0] for name in sys.modules})").split()
    assert "dc_kernels" in loaded
    assert not {*OPTIONAL, "warp", "numpy"} & set(loaded)


def test_a_step_needs_no_extra():
    """Every extra is made unimportable; building and stepping a world still works."""
    code = f"""
import sys
for name in {OPTIONAL}:
    sys.modules[name] = None
import warp as wp
wp.config.log_level = wp.LOG_WARNING
import dc_kernels as dc
for name in dc.__all__:
    getattr(dc, name)
builder = dc.ModelBuilder()
builder.add_world()
ball = builder.add_body(position=(0.0, 1.0))
builder.add_disc(ball, radius=0.5)
sim = dc.Simulation(*builder.finalize())
sim.step(0.1)
print(dc.to_numpy(sim.state.velocity)[0, 1])
"""
    assert float(run_python(code)) == pytest.approx(-0.98)


def test_every_public_name_resolves():
    assert sorted(name for names in dc_kernels._MODULES.values() for name in names) == sorted(dc_kernels.__all__)
    for name in dc_kernels.__all__:
        assert getattr(dc_kernels, name) is not None
    assert set(dc_kernels.__all__) <= set(dir(dc_kernels))


def test_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'Simulatoin'"):
        dc_kernels.Simulatoin  # noqa: B018


def test_version_is_that_of_the_distribution(pyproject):
    assert dc_kernels.__version__ == pyproject["project"]["version"]


@pytest.mark.parametrize(("function", "module", "extra"), [("to_torch", "torch", "pipeline")])
def test_missing_dependency_names_the_extra(monkeypatch, function, module, extra):
    monkeypatch.setitem(sys.modules, module, None)  # makes `import module` fail
    with pytest.raises(ImportError, match=rf"needs {module}: .*-e '\.\[{extra}\]'"):
        getattr(dc_kernels, function)(object())


def test_require_names_the_package_of_a_submodule():
    with pytest.raises(ImportError, match=r"needs no_such_package: .*-e '\.\[bench\]'"):
        require("no_such_package.part", "bench")


def test_extras(pyproject):
    project = pyproject["project"]
    extras = project["optional-dependencies"]
    assert set(extras) == {"pipeline", "cluster", "taichi", "quadrants", "bench", "dev", "all"}
    assert requirement_names(project["dependencies"]) == {"numpy", "warp-lang"}
    assert {"torch", "h5py", "tyro", "tqdm", "matplotlib"} <= installed_by("pipeline", extras)
    assert installed_by("all", extras) == set().union(*(installed_by(name, extras) for name in extras))


def test_require_is_called_with_extras_that_have_the_module(pyproject):
    """Each ``require("module", "extra")`` in the code names an extra that installs the module."""
    extras = pyproject["project"]["optional-dependencies"]
    calls = []
    for folder in ("dc_kernels", "pipeline", "bench"):
        for path in (ROOT / folder).rglob("*.py"):
            calls += re.findall(r"\brequire\(\s*\"([\w.]+)\",\s*\"(\w+)\"", path.read_text())
    assert ("torch", "pipeline") in calls
    for module, extra in calls:
        installed = {name.replace("-", "_") for name in installed_by(extra, extras)}
        assert module.split(".")[0].lower() in installed, (module, extra)


def test_constraints_pin_every_requirement(pyproject):
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pins = [line for line in lines if line and not line.startswith("#")]
    assert all(re.match(r"[a-z0-9-]+==[0-9][\w.]*(; python_version (<|>=) \"3\.11\")?$", pin) for pin in pins)
    project = pyproject["project"]
    wanted = requirement_names(sum(project["optional-dependencies"].values(), project["dependencies"]))
    assert wanted - {"deep-contact"} <= requirement_names(pins)


@pytest.mark.parametrize("package", ["dc_kernels", "pipeline"])
def test_packages_are_marked_as_typed(package):
    assert (ROOT / package / "py.typed").is_file()


def test_the_command_runs_beside_files_of_its_packages_names(pyproject, tmp_path):
    """As pip's script does: Python looks for modules beside the script, not in the present folder."""
    module, function = pyproject["project"]["scripts"]["deep-contact"].split(":")
    script, folder = tmp_path / "bin" / "deep-contact", tmp_path / "mine"
    for path in (script.parent, folder):
        path.mkdir()
    script.write_text(f"import sys\nfrom {module} import {function}\nsys.exit({function}())\n")
    for name in ("pipeline", "dc_kernels"):
        (folder / f"{name}.py").write_text("raise SystemExit('a file of the user was imported')\n")
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, str(script), "explain", "stack"]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("scene: 1 world")
