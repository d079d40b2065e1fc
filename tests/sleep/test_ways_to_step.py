"""However the steps of a world that sleeps in part are taken, copied or stored, its bits are equal."""

import io
import pickle

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels.runtime.sequences import Rounds
from dc_kernels.stages import of_phase
from tests.sleep.yard import (
    DT,
    LINKED,
    ON_SHELF,
    SLEEP_CONFIG,
    STACK,
    asleep_in,
    contacts_of,
    shot,
    simulation,
    state_bits,
    through_file,
    yard,
)


def test_phases_of_a_dormant_world_do_nothing(at_rest):
    sim = at_rest.clone()
    before, contacts = state_bits(sim), contacts_of(sim)
    for _ in range(2):
        sim.collide(DT)
        sim.solve(pause=3)
        assert not sim.running.any()
        sim.resume()
        sim.advance()
    assert state_bits(sim) == before
    assert contacts_of(sim) == contacts


WAYS = {"clone": dc.Simulation.clone, "pickle": lambda sim: pickle.loads(pickle.dumps(sim)), "file": through_file}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("written", [False, True])
def test_a_copy_of_a_world_that_sleeps_in_part_goes_on_with_its_bits(at_rest, way, written):
    sim = shot(at_rest.clone(), 10)
    if written:  # and not noticed yet
        sim.state.numpy("velocity")[ON_SHELF[1]] = (1.0, 0.0)
    other = WAYS[way](sim)
    assert asleep_in(other) == asleep_in(sim)
    for steps in (1, 5, 100):
        sim.run(steps, DT)
        other.run(steps, DT)
        assert state_bits(sim) == state_bits(other)
        assert contacts_of(sim) == contacts_of(other)
        assert asleep_in(sim) == asleep_in(other)


def test_sleepers_of_a_file_are_held_to_their_rules(at_rest):
    h5py = pytest.importorskip("h5py")
    sim = shot(at_rest.clone(), 10)
    file = io.BytesIO()
    sim.save(file)
    for name, at, value, wrong in (
        ("asleep", 3, 9, "one of"),
        ("sleeping", 0, 3, "the bodies of the world that sleep"),
        ("dormant", 0, 1, "0 where a dynamic body is awake"),
        ("body_a", 0, 10**6, "a body of its world"),
        ("count", 0, 2, "adds up to"),
        ("rest_time", 0, -1.0, "finite and >= 0"),
    ):
        broken = io.BytesIO(file.getvalue())
        with h5py.File(broken, "r+") as opened:
            opened[f"sleepers/{name}"][at] = value
        broken.seek(0)
        with pytest.raises(ValueError, match=rf"dataset sleepers/{name}.*{wrong}"):
            dc.Simulation.load(broken)


def test_steps_asleep_are_taken_at_once_by_one_thread_until_a_write_wakes_a_world(monkeypatch):
    """Worlds asleep would be taken a few steps at a time by all threads: 80 times as long."""
    builder = dc.ModelBuilder()
    for _ in range(40):
        yard(builder)
    sims = [dc.Simulation(*builder.finalize(), config=SLEEP_CONFIG, threads=threads) for threads in (1, 2)]
    for sim in sims:
        sim.run(100, DT)
        assert sim.sleepers.numpy("dormant").all()
    taken = []
    take = Rounds.take
    monkeypatch.setattr(Rounds, "take", lambda rounds, count: (taken.append(count), take(rounds, count))[1])
    for sim in sims:
        taken.clear()
        sim.run(1000, DT)
        assert len(taken) <= 2
        sim.state.numpy("velocity")[ON_SHELF[1]] = (0.5, 2.0)
        taken.clear()
        sim.run(40, DT)
        assert (sum(taken) > 40) == (sim is sims[1])  # shared, shard by shard, from the second step on
    assert state_bits(sims[0]) == state_bits(sims[1])


