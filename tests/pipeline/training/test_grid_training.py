"""Trainings of the theses' networks on a small data set: whole files, resumed bit for bit, shared by processes."""

from __future__ import annotations

import json
import math
import os
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from unittest import mock

import numpy as np
import pytest

torch = pytest.importorskip("torch")
torch.set_num_threads(1)
import safetensors.torch  # noqa: E402

from pipeline.cli import main  # noqa: E402
from pipeline.data.generate import generate  # noqa: E402
from pipeline.data.recipe import GenerateOptions, Recipe  # noqa: E402
from pipeline.networks import models  # noqa: E402
from pipeline.networks.checkpoint import load_checkpoint  # noqa: E402
from pipeline.seeds import HELD_OUT_SEED  # noqa: E402
from pipeline.training import grid as grid_training  # noqa: E402
from pipeline.training.grid import train_grid_network  # noqa: E402
from pipeline.training.options import TrainOptions  # noqa: E402
from pipeline.training.processes import Processes  # noqa: E402
from tests.pipeline.small import PNG, SCENE, options  # noqa: E402

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def undrawn(monkeypatch) -> None:
    """Trainings without their pictures, which take longer than they do."""
    monkeypatch.setattr(grid_training, "save_figure", lambda figure, path: path.write_bytes(PNG))


@pytest.mark.parametrize(("network", "rate"), [("convfc", 0.05), ("pressure", 0.02), ("peak", 5e-3), ("unet", 5e-3)])
def test_a_training_writes_whole_files_and_learns(data, tmp_path, request, network, rate):
    """Of the same few states, seen again and again, the network learns some."""
    if network != "unet":
        request.getfixturevalue("undrawn")
    chosen = options(data, tmp_path, stride=20, epochs=12, dropout=0.0, loss="contact_mse", log_every=3, rate=rate)
    summary = train_grid_network(network, chosen, progress=False)
    names = {"best.safetensors", "last.safetensors", "training.safetensors", "metrics.jsonl", "train.json"}
    pictures = {"curves.png", "predictions.png"}
    assert {path.name for path in tmp_path.iterdir()} == {*names, *pictures, "tensorboard"}
    assert set(summary["files"]) == names | pictures
    assert all((tmp_path / name).read_bytes()[:4] == PNG for name in pictures)

    def refuse(text):
        raise AssertionError(text)

    assert json.loads((tmp_path / "train.json").read_text(), parse_constant=refuse)["steps"] == summary["steps"] == 36
    rows = [json.loads(line) for line in (tmp_path / "metrics.jsonl").read_text().splitlines()]
    losses = [row["train/loss"] for row in rows if "train/loss" in row]
    assert len(losses) == 12
    assert np.mean(losses[-3:]) < 0.9 * losses[0]
    assert summary["metrics"]["loss_grid"] < 0.7 * summary["metrics"]["loss_zero"]
    model, manifest = load_checkpoint(tmp_path / "best.safetensors", network=network)
    assert manifest["data"]["seeds"] == [0, 8]
    assert manifest["data"]["config"]["scene"]["bodies"] == 6
    assert {"torch", "warp-lang", "safetensors"} <= set(manifest["versions"])
    assert manifest["metrics"]["loss"] == summary["best_loss"]
    assert float(model.input_bound) == grid_training.BOUND
    assert (model.input_scale[1:] != 1.0).all()


def trained(out: Path) -> dict[str, torch.Tensor]:
    """All that a training has come to: weights, momenta, generator."""
    return safetensors.torch.load_file(out / "training.safetensors")


def logged(out: Path) -> list[dict]:
    return [json.loads(line) for line in (out / "metrics.jsonl").read_text().splitlines()]


def assert_same_training(one: Path, two: Path) -> None:
    first, second = trained(one), trained(two)
    assert first.keys() == second.keys()
    assert len(first) > 20
    for name, tensor in first.items():
        assert torch.equal(tensor, second[name]), name
    assert logged(one) == logged(two)
    last = [safetensors.torch.load_file(out / "best.safetensors") for out in (one, two)]
    assert all(torch.equal(tensor, last[1][name]) for name, tensor in last[0].items())


RESUMED = [
    ("convfc", {}),
    ("peak", {"schedule": "decay", "optimizer": "sgd"}),
    ("unet", {"loss": "sweeps", "sweeps": 2}),
]


