"""Files of networks and trainings: the same bits again, what stands in them, and what is refused."""

from __future__ import annotations

import json
import os
import resource
from dataclasses import asdict, dataclass
from pathlib import Path

import pytest

torch = pytest.importorskip("torch")
torch.set_num_threads(1)
import safetensors  # noqa: E402
import safetensors.torch  # noqa: E402

from dc_kernels.grid.grid import Grid  # noqa: E402
from dc_kernels.grid.image_spec import ImageSpec  # noqa: E402
from pipeline.networks import models, registry  # noqa: E402
from pipeline.networks.checkpoint import load_checkpoint, load_training, save_checkpoint, save_training  # noqa: E402
from pipeline.training.optimizer import make_optimizer, make_schedule  # noqa: E402
from pipeline.training.processes import seed_everything  # noqa: E402

GRID = Grid(rows=12, columns=9, spacing=0.25, origin=(-1.0, 0.5))
CONFIG = models.GridConfig(rows=12, columns=9, channels=3, width=0.1)
MANIFEST = {"images": ImageSpec(GRID).to_dict(), "seed": 3, "metrics": {"loss": 0.1}, "names": ["a", "b"]}


def images(seed: int = 0):
    return torch.randn(4, 3, 12, 9, generator=torch.Generator().manual_seed(seed))


def network(name: str = "convfc", seed: int = 0, config: models.GridConfig = CONFIG):
    torch.manual_seed(seed)
    model = models.build(name, config)
    model.set_scales([1.0, 2.0, 3.0], [0.5, 0.25], bound=10.0)
    model.train()(images())  # so that batch norm has seen something
    return model


@pytest.fixture
def saved(tmp_path) -> Path:
    path = tmp_path / "network.safetensors"
    save_checkpoint(path, network(), MANIFEST)
    return path


@pytest.mark.parametrize("name", ["convfc", "pressure", "peak", "unet"])
def test_a_network_comes_back_as_it_was(tmp_path, name):
    model = network(name)
    save_checkpoint(tmp_path / "a.safetensors", model, MANIFEST)
    found, manifest = load_checkpoint(tmp_path / "a.safetensors", network=name, grid=GRID)
    assert manifest == MANIFEST
    assert not found.training
    assert (found.network_name, found.config) == (name, CONFIG)
    assert torch.equal(found(images(1)), model.eval()(images(1)))
    assert [path.name for path in tmp_path.iterdir()] == ["a.safetensors"]


def test_a_file_tells_without_this_code_what_it_is(saved):
    with safetensors.safe_open(saved, framework="np") as file:
        described = file.metadata()
        assert set(file.keys()) == set(network().state_dict())
    assert (described["schema"], described["version"]) == ("deep-contact.network", "1")
    assert described["network"] == "convfc"
    assert json.loads(described["config"]) == asdict(CONFIG)
    assert json.loads(described["manifest"]) == MANIFEST


def test_a_registered_network_of_another_kind_comes_back(tmp_path, monkeypatch):
    @dataclass(frozen=True, kw_only=True)
    class Config:
        widths: tuple[int, ...] = (1, 2)

    class Other(torch.nn.Module):
        def __init__(self, config):
            super().__init__()
            self.layer = torch.nn.Linear(*config.widths)

    monkeypatch.setitem(registry.NETWORKS, "other", registry.Entry(Config, Other, None, None))
    model = models.build("other", Config(widths=(3, 5)))
    save_checkpoint(tmp_path / "a.safetensors", model, {})
    found, _ = load_checkpoint(tmp_path / "a.safetensors")
    assert found.config == Config(widths=(3, 5))
    assert torch.equal(found.layer.weight, model.layer.weight)


# ---------------------------------------------------------------------- refusals


def rewritten(path: Path, tensors=None, **metadata) -> Path:
    """The file with some strings of its metadata, or its tensors, replaced."""
    with safetensors.safe_open(path, framework="pt") as file:
        described = {**file.metadata(), **metadata}
        kept = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    kept = kept if tensors is None else tensors(kept)
    safetensors.torch.save_file(kept, path, {name: value for name, value in described.items() if value is not None})
    return path


