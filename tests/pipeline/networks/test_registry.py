"""Networks from outside the package: registered by a file or an installed package, trained, saved and found again."""

from __future__ import annotations

import dataclasses
import json
import sys
from importlib import metadata
from pathlib import Path

import pytest

torch = pytest.importorskip("torch")
torch.set_num_threads(1)
from pipeline.cli import main  # noqa: E402
from pipeline.commands import compare  # noqa: E402
from pipeline.networks import models, registry  # noqa: E402
from pipeline.networks.checkpoint import load_checkpoint, save_checkpoint  # noqa: E402
from pipeline.training import grid as grid_training  # noqa: E402
from pipeline.training.grid import train_grid_network  # noqa: E402
from pipeline.training.preparation import configuration  # noqa: E402
from tests.pipeline.small import PNG, options  # noqa: E402

PLUGIN = '''
"""A network of one layer."""
from dataclasses import dataclass

import torch

from pipeline.networks.models import GridConfig, GridNetwork
from pipeline.networks.registry import Setup, register


@dataclass(frozen=True, kw_only=True)
class Sizes(GridConfig):
    kernel: int = 3
    name: str = "plain"


@register("NAME", Sizes, Setup(nodes=13, contacts=()))
class Mine(GridNetwork):
    def __init__(self, config):
        super().__init__(config)
        pad = config.kernel // 2
        self.layer = torch.nn.Conv2d(config.channels, config.outputs, config.kernel, padding=pad)

    def answer(self, x):
        return self.layer(x)
'''


@pytest.fixture(autouse=True)
def forgotten(monkeypatch):
    """Registries as they were, after each test; and no pictures, which take longer than all else."""
    for module in (grid_training, compare):
        monkeypatch.setattr(module, "save_figure", lambda figure, path: path.write_bytes(PNG))
    for name in registry.ELSEWHERE:  # what is imported during a test would be forgotten for good
        registry.entry(name)
    monkeypatch.setattr(registry, "NETWORKS", dict(registry.NETWORKS))
    before = set(sys.modules)
    yield
    for name in set(sys.modules) - before:
        if name.startswith(registry.PLUGIN):
            del sys.modules[name]


@pytest.fixture
def plugin(tmp_path) -> Path:
    path = tmp_path / "mine.py"
    path.write_text(PLUGIN.replace("NAME", "mine"))
    return path