@pytest.mark.parametrize(("network", "changes"), RESUMED)
def test_a_training_interrupted_and_resumed_has_the_bits_of_one_that_was_not(
    data, tmp_path, monkeypatch, undrawn, network, changes
):
    """Ctrl-C in the middle of an epoch, then once more: batch norm, dropped values, schedules and order go on."""
    whole, parts = options(data, tmp_path / "whole", **changes), options(data, tmp_path / "parts", **changes)
    assert train_grid_network(network, whole, progress=False)["complete"]
    learn = grid_training.GridTraining.learn

    def interrupted(self, batch, stop=False):
        if self.step in (2, 7):
            signal.raise_signal(signal.SIGINT)
        return learn(self, batch, stop or self.step in (2, 7))

    monkeypatch.setattr(grid_training.GridTraining, "learn", interrupted)
    summary = train_grid_network(network, parts, progress=False)
    assert (summary["complete"], summary["steps"]) == (False, 3)
    assert "predictions.png" not in summary["files"]  # no epoch is over
    summary = train_grid_network(network, replace(parts, resume=True), progress=False)
    assert (summary["complete"], summary["steps"]) == (False, 8)
    monkeypatch.setattr(grid_training.GridTraining, "learn", learn)
    summary = train_grid_network(network, replace(parts, resume=True), progress=False)
    assert summary["complete"]
    assert_same_training(tmp_path / "whole", tmp_path / "parts")


def test_a_killed_training_goes_on_from_its_last_save(data, tmp_path, monkeypatch, undrawn):
    whole, parts = (options(data, tmp_path / name, find_rate=True) for name in ("whole", "parts"))
    chosen = train_grid_network("pressure", whole, progress=False)["choices"]["rate"]
    learn = grid_training.GridTraining.learn

    def killed(self, batch, stop=False):
        if self.step == 5:
            raise MemoryError
        return learn(self, batch, stop)

    monkeypatch.setattr(grid_training.GridTraining, "learn", killed)
    with pytest.raises(MemoryError):
        train_grid_network("pressure", replace(parts, save_every=3), progress=False)
    monkeypatch.setattr(grid_training.GridTraining, "learn", learn)
    summary = train_grid_network("pressure", replace(parts, resume=True), progress=False)
    assert summary["choices"]["rate"] == chosen != 1e-3
    assert (tmp_path / "parts" / "rates.png").read_bytes()[:4] == PNG
    assert_same_training(tmp_path / "whole", tmp_path / "parts")


@pytest.fixture(scope="module")
def made(data, tmp_path_factory) -> TrainOptions:
    """A finished training of one epoch, not to be changed."""
    made = options(data, tmp_path_factory.mktemp("made"), epochs=1, rate=0.01, log_every=1)
    with mock.patch.object(grid_training, "save_figure", lambda figure, path: path.write_bytes(PNG)):
        train_grid_network("pressure", made, progress=False)
    return made


@pytest.fixture
def finished(made, tmp_path, undrawn) -> TrainOptions:
    """A copy of it."""
    shutil.copytree(made.out, tmp_path, dirs_exist_ok=True)
    return replace(made, out=tmp_path)


def test_a_finished_training_stays_as_it_is(finished, tmp_path):
    before = trained(tmp_path)
    summary = train_grid_network("pressure", replace(finished, resume=True), progress=False)
    assert summary["complete"]
    assert all(torch.equal(tensor, before[name]) for name, tensor in trained(tmp_path).items())


def test_more_epochs_continue_as_if_they_had_been_asked_for(data, tmp_path, undrawn):
    changes = {"schedule": "decay", "decay": 0.1}
    whole, parts = (options(data, tmp_path / name, epochs=3, **changes) for name in ("whole", "parts"))
    train_grid_network("pressure", whole, progress=False)
    assert train_grid_network("pressure", replace(parts, epochs=1), progress=False)["complete"]
    summary = train_grid_network("pressure", replace(parts, resume=True), progress=False)
    assert summary["complete"] and summary["epochs"] == 3
    assert_same_training(tmp_path / "whole", tmp_path / "parts")
    with pytest.raises(ValueError, match=r"epochs is 2; the training in .*parts has done 3 of 3: go on with as many"):
        train_grid_network("pressure", replace(parts, resume=True, epochs=2), progress=False)


