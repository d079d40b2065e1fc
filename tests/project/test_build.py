"""The source archive and the wheel: what they hold, and that they run where nothing else of us is."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
# what `python -m build` calls, in the present environment: no network is needed
BUILD = "from setuptools import build_meta; print(build_meta.build_{kind}({folder!r}))"
SOURCES = ("dc_kernels", "pipeline", "docs", "examples")
FILES = ("pyproject.toml", "MANIFEST.in", "README.md", "LICENSE", "CHANGELOG.md", "constraints.txt")


def run(*command: object, cwd: Path, **environment: str) -> str:
    """What a command prints; PYTHONPATH of the tests is not its own."""
    known = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        [str(part) for part in command], cwd=cwd, env={**known, **environment}, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def build(kind: str, tree: Path, folder: Path) -> Path:
    """Build the sdist or the wheel of a tree."""
    pytest.importorskip("setuptools", minversion="77")
    return folder / run(sys.executable, "-c", BUILD.format(kind=kind, folder=str(folder)), cwd=tree).split()[-1]


@pytest.fixture(scope="module")
def archives(tmp_path_factory) -> tuple[Path, Path]:
    """The sdist of a copy of this tree, and the wheel that is built from the sdist alone."""
    folder = tmp_path_factory.mktemp("build")
    tree = folder / "tree"
    for name in SOURCES:
        shutil.copytree(ROOT / name, tree / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in FILES:
        shutil.copy(ROOT / name, tree / name)
    sdist = build("sdist", tree, folder)
    with tarfile.open(sdist) as archive:
        archive.extractall(folder / "unpacked", filter="data")
    (unpacked,) = (folder / "unpacked").iterdir()
    return sdist, build("wheel", unpacked, folder)


def test_archives_hold_all_files(archives):
    sdist, wheel = archives
    with tarfile.open(sdist) as archive:
        of_sdist = {name.partition("/")[2] for name in archive.getnames()}
    with zipfile.ZipFile(wheel) as zipped:
        of_wheel = set(zipped.namelist())

    def files(*folders: str) -> set[str]:
        found = [path for name in folders for path in (ROOT / name).rglob("*") if path.is_file()]
        return {str(path.relative_to(ROOT)) for path in found if "__pycache__" not in path.parts}

    package = files("dc_kernels", "pipeline")
    for name in (
        "dc_kernels/_warp/native/prelude.h",
        "dc_kernels/py.typed",
        "pipeline/contactnet/contactnet.safetensors",
        "pipeline/stepper/stepnet.safetensors",
    ):
        assert name in package
    assert package <= of_wheel
    assert package | files("docs", "examples") | set(FILES) <= of_sdist
    assert not {name.split("/")[0] for name in of_wheel} & {"bench", "tests", "examples", "docs"}


def test_the_wheel_runs_in_an_environment_of_its_own(archives, tmp_path):
    """Dependencies are those of this environment, which a line makes importable, but not what is editable here."""
    pytest.importorskip("pip", minversion="22.3")
    _, wheel = archives
    place = tmp_path / "venv"
    venv.EnvBuilder(with_pip=False, symlinks=os.name != "nt").create(place)
    scripts = place / ("Scripts" if os.name == "nt" else "bin")
    python = scripts / "python"
    options = ("--no-deps", "--no-index", "--no-compile", "--quiet", "--disable-pip-version-check")
    run(sys.executable, "-m", "pip", "--python", python, "install", *options, wheel, cwd=tmp_path)
    site = Path(run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=tmp_path).strip())
    paths = {sysconfig.get_path("purelib"), sysconfig.get_path("platlib")}
    (site / "dependencies.pth").write_text("\n".join(sorted(paths)) + "\n")
    found = run(
        python, "-c", "import dc_kernels, pipeline; print(dc_kernels.__file__, pipeline.__file__)", cwd=tmp_path
    )
    assert found.count(str(site)) == 2
    assert "narrowphase" in run(scripts / "deep-contact", "explain", "stack", "--bodies", "3", cwd=tmp_path)
    assert "the tower stands" in run(python, ROOT / "examples" / "own_simulator.py", cwd=tmp_path)