def test_a_plugin_works_from_the_command_line(data, plugin, tmp_path, capsys):
    """Training, simulation and evaluation; a checkpoint without its plugin is refused."""
    out = tmp_path / "out"
    train = ["train", "mine", "--data", str(data), "--out", str(out), "--stride", "20", "--epochs", "1"]
    train += ["--batch-size", "8", "--sizes", "kernel", "5", "name", "wide", "--json"]
    assert main([*train, "--plugin", str(plugin)]) == 0
    summary = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert summary["network"] == "mine" and summary["parameters"] == 2 * (4 * 25 + 1)
    model, manifest = load_checkpoint(out / "best.safetensors")
    assert (model.config.kernel, model.config.name, model.config.rows) == (5, "wide", 13)
    assert manifest["images"]["contact_channels"] == []
    best = str(out / "best.safetensors")
    run = ["--bodies", "6", "--steps", "40", "--json"]
    assert main(["simulate", "thesis", *run, "--out", str(tmp_path / "run"), "--start", best]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["network"]["calls"] > 0
    command = ["protocol", *run, "--worlds", "1", "--starts", "none", f"mine={best}", "--out", str(tmp_path / "all")]
    registry.NETWORKS.pop("mine")
    del sys.modules[f"{registry.PLUGIN}mine"]
    with pytest.raises(SystemExit) as caught:
        main(command)
    assert caught.value.code == 2
    message = "holds the network 'mine' of the plugin mine.py, which is not loaded: give --plugin mine.py"
    assert message in capsys.readouterr().err
    assert main([*command, "--plugin", str(plugin)]) == 0
    assert [row["start"] for row in json.loads(capsys.readouterr().out.splitlines()[-1])["runs"]] == ["none", "mine"]


def test_an_installed_package_is_found_by_its_entry_point(tmp_path, monkeypatch):
    (tmp_path / "elsewhere.py").write_text(PLUGIN.replace("NAME", "theirs"))
    monkeypatch.syspath_prepend(tmp_path)
    points = [metadata.EntryPoint(*named, registry.GROUP) for named in (("theirs", "elsewhere"), ("none", "json"))]
    monkeypatch.setattr(
        metadata, "entry_points", lambda group, name=None: [p for p in points if name in (None, p.name)]
    )
    assert {"unet", "contactnet", "theirs"} <= set(registry.known())
    model = models.build("theirs", {"kernel": 1})
    assert registry.entry("theirs").plugin == "elsewhere"
    save_checkpoint(tmp_path / "a.safetensors", model, {})
    assert load_checkpoint(tmp_path / "a.safetensors")[0].config.kernel == 1
    with pytest.raises(ValueError, match=r"entry point none = json of deep_contact\.networks registers no network"):
        registry.entry("none")
    points.clear()
    registry.NETWORKS.pop("theirs")
    with pytest.raises(ValueError, match="of the plugin elsewhere, which is not loaded: import elsewhere first"):
        load_checkpoint(tmp_path / "a.safetensors")


def test_plugins_do_not_take_names(plugin, tmp_path):
    module = registry.load_plugin(plugin)
    assert registry.load_plugin(plugin) is module
    other = tmp_path / "other"
    other.mkdir()
    (other / "mine.py").write_text(PLUGIN.replace("NAME", "mine"))
    with pytest.raises(ValueError, match=r"has the name of .*mine\.py, which is loaded; rename one of them"):
        registry.load_plugin(other / "mine.py")
    for name, message in (("mine", r"by mine\.py"), ("unet", "by this package"), ("contactnet", "by this package")):
        path = tmp_path / f"takes_{name}.py"
        path.write_text(PLUGIN.replace("NAME", name))
        with pytest.raises(ValueError, match=f"network '{name}' of takes_{name}.py is registered already, {message}"):
            registry.load_plugin(path)
        assert f"{registry.PLUGIN}takes_{name}" not in sys.modules


def test_files_that_are_no_plugins_are_named(tmp_path, capsys):
    with pytest.raises(FileNotFoundError, match=r"plugin nowhere\.py is not there"):
        registry.load_plugin("nowhere.py")
    (tmp_path / "notes.txt").write_text("")
    with pytest.raises(ValueError, match=r"notes\.txt is no Python file; its name must end with \.py"):
        registry.load_plugin(tmp_path / "notes.txt")
    with pytest.raises(SystemExit) as caught:
        main(["explain", "stack", "--plugin", "nowhere.py"])
    assert caught.value.code == 2 and "plugin nowhere.py is not there" in capsys.readouterr().err


def test_sizes_are_fields_of_the_network(plugin):
    registry.load_plugin(plugin)
    given = {"rows": 9, "columns": 9, "channels": 4, "outputs": 2, "width": 1.0, "dropout": 0.1}
    found = configuration("mine", given, (("kernel", "7"), ("name", "a b")))
    assert found == {**given, "kernel": 7, "name": "a b"}
    for name in ("rows", "depth"):
        with pytest.raises(ValueError, match=rf"sizes\.{name} is no field of mine's own; it has \('kernel', 'name'\)"):
            configuration("mine", given, ((name, "3"),))


def test_networks_that_cannot_be_trained_are_refused(data, tmp_path):
    @dataclasses.dataclass(frozen=True)
    class Hidden:
        hidden: int = 2

    @registry.register("unscaled", Hidden)
    class Unscaled(torch.nn.Module):
        def __init__(self, config):
            super().__init__()
            layers = torch.nn.Conv2d(6, config.hidden, 3, padding=1), torch.nn.Conv2d(config.hidden, 2, 3, padding=1)
            self.layers = torch.nn.Sequential(*layers)

        def forward(self, x):
            return self.layers(x)

    @registry.register("narrow", Hidden)
    class Narrow(Unscaled):
        def forward(self, x):
            return super().forward(x)[..., 1:]

    def train(network: str, **changes):
        return train_grid_network(network, options(data, tmp_path / "out", epochs=1, **changes), progress=False)

    with pytest.raises(ValueError, match=r"unscaled has no set_scales: derive it from models\.GridNetwork, or train"):
        train("unscaled")
    with pytest.raises(
        ValueError, match=r"narrow answers an image with shape \(1, 2, 17, 16\); it must be \(1, 2, 17, 17"
    ):
        train("narrow")
    with pytest.raises(ValueError, match=r"network is 'contactnet', which reads no images; it must be one of"):
        train("contactnet")
    assert not (tmp_path / "out").exists()
    assert train("unscaled", scaling="none", sizes=(("hidden", "3"),))["parameters"] == 6 * 27 + 3 + 3 * 18 + 2