def without(name):
    return lambda kept: {key: value for key, value in kept.items() if key != name}


def replaced(name, value):
    return lambda kept: {**kept, name: value}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda path: path.write_bytes(path.read_bytes()[:-10]), "is damaged or no safetensors file"),
        (lambda path: path.write_bytes(path.read_bytes()[:100]), "is damaged or no safetensors file"),
        (lambda path: path.write_bytes(b""), "is damaged or no safetensors file"),
        (lambda path: path.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(200)), "is damaged or no safetensors file"),
        (lambda path: rewritten(path, schema="foreign"), "has the schema 'foreign'; it must be 'deep-contact.network'"),
        (lambda path: safetensors.torch.save_file({"a": torch.ones(1)}, path), "has the schema None"),
        (lambda path: rewritten(path, version="2"), "has version 2 of deep-contact.network; this code reads 1"),
        (lambda path: rewritten(path, network="lenet"), "network is 'lenet'; it must be one of"),
        (lambda path: rewritten(path, config=None), "its metadata have no readable 'config'"),
        (lambda path: rewritten(path, manifest="{"), "its metadata have no readable 'manifest'"),
        (lambda path: rewritten(path, config='{"rows": 7}'), "GridConfig.rows is 7"),
        (lambda path: rewritten(path, without("layers.0.bias")), "lacks 'layers.0.bias', unlike convfc"),
        (lambda path: rewritten(path, replaced("extra", torch.ones(1))), "has 'extra', unlike convfc"),
        (
            lambda path: rewritten(path, replaced("layers.0.bias", torch.ones(2))),
            r"layers.0.bias is torch.float32 \(2,\); convfc has torch.float32 \(6,\)",
        ),
        (
            lambda path: rewritten(path, replaced("layers.0.bias", torch.tensor([0.0, 1.0, torch.nan, 0.0, 0.0, 0.0]))),
            r"layers.0.bias\[2\] is nan; it must be finite",
        ),
        (
            lambda path: rewritten(path, replaced("layers.1.running_var", torch.full((6,), torch.inf))),
            r"layers.1.running_var\[0\] is inf; it must be finite",
        ),
        (
            lambda path: rewritten(path, replaced("input_bound", torch.tensor(torch.nan))),
            "input_bound is nan; it must be finite",
        ),
        (lambda path: rewritten(path, network="unet"), "unlike unet"),
        (lambda path: rewritten(path, network=None), "its metadata do not name the network"),
        *(
            (lambda path, name=name, text=text: rewritten(path, **{name: text}), f"no readable '{name}'|'{name}' is a")
            for name in ("config", "manifest")
            for text in ("[]", "3", '"text"', "null", "[" * 100_000, "1" * 10_000, "\x00")
        ),
        (lambda path: rewritten(path, config='{"rows": "many"}'), "rows"),
        (lambda path: rewritten(path, config='{"rows": [1, 2]}'), "rows"),
        (lambda path: rewritten(path, config='{"width": null}'), "width"),
        (
            lambda path: rewritten(path, config='{"rows": 65535, "columns": 65535, "width": 16}'),
            "unlike convfc|is torch",
        ),
        (lambda path: rewritten(path, manifest='{"images": 3}'), "images are no description of images"),
        (lambda path: rewritten(path, manifest='{"images": {"grid": {"rows": 1e300}}}'), "no description of images"),
        (lambda path: rewritten(path, network="contactnet", config='{"near": 1e12}'), "network.safetensors"),
        (lambda path: rewritten(path, network="contactnet", config='{"near": 1000000000000}'), "network.safetensors"),
        (lambda path: rewritten(path, network="contactnet", config=json.dumps({"channels": [1] * 10**6})), "entries"),
    ],
)
def test_a_damaged_or_foreign_file_is_refused(saved, change, message, monkeypatch):
    change(saved)
    monkeypatch.setattr(torch.nn.Module, "load_state_dict", None)  # nothing is loaded
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(ValueError, match=message):
        load_checkpoint(saved)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < before + 200_000  # kB


