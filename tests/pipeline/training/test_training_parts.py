"""The parts of a training loop: optimiser, schedule, rate finder, log."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

torch = pytest.importorskip("torch")
torch.set_num_threads(1)

from pipeline.training.log import Log  # noqa: E402
from pipeline.training.optimizer import (  # noqa: E402
    check_loss,
    clip_gradients,
    make_optimizer,
    make_schedule,
)
from pipeline.training.processes import seed_everything  # noqa: E402
from pipeline.training.rate import find_rate  # noqa: E402


def test_sgd_takes_the_steps_of_nesterov():
    """Momentum m v + g, then x - rate (g + m v) (Sutskever et al. 2013), with Wu's (2018) momentum and decay."""
    x = torch.tensor([1.0, -2.0], dtype=torch.float64, requires_grad=True)
    optimizer = make_optimizer([x], "sgd", 0.01)
    schedule = make_schedule(optimizer, "decay", 100, decay=1e-2)
    place, momentum = x.detach().clone(), torch.zeros(2, dtype=torch.float64)
    for step in range(4):
        optimizer.zero_grad()
        (x**3).sum().backward()
        gradient = 3.0 * place**2
        momentum = 0.9 * momentum + gradient
        place = place - 0.01 / (1.0 + 1e-2 * step) * (gradient + 0.9 * momentum)
        optimizer.step()
        schedule.step()
        torch.testing.assert_close(x.detach(), place)


def rates(name: str, steps: int = 50) -> list[float]:
    optimizer = make_optimizer([torch.zeros(1, requires_grad=True)], "adamw", 0.1)
    schedule = make_schedule(optimizer, name, steps)
    found = []
    for _ in range(steps):
        found.append(optimizer.param_groups[0]["lr"])
        optimizer.step()
        schedule.step()
    return found


def test_one_cycle_goes_up_and_down():
    found = np.array(rates("onecycle"))
    top = int(found.argmax())
    assert found[top] == pytest.approx(0.1, rel=0.01)
    assert 10 <= top <= 20
    assert (np.diff(found[:top]) > 0).all()
    assert (np.diff(found[top + 1 :]) < 0).all()
    assert found[0] == pytest.approx(0.1 / 25)
    assert found[-1] < 1e-4
    assert set(rates("constant")) == {0.1}


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda p: make_optimizer(p, "adam", 1.0),
            r"optimizer is 'adam'; it must be one of \('sgd', 'adamw'\)",
        ),
        (lambda p: make_optimizer(p, "sgd", 0.0), "rate is 0.0; it must be finite and > 0"),
        (lambda p: make_optimizer(p, "sgd", math.nan), "rate is nan"),
        (lambda p: make_schedule(make_optimizer(p, "sgd", 1.0), "steps", 5), "schedule is 'steps'"),
        (lambda p: make_schedule(make_optimizer(p, "sgd", 1.0), "decay", 0), "steps is 0"),
        (lambda p: seed_everything(-1), "seed is -1"),
        (lambda p: check_loss(torch.tensor(math.inf), 17), "the loss of step 17 is inf"),
    ],
)
def test_parts_out_of_range_are_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call([torch.zeros(1, requires_grad=True)])


def test_gradients_are_cut_and_a_broken_one_stops():
    weight = torch.zeros(4, requires_grad=True)
    weight.grad = torch.full((4,), 3.0)
    assert clip_gradients([weight], None, 0) == 6.0
    assert clip_gradients([weight], 1.5, 0) == 6.0
    assert float(weight.grad.norm()) == pytest.approx(1.5, rel=1e-4)
    weight.grad[1] = math.nan
    with pytest.raises(ValueError, match="the gradient of step 5 is nan"):
        clip_gradients([weight], 1.5, 5)


class Bowl(torch.nn.Module):
    """A parabola for a network, of batches that differ in height: plain SGD diverges beyond 2 / curvature."""

    CURVATURE = 50.0

    def __init__(self):
        super().__init__()
        self.x = torch.nn.Parameter(torch.tensor([1.0]))

    def loss(self, i):
        scale = 10.0 ** (i % 3)
        return scale * (1.0 + 0.5 * self.CURVATURE / scale * self.x.square().sum())


def test_the_rate_finder_stays_below_divergence_and_leaves_no_trace():
    bowl = Bowl()
    optimizer = make_optimizer(bowl.parameters(), "sgd", 1.0, momentum=0.0)
    state = torch.get_rng_state()
    search = find_rate(bowl, optimizer, bowl.loss, lowest=1e-5, highest=10.0, steps=100)
    assert float(bowl.x.detach()) == 1.0
    assert torch.equal(torch.get_rng_state(), state)
    assert 0.2 / Bowl.CURVATURE / 10.0 < search.rate < 2.0 / Bowl.CURVATURE
    assert 2.0 / Bowl.CURVATURE < search.rates[-1] < 10.0  # it saw where it diverges, and went no further
    assert search.losses[0] == pytest.approx(1.0, rel=1e-2)
    with pytest.raises(ValueError, match="the loss of batch 0 is nan before any step"):
        find_rate(bowl, optimizer, lambda i: bowl.loss(i) * math.nan)
    with pytest.raises(ValueError, match=r"rates are 1\.0 to 0\.1"):
        find_rate(bowl, optimizer, bowl.loss, lowest=1.0, highest=0.1)


def test_a_log_that_goes_on_drops_what_came_after(tmp_path):
    log = Log(tmp_path)
    for step in (5, 10, 15):
        log.add(step, {"train/loss": 1.0 / step})
    log.close()
    with (tmp_path / "metrics.jsonl").open("a") as file:
        file.write('{"step": 20, "tra')  # a killed run's half line
    log = Log(tmp_path, 10)
    log.add(12, {"train/loss": 0.5})
    log.close()
    rows = [json.loads(line) for line in (tmp_path / "metrics.jsonl").read_text().splitlines()]
    assert [row["step"] for row in rows] == [5, 10, 12]
    assert log.series("train/loss") == ([5, 10, 12], [0.2, 0.1, 0.5])
    assert list((tmp_path / "tensorboard").iterdir())


def test_a_log_that_was_cut_anywhere_goes_on_without_its_last_line(tmp_path):
    log = Log(tmp_path)
    for step in (5, 10):
        log.add(step, {"train/loss": 1.0 / step})
    log.close()
    whole = (tmp_path / "metrics.jsonl").read_bytes()
    last = whole.index(b"\n") + 1
    for cut in (1, 8, last - 2, last, last + 1, last + 9, len(whole) - 2, len(whole) - 1):
        (tmp_path / "metrics.jsonl").write_bytes(whole[:cut])
        log = Log(tmp_path, 10)
        log.add(12, {"train/loss": 0.5})
        log.close()
        kept = (cut >= last - 1) + (cut >= len(whole) - 1)  # a line is whole without its end, too
        rows = [json.loads(line) for line in (tmp_path / "metrics.jsonl").read_text().splitlines()]
        assert [row["step"] for row in rows] == [*[5, 10][:kept], 12]
