"""A network in the loop of the solve: whatever it answers, the answer and the cost stay bounded; when it is called."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels.learn.channels import IMAGE, LOCAL, OUTPUT
from pipeline.options import RunOptions
from pipeline.scenes import Mixed, Scene, Settled, Thesis

torch = pytest.importorskip("torch")
torch.set_num_threads(1)

from dc_kernels.learn.differentiable import ContactProblem  # noqa: E402
from pipeline.contactnet.network import ContactNet  # noqa: E402
from pipeline.starts.learned import CallOptions, LearnedSolve  # noqa: E402
from pipeline.starts.start import step  # noqa: E402

DT = 0.01
STEPS = 120
OPTIONS = CallOptions(begin=True, pays=0.0)  # every call asks the network
# Sweeps of a run with any network over those without one. A correction that is not taken back makes the step of a sweep
# less than ``harm`` times larger, which costs at most ln(harm) of the ln(first step / tolerance), here about ln(1e3),
# that a whole solve takes, and a world whose calls fail is soon left to the solver. The worst here takes 8.
COST = 16.0
Answer = Callable[[Any, Any], Any]


class Stub:
    """A network whose corrections are a function of the features of the contacts."""

    def __init__(self, answer: Answer) -> None:
        self.answer, self.config = answer, SimpleNamespace(spacing=1.0)
        self.calls = 0
        self.worlds: list[int] = []  # of each call
        self.random = torch.Generator().manual_seed(5)

    def eval(self) -> Stub:
        return self

    def trunk(self, images: Any) -> Any:
        assert images.shape[1] == len(IMAGE)
        self.worlds.append(len(images))
        return images[:, :2].contiguous()

    def head(self, local: Any, near: Any) -> Any:
        assert [tuple(value.shape) for value in near] == [(len(local), 2)] * 3
        self.calls += 1
        return self.answer(self, local)


def constant(value: float, *names: str) -> Answer:
    """The same value for these outputs, or for all."""
    columns = [OUTPUT.index(name) for name in names or OUTPUT]

    def answer(stub: Stub, local: Any) -> Any:
        output = torch.zeros(len(local), len(OUTPUT))
        output[:, columns] = value
        return output

    return answer


def random(scale: float) -> Answer:
    return lambda stub, local: scale * torch.randn(len(local), len(OUTPUT), generator=stub.random)


def thousand(stub: Stub, local: Any) -> Any:
    """1000 times the impulses carried: 999 of them on top, over (1 + A) sigma / RMS."""
    size, rate = (local[:, LOCAL.index(name)] for name in ("size", "rate"))
    output = torch.zeros(len(local), len(OUTPUT))
    output[:, OUTPUT.index("carried_n") :] = 999.0 * torch.exp(-4.0 * size - 2.0 * rate)[:, None]
    return output


def alternate(stub: Stub, local: Any) -> Any:
    return (NETWORKS["good"] if stub.calls % 2 else constant(20.0, "free_n"))(stub, local)


NETWORKS: dict[str, Answer] = {
    "zero": constant(0.0),
    "random": random(1.0),
    "random and large": random(20.0),
    "nan": constant(math.nan),
    "inf": constant(math.inf),
    "thousand": thousand,
    "just taken": constant(0.99 * OPTIONS.limit, "free_n"),
    "reverse": constant(-1.0, "step_n", "step_t"),  # takes every gain back
    "good": constant(0.5, "step_n", "step_t"),  # half an Aitken step
    "alternate": alternate,
}
REFUSED = ("nan", "inf")


def simulation(scene: Scene, acceleration: str = "none", worlds: int = 4, threads: int = 1, **config) -> dc.Simulation:
    settings = dc.SolverConfig.preset("accurate", **{"max_sweeps": 20_000, "acceleration": acceleration, **config})
    return RunOptions(worlds=worlds, seed=7, threads=threads).simulation(scene, settings)


class Run:
    """A closed loop of STEPS steps, without a network or with one."""

    def __init__(self, sim: dc.Simulation, network: Any = None, options: CallOptions | None = None) -> None:
        self.sim = sim
        self.solve = None if network is None else LearnedSolve(sim, network, options or OPTIONS)
        sweeps, change, residual = [], [], []
        for _ in range(STEPS):
            sim.collide(DT)
            (sim if self.solve is None else self.solve).solve()
            for rows, name in ((sweeps, "sweeps"), (change, "change"), (residual, "residual")):
                rows.append(sim.stats.numpy(name).copy())
            sim.advance()
        self.sweeps, self.change, self.residual = np.array(sweeps), np.array(change), np.array(residual)

    @property
    def end(self) -> np.ndarray:
        state = self.sim.state
        return np.column_stack([state.numpy(n) for n in ("position", "angle", "velocity", "angular_velocity")])


def assert_same_bits(a: Run, b: Run) -> None:
    for name in ("end", "sweeps", "change", "residual"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)


PLAIN: dict[tuple[str, str], Run] = {}


def plain(scene: Scene, acceleration: str) -> Run:
    """The run without a network, made once."""
    key = (repr(scene), acceleration)
    if key not in PLAIN:
        PLAIN[key] = Run(simulation(scene, acceleration))
    return PLAIN[key]


# ---------------------------------------------------------------------- safe by construction

SCENES = {scene.name: scene for scene in (Thesis(bodies=12), Settled(bodies=12), Mixed(bodies=10))}


def in_turn(cases: dict[str, Any]) -> Iterator[Any]:
    """Each network in each case, with either acceleration in turn: so each network and each case meets both."""
    for i, network in enumerate(NETWORKS):
        for k, (name, case) in enumerate(cases.items()):
            acceleration = ("none", "aitken")[(i + k) % 2]
            yield pytest.param(network, case, acceleration, id=f"{network}-{name}-{acceleration}")


@pytest.mark.parametrize(("network", "scene", "acceleration"), list(in_turn(SCENES)))
def test_every_solve_converges_at_a_bounded_cost(network, scene, acceleration):
    without = plain(scene, acceleration)
    run = Run(simulation(scene, acceleration), Stub(NETWORKS[network]))
    tolerance = run.sim.config.ends_at[1]
    for r in (run, without):
        assert r.sweeps.max() < r.sim.config.max_sweeps
        assert (r.change[r.sweeps > 0] < tolerance).all()
    # the natural map, which the stop does not look at, is no larger than without it
    assert np.quantile(run.residual, 0.99) < 3.0 * np.quantile(without.residual, 0.99)
    assert run.sweeps.sum() < COST * without.sweeps.sum()
    assert np.isfinite(run.end).all()
    assert dc.overlap(run.sim).max.max() < dc.overlap(without.sim).max.max() + 2e-3
    if network in REFUSED:
        assert_same_bits(run, without)
    if network in ("zero", "thousand"):  # nothing of it stays, but velocities are summed up anew
        assert run.sweeps.sum() < 1.2 * without.sweeps.sum()
    if scene.name == "settled":
        # at rest an error does not grow: within the slop (0.5 mm) of each contact a pile of 4 rows may lie as it likes,
        # and what falls through that much is no faster than sqrt(2 g h)
        height = 4e-3
        np.testing.assert_allclose(run.end[:, :2], without.end[:, :2], atol=height)
        np.testing.assert_allclose(run.end[:, 3:5], without.end[:, 3:5], atol=math.sqrt(2.0 * 9.8 * height))


@pytest.mark.parametrize(("network", "friction", "acceleration"), list(in_turn({"smooth": 0.0, "rough": 0.5})))
def test_every_solve_ends_at_the_same_answer(friction, network, acceleration):
    """Each step of one trajectory solved three times: tightly, plainly, with the network.

    Both ends are as far from the solution as sweeps that change no impulse by more than 1e-4 N s let them be: that over
    1 - r, whatever came before. Without friction the velocities are unique, with friction they are so only nearly.

    Sweeps add up velocities in float32, so that those of impulses that were large on the way would be wrong at the end,
    unseen by the solver: they are compared with those of the impulses too.
    """
    sim = simulation(Thesis(bodies=12, friction=friction), acceleration)
    solve = LearnedSolve(sim, Stub(NETWORKS[network]), OPTIONS)
    tight = replace(sim.config, tolerance=3e-7, acceleration="aitken")
    errors: dict[str, list[float]] = {"plain": [], "network": []}
    sim.run(40, DT)  # until they touch
    for _ in range(60):
        sim.collide(DT)
        start = sim.contacts.numpy("impulse").copy()
        sim.solve(tight)
        solution = sim.motion.numpy("solved")[: sim.model.body_count, :3].copy()
        for name, call in (("network", solve.solve), ("plain", sim.solve)):
            sim.contacts.assign("impulse", start)
            call()
            assert (sim.stats.numpy("change") < sim.config.ends_at[1]).all()
            found = sim.motion.numpy("solved")[: len(solution), :3]
            errors[name].append(np.abs(found - solution).max())
            problem = ContactProblem.from_simulation(sim)
            impulse = sim.contacts.numpy("impulse")[problem.slot.numpy()]
            np.testing.assert_allclose(found, problem.velocities(torch.from_numpy(impulse)).numpy(), atol=1e-3)
        sim.advance()
    largest = {name: max(values) for name, values in errors.items()}
    assert 1e-5 < largest["plain"] < (1e-3 if friction == 0.0 else 0.02)  # [m/s]
    assert largest["network"] < 4.0 * largest["plain"]


def test_the_cap_of_sweeps_holds():
    run = Run(simulation(Thesis(bodies=12), max_sweeps=37), Stub(NETWORKS["reverse"]))
    assert run.sweeps.max() == 37


def test_a_correction_that_does_harm_is_taken_back():
    """Just after the start, so that what is left is the solve without it, to the bit."""
    sim = simulation(Thesis(bodies=30))
    sim.run(STEPS, DT)
    sim.collide(DT)
    start = sim.contacts.numpy("impulse").copy()
    sim.solve()
    impulse, sweeps = sim.contacts.numpy("impulse").copy(), sim.stats.numpy("sweeps").copy()
    assert (sweeps > 20).all()
    options = CallOptions(begin=True, most=1, middle=False, harm=1.0, every=6)
    solve = LearnedSolve(sim, Stub(NETWORKS["just taken"]), options)
    sim.contacts.assign("impulse", start)
    solve.solve()
    first, count = (sim.contacts.numpy(name) for name in ("contact_start", "contact_count"))
    back = np.flatnonzero(solve.stats.undone)
    assert len(back)
    for w in back:
        part = slice(first[w], first[w] + count[w])
        np.testing.assert_array_equal(sim.contacts.numpy("impulse")[part], impulse[part])
        assert sim.stats.numpy("sweeps")[w] == sweeps[w] + 6
    np.testing.assert_array_equal(solve.stats.failed, solve.stats.undone)


# ---------------------------------------------------------------------- when it is called


@pytest.mark.parametrize("acceleration", ["none", "aitken"])
def test_a_network_that_is_never_called_changes_no_bit(acceleration):
    scene = Thesis(bodies=12)
    for options in (CallOptions(most=0), CallOptions(begin=False, middle=False)):
        run = Run(simulation(scene, acceleration), Stub(NETWORKS["random"]), options)
        assert run.solve.model.calls == 0
        assert_same_bits(run, plain(scene, acceleration))


def test_calls_at_the_start_only_and_in_mid_solve_only():
    sim = simulation(Thesis(bodies=30))
    sim.run(STEPS, DT)
    sim.collide(DT)
    start = sim.contacts.numpy("impulse").copy()
    seen: list[Any] = []

    def answer(stub: Stub, local: Any) -> Any:
        seen.append(local[:, LOCAL.index("begin")].clone())
        return constant(0.1)(stub, local)

    for begin, middle in ((True, False), (False, True)):
        seen.clear()
        sim.contacts.assign("impulse", start)
        LearnedSolve(sim, Stub(answer), CallOptions(begin=begin, middle=middle, pays=0.0)).solve()
        assert len(seen) == 1 if begin else len(seen) > 1
        assert all((value == float(begin)).all() for value in seen)


def test_worlds_that_need_no_network_never_reach_it():
    """A disc in the air, one at rest, and piles: counters, and the batch that the network sees."""
    builder = dc.ModelBuilder()
    for kind in ("air", "rest", "pile", "pile"):
        builder.add_world()
        builder.add_chain(builder.add_body(type=dc.BodyType.STATIC), [(0.0, 9.0), (0.0, 0.0), (4.3, 0.0), (4.3, 9.0)])
        places = [(0.6 + 1.02 * (i % 3) + 0.4 * (i // 3 % 2), 0.5 + 0.95 * (i // 3)) for i in range(18)]
        builder.add_discs({"air": [(2.0, 6.0)], "rest": [(2.0, 0.5)]}.get(kind, places), 0.5)
    sim = dc.Simulation(*builder.finalize(), config=dc.SolverConfig(acceleration="none", tolerance=1e-5))
    sim.run(24, DT)  # the piles lean and slide
    network = Stub(NETWORKS["good"])
    solve = LearnedSolve(sim, network, CallOptions(begin=False, pays=0.0))
    for _ in range(10):
        step(solve, DT)
        assert (sim.stats.numpy("sweeps")[2:] > 10).all()
    stats = solve.stats
    assert stats.solves.tolist() == [10] * 4
    assert stats.empty.tolist() == [10, 0, 0, 0]
    assert stats.early.tolist() == [0, 10, 0, 0]
    assert stats.calls[:2].tolist() == [0, 0] and (stats.calls[2:] >= 10).all()
    assert max(network.worlds) == 2 and sum(network.worlds) == stats.calls.sum()
    assert network.calls == len(network.worlds)


def test_no_world_is_called_more_often_than_asked():
    sim = simulation(Thesis(bodies=30))
    sim.run(STEPS, DT)
    sim.collide(DT)
    solve = LearnedSolve(sim, Stub(NETWORKS["zero"]), CallOptions(begin=True, most=3, every=2, pays=0.0))
    solve.solve()
    assert (sim.stats.numpy("sweeps") > 10).all()
    np.testing.assert_array_equal(solve.stats.calls, 3)


def test_a_frozen_world_leaves_the_others_alone():
    ends = []
    for broken in (False, True):
        sim = simulation(Thesis(bodies=12))
        if broken:
            sim.state.numpy("velocity")[sim.model.numpy("body_start")[2] - 1] = np.inf
        run = Run(sim, Stub(NETWORKS["good"]))
        assert (sim.state.numpy("flags") != 0).tolist() == [False, broken, False, False]
        others = np.delete(np.arange(4), 1)
        ends.append((run.sweeps[:, others], run.end.reshape(4, -1)[others]))
    for a, b in zip(*ends, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize(
    ("network", "acceleration"), [("good", "none"), ("alternate", "aitken"), ("reverse", "aitken")]
)
def test_threads_give_the_same_bits(network, acceleration):
    runs = [Run(simulation(Thesis(bodies=12), acceleration, 3, threads), Stub(NETWORKS[network])) for threads in (1, 2)]
    assert_same_bits(*runs)
    for name in ("early", "calls", "failed", "undone"):
        np.testing.assert_array_equal(*(getattr(run.solve.stats, name) for run in runs))


def test_room_may_grow_on_the_way():
    """The simulation makes its arrays anew when contacts outgrow them; the reader follows."""
    arrays = Thesis(bodies=12).build(2, 7).finalize()
    config = dc.SolverConfig.preset("accurate", acceleration="none", max_sweeps=20_000)
    small = Run(dc.Simulation(*arrays, config=config, contacts_per_body=0.1), Stub(NETWORKS["good"]))
    arrays = Thesis(bodies=12).build(2, 7).finalize()
    large = Run(dc.Simulation(*arrays, config=config), Stub(NETWORKS["good"]))
    assert_same_bits(small, large)


# ---------------------------------------------------------------------- what it says of itself


def test_totals_and_explain_add_up():
    sim = simulation(Thesis(bodies=12))
    solve = LearnedSolve(sim, Stub(NETWORKS["alternate"]), OPTIONS)
    began = time.perf_counter()
    for _ in range(STEPS):
        step(solve, DT)
    wall = time.perf_counter() - began
    totals = solve.stats.totals()
    seconds = totals.pop("seconds")
    assert totals == {name: getattr(solve.stats, name).sum() for name in totals}
    assert all(type(value) is int for value in totals.values())
    assert totals["solves"] == 4 * STEPS and totals["calls"] > totals["failed"] >= totals["undone"]
    assert totals["failed"] + totals["refused"] > 0
    assert set(seconds) == {"solve", "splat", "network", "gather", "start"}
    assert all(value > 0.0 for value in seconds.values()) and sum(seconds.values()) < wall
    text = solve.report().text
    assert f"{totals['calls'] / totals['solves']:.2f} calls a solve, of {totals['solves']} solves" in text
    assert f"{100.0 * totals['early'] / totals['solves']:.1f} %" in text
    assert f"{totals['failed']} gained nothing, of which {totals['undone']} were undone" in text


def test_nothing_done_is_explained_too():
    text = LearnedSolve(simulation(Thesis(bodies=2)), Stub(NETWORKS["zero"])).report().text
    assert "0.00 calls a solve, of 0 solves" in text


# ---------------------------------------------------------------------- the network itself


def test_an_untrained_contactnet_begins_at_half_an_aitken_step():
    torch.manual_seed(0)
    scene = Thesis(bodies=12)
    run = Run(simulation(scene), ContactNet())
    assert run.sweeps.sum() < 0.85 * plain(scene, "none").sweeps.sum()
    assert run.solve.stats.failed.sum() < 0.1 * run.solve.stats.calls.sum()


def test_what_cannot_be_is_refused():
    network = Stub(NETWORKS["zero"])
    double = RunOptions(dtype="float64").simulation(Thesis(bodies=3), dc.SolverConfig())
    with pytest.raises(ValueError, match=r"sim.dtype is float64; the network reads float32"):
        LearnedSolve(double, network)
    with pytest.raises(ValueError, match="acceleration is 'nncg'"):
        LearnedSolve(simulation(Thesis(bodies=3), "nncg"), network)
    with pytest.raises(ValueError, match="needs collide"):
        LearnedSolve(simulation(Thesis(bodies=3)), network).solve()
    for name, value, message in (
        ("every", 1, "CallOptions.every is 1; it must be an integer in .2, "),
        ("most", -1, "CallOptions.most is -1; it must be an integer in .0, "),
        ("harm", 0.5, "CallOptions.harm is 0.5; it must be >= 1"),
        ("limit", math.nan, "CallOptions.limit is nan"),
    ):
        with pytest.raises(ValueError, match=message):
            CallOptions(**{name: value})