def test_what_is_no_file_is_not_read(tmp_path):
    os.mkfifo(tmp_path / "fifo.safetensors")
    with pytest.raises(OSError, match="is a FIFO, not a file"):
        load_checkpoint(tmp_path / "fifo.safetensors")
    with pytest.raises(IsADirectoryError, match="is a folder, not a file"):
        load_checkpoint(tmp_path)


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"none\.safetensors is not there"):
        load_checkpoint(tmp_path / "none.safetensors")


def test_another_network_or_grid_than_asked_for_is_refused(saved):
    with pytest.raises(ValueError, match="holds the network 'convfc', not 'unet'"):
        load_checkpoint(saved, network="unet")
    other = Grid(rows=12, columns=9, spacing=0.5, origin=(-1.0, 0.5))
    with pytest.raises(ValueError, match=r"was trained on the grid .*0.25.*, not on .*0.5"):
        load_checkpoint(saved, grid=other)


def test_a_manifest_that_json_cannot_hold_leaves_the_old_file_whole(saved):
    before = saved.read_bytes()
    with pytest.raises(ValueError, match="manifest holds what JSON cannot"):
        save_checkpoint(saved, network(seed=1), {"path": Path("a")})
    assert saved.read_bytes() == before


def test_a_write_that_fails_leaves_the_old_file_whole(saved, monkeypatch):
    before = saved.read_bytes()

    def full(descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match=r"network\.safetensors was not written: No space left on device"):
        save_checkpoint(saved, network(seed=1), MANIFEST)
    assert saved.read_bytes() == before
    assert [path.name for path in saved.parent.iterdir()] == [saved.name]


def test_others_may_read_a_file_where_they_may_read_any(saved):
    beside = saved.with_name("beside")
    beside.write_bytes(b"")
    assert saved.stat().st_mode == beside.stat().st_mode


# ---------------------------------------------------------------------- trainings

STEPS = 12


def training(optimizer: str, schedule: str):
    """A network that drops values and has batch norm, its optimiser and schedule."""
    seed_everything(5)
    model = models.build("convfc", CONFIG).train()
    made = make_optimizer(model.parameters(), optimizer, 1e-2, weight_decay=1e-3)
    return model, made, make_schedule(made, schedule, STEPS)


def learn(model, optimizer, schedule, steps: range) -> None:
    for step in steps:
        optimizer.zero_grad()
        model(images(step)).square().mean().backward()
        optimizer.step()
        schedule.step()


def bits(model, optimizer) -> list[torch.Tensor]:
    """All that a training has come to."""
    state = sorted(optimizer.state_dict()["state"].items())
    momenta = [value for _, values in state for _, value in sorted(values.items()) if value is not None]
    return [tensor.clone() for tensor in (*model.state_dict().values(), *momenta, torch.get_rng_state())]


@pytest.mark.parametrize("optimizer", ["sgd", "adamw"])
@pytest.mark.parametrize("schedule", ["constant", "decay", "onecycle"])
@pytest.mark.parametrize("half", [0, 5])
def test_a_training_that_goes_on_has_the_bits_of_one_that_never_stopped(tmp_path, optimizer, schedule, half):
    path = tmp_path / "training.safetensors"
    whole = training(optimizer, schedule)
    learn(*whole, range(STEPS))
    wanted = bits(*whole[:2])

    first = training(optimizer, schedule)
    learn(*first, range(half))
    save_training(path, *first, {"step": half}, {"data": "a"}, {"own": torch.arange(3)})
    second = training(optimizer, schedule)
    learn(*second, range(3))  # what was there before the load must not matter
    torch.manual_seed(99)
    progress, extra = load_training(path, *second, {"data": "a"})
    assert progress == {"step": half}
    assert torch.equal(extra["own"], torch.arange(3))
    learn(*second, range(half, STEPS))
    found = bits(*second[:2])
    assert len(found) == len(wanted) > 30
    assert all(torch.equal(a, b) for a, b in zip(found, wanted))
    assert second[1].param_groups[0]["lr"] == whole[1].param_groups[0]["lr"]
    groups = [{k: v for k, v in made[1].param_groups[0].items() if k != "params"} for made in (second, whole)]
    assert groups[0] == groups[1]