def test_more_epochs_after_one_cycle_are_another_cycle(finished, tmp_path, monkeypatch):
    first = [row["train/rate"] for row in logged(tmp_path) if "train/rate" in row]
    learn = grid_training.GridTraining.learn
    longer = replace(finished, resume=True, epochs=3)
    stopped = len(first) + 2
    monkeypatch.setattr(
        grid_training.GridTraining, "learn", lambda self, batch, stop=False: learn(self, batch, self.step == stopped)
    )
    assert not train_grid_network("pressure", longer, progress=False)["complete"]
    monkeypatch.setattr(grid_training.GridTraining, "learn", learn)
    with pytest.raises(ValueError, match=r"epochs is 4; the training in .* is within one cycle of 3: finish that"):
        train_grid_network("pressure", replace(longer, epochs=4), progress=False)
    assert train_grid_network("pressure", longer, progress=False)["complete"]
    rates = [row["train/rate"] for row in logged(tmp_path) if "train/rate" in row]
    assert rates[: len(first)] == first and len(rates) == 3 * len(first)
    second = rates[len(first) :]
    assert max(second) == pytest.approx(0.01, rel=0.05)
    assert 2.0 * first[-1] < second[0] < max(second) > 20.0 * second[-1]  # up again, and down to nothing


def test_a_loss_that_is_not_finite_stops_with_the_last_save_whole(data, tmp_path, undrawn):
    chosen = options(data, tmp_path, optimizer="sgd", schedule="constant", rate=1e12, save_every=1)
    with pytest.raises(ValueError, match=r"the (loss|gradient) of step \d+ is (nan|inf|-inf)"):
        train_grid_network("pressure", chosen, progress=False)
    model, _ = load_checkpoint(tmp_path / "last.safetensors")
    assert all(torch.isfinite(weight).all() for weight in model.parameters())


def test_another_training_is_not_continued(finished, tmp_path):
    for network, changes, message in (
        ("pressure", {"batch_size": 4}, "was trained with batch_size = 8; this run has 4"),
        ("pressure", {"nodes": 15}, "was trained with rows = 17; this run has 15"),
        ("pressure", {"loss": "energy"}, "was trained with loss = 'grid_mse'; this run has 'energy'"),
        ("unet", {}, "was trained with network = 'pressure'; this run has 'unet'"),
    ):
        with pytest.raises(ValueError, match=message):
            train_grid_network(network, replace(finished, resume=True, **changes), progress=False)
    with pytest.raises(FileNotFoundError, match=r"training\.safetensors is not there"):
        train_grid_network("pressure", replace(finished, resume=True, out=tmp_path / "other"), progress=False)


def test_held_out_worlds_are_never_trained_on(tmp_path):
    recipe = Recipe(scene=SCENE, options=GenerateOptions(worlds=2, steps=40, seed=HELD_OUT_SEED))
    generate(recipe, tmp_path / "data", threads=1, progress=False)
    with pytest.raises(ValueError, match=f"has worlds of seeds from {HELD_OUT_SEED} on"):
        train_grid_network("pressure", options(tmp_path / "data", tmp_path / "out"), progress=False)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("network", "changes", "message"),
    [
        ("lenet", {}, r"network is 'lenet'; it must be one of \('convfc', 'pressure', 'peak', 'unet', 'contactnet'"),
        ("unet", {"epochs": 0}, r"epochs is 0; it must be an integer in \[1, 2147483647\]"),
        ("unet", {"decay": -1.0}, "decay is -1.0; it must be finite and >= 0"),
        ("unet", {"walls": math.inf}, "walls is inf"),
        ("unet", {"clip": 0.0}, "clip is 0.0; it must be finite and > 0"),
        ("unet", {"validation": 1.0}, r"validation is 1.0; it must be in \(0, 1\)"),
        ("unet", {"find_rate": True, "rate": 0.1}, "rate is 0.1, and find_rate asks for another one"),
        ("unet", {"batch_size": 10_000}, "has fewer training states than a batch of 10000"),
        ("unet", {"rate": 0.0}, "rate is 0.0; it must be finite and > 0"),
        ("unet", {"nodes": 1}, r"nodes is 1; it must be an integer in \[8, 65536\)"),
        ("unet", {"h": 0.0}, "h is 0.0"),
        ("unet", {"data": Path("nowhere")}, "nowhere has no index.h5"),
    ],
)
def test_options_out_of_range_are_refused(data, tmp_path, network, changes, message):
    with pytest.raises(ValueError, match=message):
        train_grid_network(network, options(**{"data": data, "out": tmp_path / "out", **changes}), progress=False)
    assert not (tmp_path / "out").exists()