def test_worlds_sleep_for_themselves_whatever_the_threads():
    sims = [simulation(worlds=4, threads=threads) for threads in (1, 2)]
    for sim in sims:
        sim.run(100, DT)
        velocity = sim.state.worlds("velocity")
        velocity[1, list(LINKED)] = (8.0, 0.0)
        velocity[3, STACK[2]] = (0.0, 5.0)
        sim.run(60, DT)
        assert sim.sleepers.numpy("dormant").tolist() == [1, 0, 1, 0]
    assert state_bits(sims[0]) == state_bits(sims[1])
    assert contacts_of(sims[0]) == contacts_of(sims[1])
    alone = simulation()
    alone.run(160, DT)
    bodies = np.arange(alone.model.body_count)
    assert state_bits(alone) == state_bits(sims[0], bodies)


def test_many_steps_at_once_are_single_steps(at_rest):
    one, two = at_rest.clone(), at_rest.clone()
    shot(one, 120)
    shot(two, 0)
    for _ in range(120):
        two.step(DT)
    assert state_bits(one) == state_bits(two)
    assert contacts_of(one) == contacts_of(two)


def test_phases_are_steps_also_where_a_collision_is_repeated(at_rest):
    one, two = at_rest.clone(), at_rest.clone()
    shot(one, 60)
    shot(two, 0)
    for _ in range(60):
        two.collide(DT)
        two.collide(DT)
        two.solve()
        two.advance()
    assert state_bits(one) == state_bits(two)


def test_room_for_contacts_grows_with_those_of_sleepers():
    sims = [simulation(contacts_per_body=room, pairs_per_shape=room) for room in (0.0, 10.0)]
    for sim in sims:
        sim.run(100, DT)
        shot(sim, 60)
    assert state_bits(sims[0]) == state_bits(sims[1])
    assert contacts_of(sims[0]) == contacts_of(sims[1])


def test_launches_that_are_left_out_would_have_done_nothing(at_rest):
    """Compiled rounds leave out what nobody needs; ``collide``, ``solve`` and ``advance`` of one kernel each do not."""
    sims = [at_rest.clone() for _ in range(2)]
    for steps, act in ((5, None), (40, lambda sim: sim.wake()), (60, lambda sim: shot(sim, 0)), (80, None)):
        for sim in sims:
            if act is not None:
                act(sim)
        sims[0].run(steps, DT)
        for _ in range(steps):
            sims[1].storage.integrator.set_time_step(DT)
            for phase in ("collide", "solve", "advance"):
                for name in of_phase(phase, sleep=True):
                    sims[1].bind(name, 0, 1)()
        assert state_bits(sims[0]) == state_bits(sims[1])
        assert contacts_of(sims[0]) == contacts_of(sims[1])
        for name in ("asleep", "rest_time", "sleeping", "dormant", "waited", "count"):
            assert np.array_equal(*(sim.sleepers.numpy(name) for sim in sims)), name


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_steps_in_which_nobody_is_awake_are_those_of_one_call_each(dtype):
    """Only time goes on, and not that of a world that has stopped; what is written afterwards is seen."""
    sims = [simulation(3, dtype=dtype) for _ in range(2)]
    for sim in sims:
        sim.sleep()
        sim.step(DT)
        sim.state.assign("flags", [0, int(dc.Flag.NONFINITE), 0])
    for steps in (50, 20):
        sims[0].run(steps, DT)
        for _ in range(steps):
            sims[1].step(DT)
        assert state_bits(sims[0]) == state_bits(sims[1])
        for name in ("time", "flags"):
            assert np.array_equal(*(sim.state.numpy(name) for sim in sims)), name
        assert np.array_equal(*(sim.stats.numpy("sweeps") for sim in sims))
        for sim in sims:
            shot(sim, 0)
    time = sims[0].state.numpy("time")
    assert time[1] == pytest.approx(DT)
    assert time[[0, 2]] == pytest.approx(71 * DT, rel=1e-6)
    assert sims[0].stats.numpy("sweeps")[0] > 0