def test_another_training_is_refused_by_its_first_difference(tmp_path):
    path = tmp_path / "training.safetensors"
    model, optimizer, schedule = training("sgd", "decay")
    save_training(path, model, optimizer, schedule, {}, {"batch_size": 8, "data": {"worlds": 3}})
    other = network("pressure")
    before = bits(model, optimizer)
    for identity, message in (
        ({"batch_size": 4, "data": {"worlds": 3}}, "was trained with batch_size = 8; this run has 4"),
        ({"batch_size": 8, "data": {"worlds": 4}}, "was trained with data = {'worlds': 3}; this run has {'worlds': 4}"),
        ({"batch_size": 8, "data": {"worlds": 3}, "clip": 1.0}, "was trained with clip = None; this run has 1.0"),
    ):
        with pytest.raises(ValueError, match=message):
            load_training(path, model, optimizer, schedule, identity)
    with pytest.raises(ValueError, match="was trained with network = 'convfc'; this run has 'pressure'"):
        load_training(path, other, make_optimizer(other.parameters(), "sgd", 1.0), None, {})
    with pytest.raises(ValueError, match=r"has the schema 'deep-contact.training'; it must be 'deep-contact.network'"):
        load_checkpoint(path)
    assert all(torch.equal(a, b) for a, b in zip(bits(model, optimizer), before))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda state: state.pop("identity"), "its state has no identity"),
        (lambda state: state.update(identity=[]), "its state has no identity"),
        (lambda state: state.pop("groups"), "is damaged: KeyError"),
        (lambda state: state.update(groups=[]), "its groups of parameters are not those of the optimiser"),
        (lambda state: state.update(scalars={"x/step": 1}), "is damaged: ValueError"),
        (lambda state: state.update(progress=3), "its progress is an int"),
        (lambda state: state.update(schedule=7), "is damaged: "),
    ],
)
def test_a_damaged_training_is_refused(tmp_path, change, message):
    path = tmp_path / "training.safetensors"
    model, optimizer, schedule = training("adamw", "decay")
    learn(model, optimizer, schedule, range(2))
    save_training(path, model, optimizer, schedule, {"step": 2}, {"seed": 1})
    with safetensors.safe_open(path, framework="pt") as file:
        state = json.loads(file.metadata()["state"])
    change(state)
    rewritten(path, state=json.dumps(state))
    with pytest.raises(ValueError, match=message) as caught:
        load_training(path, model, optimizer, schedule, {"seed": 1})
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("name", ["exp_avg", "exp_avg_sq", "step"])
def test_a_training_whose_optimiser_is_not_finite_is_refused(tmp_path, name):
    path = tmp_path / "training.safetensors"
    model, optimizer, schedule = training("adamw", "decay")
    learn(model, optimizer, schedule, range(2))
    save_training(path, model, optimizer, schedule, {}, {})
    rewritten(path, lambda kept: {**kept, f"optimizer/0/{name}": kept[f"optimizer/0/{name}"] * torch.nan})
    with pytest.raises(ValueError, match=rf"training\.safetensors: optimizer/0/{name}.* is nan; it must be finite"):
        load_training(path, model, optimizer, schedule, {})


def test_a_training_with_tensors_of_another_shape_is_refused(tmp_path):
    path = tmp_path / "training.safetensors"
    model, optimizer, schedule = training("adamw", "decay")
    learn(model, optimizer, schedule, range(2))
    save_training(path, model, optimizer, schedule, {}, {})
    rewritten(path, replaced("optimizer/0/exp_avg", torch.ones(3)))
    with pytest.raises(ValueError, match=r"optimizer/0/exp_avg has shape \(3,\); its weight has"):
        load_training(path, model, optimizer, schedule, {})
    save_training(path, model, optimizer, schedule, {}, {})
    rewritten(path, replaced("rng", torch.ones(3)))
    with pytest.raises(ValueError, match="is damaged"):
        load_training(path, model, optimizer, schedule, {})