def test_the_command_trains_and_prints(data, tmp_path, capsys, undrawn):
    arguments = ["train", "unet", "--data", str(data), "--out", str(tmp_path), "--width", "0.25", "--nodes", "17"]
    arguments += ["--stride", "20", "--epochs", "1", "--batch-size", "8", "--cached"]
    assert main(arguments) == 0
    text = capsys.readouterr().out
    assert "validation loss: last" in text
    assert "squared error of tangential impulses" in text
    manifest = load_checkpoint(tmp_path / "best.safetensors")[1]
    assert manifest["images"]["contact_channels"] == ["impulse_n", "impulse_t"]
    assert main([*arguments, "--json", "--resume"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["complete"]


RANKS = """
import sys
from pathlib import Path
from safetensors.torch import save_file
from pipeline.training import grid as grid_training
from pipeline.training.options import TrainOptions

train_grid_network = grid_training.train_grid_network

class Run(grid_training.GridTraining):
    def finish(self, began):
        weights = {name: tensor.contiguous() for name, tensor in self.model.state_dict().items()}
        save_file(weights, Path(sys.argv[2]) / f"rank{self.group.rank}.safetensors")
        return super().finish(began)

grid_training.GridTraining = Run
grid_training.save_figure = lambda figure, path: path.touch()
train_grid_network("pressure", TrainOptions(data=Path(sys.argv[1]), out=Path(sys.argv[2]), **SETTINGS), progress=False)
"""


def test_two_processes_train_as_one(data, tmp_path, undrawn):
    """Contacts differ from share to share, and the mean over the whole batch's is what counts."""
    settings = {"width": 0.5, "nodes": 17, "stride": 8, "batch_size": 8, "epochs": 2, "loss": "contact_mse"}
    settings.update(optimizer="sgd", schedule="decay", rate=0.02)
    out = tmp_path / "two"
    out.mkdir()
    script = tmp_path / "ranks.py"
    script.write_text(RANKS.replace("SETTINGS", repr(settings)))
    # what torchrun does, without its own import of torch: contactnet/test_contact_training.py has torchrun itself
    meeting = torch.distributed.TCPStore("127.0.0.1", 0, is_master=True, wait_for_workers=False)
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT), "WORLD_SIZE": "2"}
    environment |= {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(meeting.port)}
    environment |= {"TORCHELASTIC_USE_AGENT_STORE": "True", "TORCHELASTIC_RESTART_COUNT": "0"}
    command = [sys.executable, str(script), str(data), str(out)]
    ranks = [
        subprocess.Popen(command, env={**environment, "RANK": rank}, stderr=subprocess.PIPE, text=True) for rank in "01"
    ]
    try:
        for rank in ranks:
            _, err = rank.communicate(timeout=280)
            assert rank.returncode == 0, err
    finally:
        for rank in ranks:
            rank.kill()
            rank.wait()
    first, second = (safetensors.torch.load_file(out / f"rank{rank}.safetensors") for rank in range(2))
    for name, tensor in first.items():
        assert torch.equal(tensor, second[name]), name
    alone = TrainOptions(data=data, out=tmp_path / "one", **settings)
    summary = train_grid_network("pressure", alone, progress=False)
    assert json.loads((out / "train.json").read_text())["steps"] == summary["steps"]
    fresh = models.build("pressure", load_checkpoint(out / "last.safetensors")[0].config).state_dict()
    for name, tensor in load_checkpoint(tmp_path / "one" / "last.safetensors")[0].state_dict().items():
        torch.testing.assert_close(
            first[name], tensor, rtol=1e-4, atol=1e-6, msg=lambda text, name=name: f"{name}: {text}"
        )
        if name.endswith("weight"):
            assert (fresh[name] - tensor).abs().max() > 1e-3  # round-off is not all that was compared
    with pytest.raises(ValueError, match="batch_size is 7; 2 processes cannot share it evenly"):
        grid_training.GridTraining("pressure", replace(alone, batch_size=7), Processes(0, 2))


def test_several_folders_are_trained_on_as_one(data, tmp_path, undrawn, capsys):
    more, out = tmp_path / "more", tmp_path / "out"
    generate(Recipe(scene=SCENE, options=GenerateOptions(worlds=2, steps=70, seed=8)), more, threads=1, progress=False)
    short = [
        "--width",
        "0.25",
        "--nodes",
        "17",
        "--stride",
        "20",
        "--epochs",
        "1",
        "--batch-size",
        "8",
        "--out",
        str(out),
    ]
    assert main(["train", "pressure", *short, "--json", "--data", str(data), str(more)]) == 0
    summary = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert summary["options"]["data"] == [str(data), str(more)]
    assert summary["data"]["worlds"] == 10 and summary["data"]["seeds"] == [0, 10]
    assert load_checkpoint(out / "last.safetensors")[1]["options"]["data"] == [str(data), str(more)]
    with pytest.raises(ValueError, match="there is no folder to read"):
        train_grid_network("pressure", options((), out), progress=False)
    with pytest.raises(ValueError, match=f"{data}, {more} has fewer training states"):
        train_grid_network("pressure", options((data, more), out, stride=69, batch_size=100), progress=False)
