"""Training of a ContactNet: corrections are the kernel's, gradients reach the weights, resumption is exact."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import dc_kernels as dc
from dc_kernels.learn.channels import OUTPUT
from pipeline.contactnet import training as contact_training
from pipeline.contactnet.loss import CallBatch, corrected, errors_left, on_cone
from pipeline.contactnet.network import EvenShare
from pipeline.contactnet.options import ContactTrainOptions
from pipeline.contactnet.rollouts import Recorder, Setting, record
from pipeline.contactnet.training import ContactTraining, describe_contact_training, train_contactnet
from pipeline.contactnet.tuning import GAINS, Crowd, best_gain, choose_gains
from pipeline.networks import models
from pipeline.networks.checkpoint import load_checkpoint
from pipeline.options import RunOptions
from pipeline.process import Stop
from pipeline.scenes import Thesis
from pipeline.seeds import TUNING_SEED, VALIDATION_SEED
from pipeline.starts.learned import CallOptions, LearnedSolve
from pipeline.training.processes import Processes

FEW = (
    Crowd(bodies=30, worlds=2, acceleration="none", steps=(100, 120)),
    Crowd(bodies=30, worlds=2, acceleration="aitken", steps=(100,)),
)
SMALL = (
    Setting(bodies=30, worlds=3, acceleration="none", solves=6, calls=2, steps=120, max_sweeps=400),
    Setting(bodies=30, worlds=3, acceleration="aitken", solves=6, calls=2, steps=120, max_sweeps=400),
)


@pytest.fixture(autouse=True)
def one_thread(monkeypatch):
    torch.set_num_threads(1)
    monkeypatch.setattr(contact_training, "SETTINGS", SMALL)
    monkeypatch.setattr(contact_training, "choose_gains", lambda model, seed: choose_gains(model, seed, FEW))


def recorded(acceleration: str = "none", begin: bool = False):
    """A paused solve of three worlds with what the network reads, and the same as a batch."""
    sim = RunOptions(worlds=3, seed=3).simulation(Thesis(bodies=40), dc.SolverConfig(acceleration=acceleration))
    sim.run(112, 0.01)
    sim.collide(0.01)
    solve = LearnedSolve(sim, EvenShare(), CallOptions(every=12, begin=True))
    recorder = Recorder(solve, np.random.default_rng(0))
    recorder.share = 1
    seen = {}

    def watch(worlds: np.ndarray, first: bool) -> None:
        if first == begin and not seen and len(worlds) == 3:
            recorder.watch(worlds, first)
            seen["sweeps"] = sim.stats.numpy("sweeps").copy()

    solve.watch = watch
    solve.solve()
    calls = sorted(recorder.take(3), key=lambda call: call["world"])
    assert [call["world"] for call in calls] == [0, 1, 2]
    return sim, solve, calls, seen


@pytest.mark.parametrize("begin", [True, False])
def test_a_correction_is_that_of_the_kernel(begin):
    """The kernel's impulses after an arbitrary answer, against those of training."""
    sim = RunOptions(worlds=3, seed=3).simulation(Thesis(bodies=40), dc.SolverConfig(acceleration="none"))
    sim.run(112, 0.01)
    sim.collide(0.01)

    class Drawn(EvenShare):
        def head(self, local, near):
            self.output = 0.5 * torch.randn(len(local), len(OUTPUT), generator=torch.Generator().manual_seed(1))
            return self.output

    solve = LearnedSolve(sim, Drawn(), CallOptions(every=12, begin=begin, pays=0.0))
    found = []

    def watch(worlds: np.ndarray, first: bool) -> None:
        if first == begin and not found:
            reader = solve.reader
            slots = np.concatenate(
                [
                    sim.contacts.numpy("contact_start")[w] + np.arange(sim.contacts.numpy("contact_count")[w])
                    for w in worlds
                ]
            )
            world = np.repeat(np.arange(len(worlds)), np.diff(reader.packed_start[: len(worlds) + 1]))
            arrays = sim.contacts.numpy("impulse")[slots], reader.step[: reader.count], reader.rate[: reader.count]
            found.extend([slots, *(torch.from_numpy(a.copy()) for a in (*arrays, reader.scale[world]))])

    solve.watch = watch
    correct = solve.reader.correct

    def note(output):
        taken = correct(output)
        if len(found) == 5:
            found.append(sim.contacts.numpy("impulse")[found[0]].copy())
            found.append(output.clone())
        return taken

    solve.reader.correct = note
    solve.solve()
    slots, impulse, step, rate, scale, after, output = found
    friction = torch.from_numpy(sim.contacts.numpy("friction")[slots])
    wanted = on_cone(corrected(output, impulse, step, rate, scale), friction)
    np.testing.assert_allclose(after, wanted.numpy(), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("acceleration", ["none", "aitken"])
def test_gradients_reach_every_weight(acceleration):
    _, solve, calls, _ = recorded(acceleration)
    torch.manual_seed(0)
    model = models.build("contactnet")
    for parameter in model.last.parameters():
        parameter.data.normal_(0.0, 0.05)
    errors = errors_left(CallBatch.of(calls), model, solve.reader.grid, 10)
    assert all(torch.isfinite(value).all() for value in errors.values())
    sum(value.sum() for value in errors.values()).backward()
    dead = [name for name, p in model.named_parameters() if p.grad is None or not p.grad.abs().sum() > 0]
    assert dead == []


def test_steps_on_a_batch_lower_its_error(tmp_path):
    training = ContactTraining(ContactTrainOptions(out=tmp_path, rounds=1, steps=60, rate=3e-3), Processes())
    calls = training.record(0)
    batch = training.batch(calls, np.random.default_rng(0))
    gains = [training.step(batch, 0) for _ in range(60)]
    training.log.close()
    assert gains[0] == pytest.approx(0.0, abs=0.05)
    assert min(gains[-5:]) < gains[0] - 0.05


def test_a_training_goes_on_bit_for_bit(tmp_path, monkeypatch):
    options = ContactTrainOptions(out=tmp_path / "whole", rounds=2, steps=3, contacts=400)
    whole = train_contactnet(options, progress=False)
    assert whole["complete"] and whole["steps"] == 6
    assert "6 steps" in describe_contact_training(whole) and "gain of the answer" in describe_contact_training(whole)
    saved = ContactTraining.save

    class Killed(Exception):
        pass

    def save_and_die(self):
        saved(self)
        raise Killed

    half = replace(options, out=tmp_path / "half")
    monkeypatch.setattr(ContactTraining, "save", save_and_die)
    with pytest.raises(Killed):
        train_contactnet(half, progress=False)
    monkeypatch.setattr(ContactTraining, "save", saved)
    again = replace(half, resume=True)
    asked = Stop()
    monkeypatch.setattr(asked, "is_set", lambda: True)

    def choosing(model, seed):
        signal.raise_signal(signal.SIGINT)
        time.sleep(60.0)

    with monkeypatch.context() as patch:  # Ctrl-C while the gains are chosen
        patch.setattr(contact_training, "choose_gains", choosing)
        with pytest.raises(KeyboardInterrupt):
            train_contactnet(again, progress=False)
    summary = ContactTraining(again, Processes()).run(asked, progress=False)  # in the last round
    assert summary["steps"] == 6 and not summary["complete"] and not summary["tuning"]
    monkeypatch.setattr(contact_training, "save_figure", lambda figure, path: path.touch())
    assert train_contactnet(again, progress=False)["complete"]
    files = [Path(folder) / contact_training.NETWORK for folder in (options.out, half.out)]
    (a, manifest), (b, _) = (load_checkpoint(file) for file in files)
    assert manifest["rounds"] == 2 and max(manifest["seeds"]) <= VALIDATION_SEED
    for name, tensor in a.state_dict().items():
        assert torch.equal(tensor, b.state_dict()[name]), name
    with pytest.raises(ValueError, match="rate"):
        train_contactnet(replace(half, resume=True, rate=0.5), progress=False)
    tuning = manifest["tuning"]
    wanted = [best_gain(np.array(tuning[name])) for name in ("none_30", "aitken_30")]
    np.testing.assert_allclose(tuning["gain"], wanted, rtol=1e-6)
    assert best_gain(np.array([9.0, 9.0, 1.0, 1.0, 1.0, 9.0, 0.0])) == GAINS[3]
    for name in ("curves.png", "predictions.png", "train.json", "metrics.jsonl"):
        assert (options.out / name).stat().st_size > 0


def test_held_out_seeds_are_refused():
    with pytest.raises(ValueError, match="those from 100000 on are for tests"):
        record(EvenShare(), SMALL[0], 99_999, np.random.default_rng(0))
    with pytest.raises(ValueError, match="those from 80000 on are for the gains"):
        train_contactnet(ContactTrainOptions(rounds=2, seed=79_999), progress=False)


def test_the_network_in_bfloat16_answers_nearly_the_same():
    from pipeline.starts.registry import PRETRAINED

    model, manifest = load_checkpoint(PRETRAINED)
    assert model.network_name == "contactnet" and PRETRAINED.stat().st_size < 2e6
    assert max(manifest["seeds"]) <= TUNING_SEED and manifest["commit"] and manifest["metrics"]
    sweeps = []
    for bfloat16 in (False, True):
        sim = RunOptions(worlds=3, seed=3).simulation(
            Thesis(bodies=40), dc.SolverConfig.preset("accurate", acceleration="aitken")
        )
        sim.run(112, 0.01)
        sim.collide(0.01)
        solve = LearnedSolve(sim, model, bfloat16=bfloat16)
        solve.solve()
        assert (sim.stats.numpy("change") < sim.config.ends_at[1]).all() and solve.stats.calls.all()
        sweeps.append(sim.stats.numpy("sweeps").copy())
    assert (sweeps[0] != 0).all() and np.abs(np.log(sweeps[0] / sweeps[1])).max() < 1.5


SCRIPT = """
import sys
import torch
from pathlib import Path
from pipeline.contactnet import training as contact_training
from pipeline.contactnet import tuning
from pipeline.contactnet.options import ContactTrainOptions
from pipeline.contactnet.rollouts import Setting
from pipeline.training.processes import Processes

small = dict(bodies=30, worlds=3, solves=6, calls=2, steps=120, max_sweeps=400)
contact_training.SETTINGS = tuple(Setting(acceleration=a, **small) for a in ("none", "aitken"))
few = (tuning.Crowd(bodies=30, worlds=2, acceleration="aitken", steps=(100,)),)
contact_training.choose_gains = lambda model, seed: tuning.choose_gains(model, seed, few)
contact_training.save_figure = lambda figure, path: path.touch()
seeds = []
record = contact_training.record
def noted(model, setting, seed, generator):
    seeds.append(seed)
    return record(model, setting, seed, generator)
contact_training.record = noted
step = contact_training.ContactTraining.step
def kept(self, *arguments):
    result = step(self, *arguments)
    torch.save((seeds, self.model.state_dict()), f"{sys.argv[1]}/rank{self.group.rank}.pt")
    return result
contact_training.ContactTraining.step = kept
options = ContactTrainOptions(out=Path(sys.argv[1]), rounds=1, steps=3, contacts=400)
contact_training.train_contactnet(options, progress=False)
"""


def test_two_processes_record_worlds_of_their_own_and_agree(tmp_path):
    script = tmp_path / "train.py"
    script.write_text(SCRIPT)
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2", str(script)]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(Path(__file__).resolve().parents[3])}
    done = subprocess.run([*command, str(tmp_path)], env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr[-3000:]
    (seeds, first), (others, second) = (torch.load(tmp_path / f"rank{rank}.pt") for rank in (0, 1))
    assert not set(seeds[2:]) & set(others[2:])  # the first two are those of validation
    fresh = models.build("contactnet").state_dict()
    for name, tensor in first.items():
        assert torch.equal(tensor, second[name]), name
    assert not torch.equal(first["last.weight"], fresh["last.weight"])
    assert load_checkpoint(tmp_path / contact_training.NETWORK)[1]["rounds"] == 1
