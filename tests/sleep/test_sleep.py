"""Bodies at rest fall asleep, keep every bit while they sleep, and wake by whatever disturbs them."""

import dataclasses
import io
import pickle

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels.runtime.sequences import Rounds
from dc_kernels.stages import SLEEP, of_phase
from tests.parity.test_parity import Pair

DT = 0.01
SLEEP_CONFIG = dc.SolverConfig(sleep=True, sleep_time=0.3)
SOFT = dataclasses.replace(SLEEP_CONFIG, method="tgs_soft", substeps=3)  # a third of an impulse is rounded
FLOOR, SHELF, PLATFORM, ON_SHELF, ON_PLATFORM, LINKED, STACK = 0, 1, 2, (3, 4), (5, 6), (7, 8), (9, 10, 11)
ALL = (*ON_SHELF, *ON_PLATFORM, *LINKED, *STACK)


def yard(builder, shift=0.0):
    """A floor with two linked discs and three boxes, and towers of two on a static shelf and a kinematic platform."""
    builder.add_world()
    builder.add_box(builder.add_body(type=dc.BodyType.STATIC), 20.0, 0.5, center=(0.0, -0.5))
    builder.add_box(builder.add_body((-6.0, 2.0), type=dc.BodyType.STATIC), 1.0, 0.25)
    builder.add_box(builder.add_body((6.0, 2.0), type=dc.BodyType.KINEMATIC), 1.0, 0.25)
    for x in (-6.0, 6.0):
        for k in range(2):
            builder.add_box(builder.add_body((x + 0.1 * k, 2.75 + k)), 0.5, 0.5)
    discs = builder.add_discs([(-2.0, 0.5), (-0.7, 0.5)], 0.5)
    builder.add_distance_joint(discs[0], discs[1])
    for x, y in ((2.0, 0.5), (3.1, 0.5), (2.5 + shift, 1.5)):
        builder.add_box(builder.add_body((x, y)), 0.5, 0.5)


def simulation(worlds=1, config=SLEEP_CONFIG, backend="warp", dtype="float32", **options):
    builder = dc.ModelBuilder()
    for w in range(worlds):
        yard(builder, 0.1 * w)
    return dc.Simulation(*builder.finalize(dtype, backend=backend), config=config, **options)


def asleep_in(sim):
    """The bodies that sleep."""
    return set(np.flatnonzero(sim.asleep).tolist())


@pytest.fixture(scope="module")
def at_rest():
    """A yard in which all sleep, to be cloned."""
    sim = simulation()
    sim.run(100, DT)
    assert asleep_in(sim) == set(ALL)
    return sim


def state_bits(sim, bodies=slice(None)):
    names = ("position", "angle", "velocity", "angular_velocity")
    return {name: sim.state.numpy(name)[bodies].tobytes() for name in names}


def contacts_of(sim, bodies=None):
    """Contacts of some bodies by key: impulse, colour, age and place."""
    slots, _ = dc.contact_slots(sim.contacts)
    table = {name: sim.contacts.numpy(name)[slots] for name in ("key", "body_a", "body_b", "impulse", "color", "gap")}
    return {
        int(key): (impulse.tobytes(), int(color), float(gap))
        for key, a, b, impulse, color, gap in zip(*table.values())
        if bodies is None or a in bodies or b in bodies
    }


def test_what_rests_falls_asleep_and_keeps_every_bit(at_rest):
    sim = at_rest.clone()
    before, contacts, time = state_bits(sim), contacts_of(sim), sim.state.numpy("time")[0]
    ages = sim.contacts.numpy("age").tobytes()
    sim.run(300, DT)
    sim.step(DT)
    assert state_bits(sim) == before
    assert contacts_of(sim) == contacts
    assert sim.contacts.numpy("age").tobytes() == ages
    assert not sim.state.numpy("velocity").any()
    assert sim.state.numpy("time")[0] == pytest.approx(time + 301 * DT)
    assert sim.stats.numpy("sweeps")[0] == 0
    assert not sim.state.numpy("flags").any() and not sim.running.any()
    weight = 9.81 * sim.model.numpy("mass")
    np.testing.assert_allclose(dc.net_contact_forces(sim).force[list(ALL), 1], weight[list(ALL)], rtol=2e-3)
    assert "sleep: 9 of 9 dynamic bodies asleep, in 1 world, of which 1 skipped whole" in sim.explain()


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


def test_nothing_is_reserved_or_launched_where_none_may_sleep():
    sim = simulation(config=dc.SolverConfig())
    sim.run(3, DT)
    assert sim.sleepers.nbytes() == 0
    assert not sim.asleep.any()
    assert not {stage.kernel for stage in SLEEP} & set(sim.kernels)
    assert "sleep: no body falls asleep" in sim.explain()


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_while_all_are_awake_bits_are_those_without_sleep(dtype):
    one, two = (simulation(dtype=dtype, config=dc.SolverConfig(sleep=sleep)) for sleep in (True, False))
    for sim in (one, two):
        sim.state.numpy("velocity")[list(STACK)] = (1.0, 2.0)
        sim.run(40, DT)
    assert not one.asleep.any()
    assert state_bits(one) == state_bits(two)
    assert contacts_of(one) == contacts_of(two)


def write(name, body, value):
    def act(sim):
        sim.state.numpy(name)[body] = value

    return act


def write_gravity(sim):
    sim.model.numpy("gravity")[0] = (0.0, -5.0)


def write_joint(sim):
    sim.joints.assign("joint_length", [1.29])


EVERY, LINK = set(ALL), set(LINKED)
CAUSES = {
    "velocity": (write("velocity", STACK[0], (0.0, 0.5)), set(STACK)),
    "spin": (write("angular_velocity", STACK[2], 0.5), set(STACK)),
    "position": (write("position", STACK[2], (2.5, 1.6)), set(STACK)),
    "angle": (write("angle", ON_SHELF[1], 0.01), set(ON_SHELF)),
    "force": (write("force", LINKED[1], (0.1, 0.0)), LINK),
    "torque": (write("torque", LINKED[0], 0.1), LINK),
    "gravity": (write_gravity, EVERY),
    "joint": (write_joint, LINK),
    "static support": (write("position", SHELF, (-6.0, 1.0)), set(ON_SHELF)),
    "kinematic support": (write("velocity", PLATFORM, (0.0, -1.0)), set(ON_PLATFORM)),
    "moved kinematic support": (write("position", PLATFORM, (9.0, 4.0)), set(ON_PLATFORM)),
    "what comes to touch": (write("position", SHELF, (-2.0, 1.24)), {*ON_SHELF, *LINK}),
    "call": (lambda sim: sim.wake([STACK[1]]), set(STACK)),
    "call for all": (lambda sim: sim.wake(), EVERY),
    "model": (lambda sim: sim.change_model(shape_friction=0.3), EVERY),
    "settings": (lambda sim: setattr(sim, "config", dataclasses.replace(sim.config, sleep=False)), EVERY),
    "reset": (lambda sim: sim.reset(), EVERY),
}


@pytest.mark.parametrize("cause", CAUSES)
def test_who_wakes(at_rest, cause):
    sim = at_rest.clone()
    disturb, wakes = CAUSES[cause]
    before = state_bits(sim, sorted(EVERY - wakes))
    disturb(sim)
    sim.step(DT)
    assert asleep_in(sim) == EVERY - wakes
    sim.run(5, DT)
    assert asleep_in(sim) == EVERY - wakes
    assert state_bits(sim, sorted(EVERY - wakes)) == before
    keys = sim.contacts.numpy("key")[: sim.contacts.numpy("contact_count")[0]]
    assert (np.diff(keys) > 0).all()


def test_an_equal_force_written_again_wakes_nobody():
    sim = simulation()
    sim.state.numpy("force")[STACK[2]] = (0.0, -1.0)
    sim.run(100, DT)
    assert asleep_in(sim) == EVERY
    sim.state.assign("force", sim.state.numpy("force").copy())
    sim.step(DT)
    assert asleep_in(sim) == EVERY


def test_a_tower_whose_support_is_removed_falls(at_rest):
    sim = at_rest.clone()
    sim.state.numpy("position")[SHELF] = (-6.0, -5.0)
    sim.run(40, DT)
    assert (sim.state.numpy("position")[list(ON_SHELF), 1] < (2.4, 3.4)).all()
    sim.run(200, DT)
    assert asleep_in(sim) == EVERY
    np.testing.assert_allclose(sim.state.numpy("position")[list(ON_SHELF), 1], (0.5, 1.5), atol=0.01)


def test_what_lay_on_a_body_that_is_put_elsewhere_falls(at_rest):
    sim = at_rest.clone()
    sim.state.numpy("position")[ON_SHELF[0]] = (0.0, 9.0)
    sim.run(30, DT)
    assert sim.state.numpy("position")[ON_SHELF[1], 1] < 3.4


def test_what_hangs_from_a_body_that_is_put_elsewhere_wakes():
    builder = dc.ModelBuilder()
    builder.add_world()
    hook = builder.add_body((0.0, 5.0), type=dc.BodyType.STATIC)
    bob = builder.add_body((0.0, 3.0))
    builder.add_disc(bob, 0.5)
    builder.add_distance_joint(hook, bob)
    sim = dc.Simulation(*builder.finalize(), config=SLEEP_CONFIG)
    sim.run(100, DT)
    assert asleep_in(sim) == {bob}
    sim.state.numpy("position")[hook] = (1.0, 5.0)
    sim.run(30, DT)
    assert sim.state.numpy("position")[bob, 0] > 0.01


def test_a_moving_platform_keeps_what_it_carries_awake():
    sim = simulation()
    sim.state.numpy("velocity")[PLATFORM] = (0.0, 0.005)
    sim.run(120, DT)
    assert asleep_in(sim) == EVERY - set(ON_PLATFORM)
    sim.state.numpy("velocity")[PLATFORM] = 0.0
    sim.run(60, DT)
    assert asleep_in(sim) == EVERY
    assert sim.sleepers.numpy("dormant")[0] == 1


def shot(sim, steps):
    """The linked discs slide fast into the stack."""
    sim.state.numpy("velocity")[list(LINKED)] = (8.0, 0.0)
    sim.run(steps, DT)
    return sim


def test_what_is_hit_wakes_and_the_rest_sleeps_on(at_rest):
    sim = at_rest.clone()
    others = sorted({*ON_SHELF, *ON_PLATFORM})
    before, kept = state_bits(sim, others), contacts_of(sim, others)
    shot(sim, 15)
    assert asleep_in(sim) == EVERY - LINK
    sim.run(60, DT)
    assert asleep_in(sim) == set(others)
    assert np.abs(sim.state.numpy("velocity")[list(STACK)]).max() > 0.1
    assert state_bits(sim, others) == before
    assert contacts_of(sim, others) == kept


def test_a_woken_pile_goes_on_as_if_it_had_not_slept():
    """The difference is what it crept by meanwhile."""
    sims = simulation(), simulation(config=dataclasses.replace(SLEEP_CONFIG, sleep=False))
    for sim in sims:
        sim.run(150, DT)
        shot(sim, 60)
    one, two = (sim.state.numpy("position") for sim in sims)
    assert sims[0].asleep.sum() == 4
    assert np.abs(one - two).max() < 2e-3


def test_contacts_of_the_woken_keep_impulse_colour_and_age(at_rest):
    sim = at_rest.clone()
    before = {name: sim.contacts.numpy(name).copy() for name in ("key", "impulse", "color", "age")}
    count = sim.contacts.numpy("contact_count")[0]
    sim.wake()
    sim.collide(DT)
    assert sim.contacts.numpy("contact_count")[0] == count
    for name, values in before.items():
        now = sim.contacts.numpy(name)[:count]
        assert np.array_equal(now, values[:count] + (name == "age")), name
    sim.solve()
    assert sim.stats.numpy("sweeps")[0] == sim.config.min_sweeps  # the start is the solution
    sim.advance()
    assert np.abs(sim.state.numpy("velocity")).max() < 1e-3


def test_impulses_follow_the_time_step(at_rest):
    """A world that is awake in part takes steps of another length: impulses of its sleepers are those of that step."""
    sim = at_rest.clone()
    others = [*ON_SHELF, *ON_PLATFORM]
    before = dc.net_contact_forces(sim).force[others]
    sim.state.numpy("velocity")[list(STACK)] = (0.0, 3.0)
    sim.run(4, 0.5 * DT)
    assert {*others} <= asleep_in(sim)
    np.testing.assert_allclose(dc.net_contact_forces(sim).force[others], before, rtol=1e-5, atol=1e-4)


def test_energy_does_not_rise(at_rest):
    sim = at_rest.clone()

    def energy():
        state, model = sim.state, sim.model
        kinetic = 0.5 * (model.numpy("mass") * (state.numpy("velocity") ** 2).sum(axis=1)).sum()
        return kinetic + 9.81 * (model.numpy("mass") * state.numpy("position")[:, 1])[list(ALL)].sum()

    before = energy()
    sim.wake()
    for _ in range(60):
        sim.step(DT)
        assert energy() < before + 1e-3
    assert asleep_in(sim) == EVERY


def through_file(sim):
    file = io.BytesIO()
    sim.save(file)
    file.seek(0)
    return dc.Simulation.load(file)


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


def rain(worlds, **options):
    """Boxes and discs that fall on each other in each world, one row of worlds as the other."""
    builder = dc.ModelBuilder()
    rng = np.random.default_rng(0)
    for _ in range(worlds):
        builder.add_world()
        builder.add_box(builder.add_body(type=dc.BodyType.STATIC), 20.0, 0.5, center=(0.0, -0.5))
        for k in range(7):
            body = builder.add_body((float(rng.uniform(-1.0, 1.0)), 1.0 + 1.05 * k))
            if k % 2:
                builder.add_box(body, 0.4, 0.4)
            else:
                builder.add_disc(body, 0.5)
    return dc.Simulation(*builder.finalize(), config=dc.SolverConfig(sleep=True), **options)


def test_who_wakes_is_a_function_of_the_state_of_the_world_alone():
    """Pairs are found anew whenever the room of any world grows, and who wakes must not depend on that."""
    alone, among = (rain(worlds, contacts_per_body=0.2) for worlds in (1, 6))
    bodies = np.arange(alone.model.body_count)
    for _ in range(8):
        for sim in (alone, among):
            sim.run(40, DT)
        assert state_bits(alone) == state_bits(among, bodies)
        assert asleep_in(alone) == asleep_in(among) & {*bodies.tolist()}
        assert np.array_equal(alone.sleepers.numpy("rest_time"), among.sleepers.numpy("rest_time")[bodies])


@pytest.mark.parametrize("step", [0, 3])
def test_what_was_let_sleep_on_a_body_falls_when_that_is_put_elsewhere(step):
    """Whether a step has found their contacts yet or not."""
    sim = simulation()
    sim.run(step, DT)
    sim.sleep()
    sim.state.numpy("position")[SHELF] = (-6.0, -5.0)
    sim.run(40, DT)
    assert (sim.state.numpy("position")[list(ON_SHELF), 1] < (2.4, 3.4)).all()


def test_what_was_let_sleep_on_an_awake_body_falls_when_that_is_put_elsewhere(at_rest):
    sim = at_rest.clone()
    sim.wake()
    sim.step(DT)
    sim.sleep([ON_SHELF[1], STACK[2]])
    assert asleep_in(sim) == {ON_SHELF[1], STACK[2]}
    sim.state.numpy("position")[ON_SHELF[0]] = (0.0, 9.0)
    sim.step(DT)
    assert not asleep_in(sim)
    sim.run(29, DT)
    assert sim.state.numpy("position")[ON_SHELF[1], 1] < 3.4


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


def test_a_user_lets_a_scene_begin_asleep():
    sim = simulation()
    sim.sleep()
    before = state_bits(sim)
    sim.run(10, DT)
    assert asleep_in(sim) == EVERY
    assert state_bits(sim) == before
    shot(sim, 60)
    assert asleep_in(sim) == {*ON_SHELF, *ON_PLATFORM}
    sim.wake([ON_SHELF[0]])
    sim.sleep(np.isin(np.arange(sim.model.body_count), STACK))
    assert not sim.state.numpy("velocity")[list(STACK)].any()
    sim.step(DT)
    assert not {*ON_SHELF} & asleep_in(sim)


def test_half_of_what_is_linked_does_not_sleep(at_rest):
    sim = at_rest.clone()
    sim.wake()
    sim.step(DT)
    sim.sleep([LINKED[0], STACK[2]])
    assert asleep_in(sim) == {LINKED[0], STACK[2]}
    sim.step(DT)
    assert not asleep_in(sim)


def test_a_world_without_gravity_sleeps_only_if_told():
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0.0, 0.0))
    builder.add_discs([(0.0, 0.0), (3.0, 0.0)], 0.5)
    sim = dc.Simulation(*builder.finalize(), config=SLEEP_CONFIG)
    sim.run(100, DT)
    assert not sim.asleep.any()
    sim.sleep([0])
    sim.state.numpy("velocity")[1] = (-1.0, 0.0)
    sim.run(100, DT)
    assert asleep_in(sim) == {0}
    sim.run(150, DT)
    np.testing.assert_allclose(sim.state.numpy("velocity").sum(axis=0), (-1.0, 0.0), atol=1e-5)
    assert sim.state.numpy("velocity")[0, 0] < -0.1


def test_what_is_asked_for_in_vain_is_refused(at_rest):
    off = simulation(config=dc.SolverConfig())
    for call in (off.sleep, off.wake):
        with pytest.raises(ValueError, match=r"SolverConfig\.sleep is False"):
            call()
    sim = at_rest.clone()
    with pytest.raises(ValueError, match=r"bodies\[1\] is 12; it must lie in \[0, 11\]"):
        sim.wake([0, 12])
    sim.collide(DT)
    with pytest.raises(ValueError, match="in the middle of a step"):
        sim.sleep()
    with pytest.raises(ValueError, match=r"SolverConfig\.sleep_time"):
        dc.SolverConfig(sleep_time=0.0)


def test_backends_without_the_kernels_say_who_has_them():
    builder = dc.ModelBuilder()
    yard(builder)
    arrays = builder.finalize(backend="taichi")
    with pytest.raises(ValueError, match=r"no kernels of sleep\.wake; it must be one of \('warp', 'numpy'\)"):
        dc.Simulation(*arrays, config=SLEEP_CONFIG)
    sim = dc.Simulation(*arrays)
    with pytest.raises(ValueError, match=r"no kernels of sleep\.wake"):
        sim.config = SLEEP_CONFIG
    assert not sim.config.sleep


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_kernels_agree_with_the_oracle(dtype):
    sim = simulation(2, dataclasses.replace(SLEEP_CONFIG, acceleration="none"), dtype=dtype)
    sim.run(4, DT)
    assert not sim.asleep.any()
    pair, own = Pair(sim), {stage.kernel for stage in SLEEP}
    sim.state.worlds("velocity")[1, list(LINKED)] = (8.0, 0.0)
    for k in range(48):
        if k == 40:
            assert sim.sleepers.numpy("dormant").tolist() == [1, 0]
            sim.state.numpy("position")[SHELF] += 0.01
        sim.storage.integrator.set_time_step(DT)
        for phase in ("collide", "solve", "advance"):
            for name in of_phase(phase, sleep=True):
                # the others are compared elsewhere, and here where there is something that they must leave alone
                if name in own or k in (0, 40, 47):
                    pair.run(name)
                else:
                    pair.launch(name)
    sleeping = sim.sleepers.numpy("sleeping")
    assert sleeping[0] == 7 and 0 < sleeping[1] < 9


@pytest.mark.parametrize("config", [SLEEP_CONFIG, SOFT])
def test_the_oracle_falls_asleep_and_wakes_alike(config):
    sims = [
        simulation(dtype="float64", backend=backend, config=dataclasses.replace(config, sleep_time=0.1))
        for backend in ("warp", "numpy")
    ]
    for steps, expected in ((12, EVERY), (3, EVERY - LINK)):
        for sim in sims:
            sim.run(steps, 0.02)
            assert asleep_in(sim) == expected
            sim.state.numpy("velocity")[list(LINKED)] = (0.0, 1.0)
    np.testing.assert_allclose(*(sim.state.numpy("position") for sim in sims), atol=1e-9)


def test_scenes_of_discs_pass_over_pairs_of_sleepers():
    """Their pairs are looked at side by side; a sleeping pile is in no row while another one is solved."""
    builder = dc.ModelBuilder()
    builder.add_world()
    pits = [(-9, 6), (-9, 0), (-6, 0), (-6, 6), (6, 6), (6, 0), (9, 0), (9, 6)]
    builder.add_chain(builder.add_body(type=dc.BodyType.STATIC), pits)
    pile = [(0.52, 0.5), (1.5, 0.5), (2.48, 0.5), (1.0, 1.4), (2.0, 1.4)]
    discs = builder.add_discs([(first + x, y) for first in (-9.0, 6.0) for x, y in pile], 0.5)
    sim = dc.Simulation(*builder.finalize(), config=SLEEP_CONFIG)
    sim.run(400, DT)
    assert asleep_in(sim) == set(discs)
    left = sorted(b for b in discs if sim.state.numpy("position")[b, 0] < 0)
    right = sorted(set(discs) - set(left))
    before, kept, every = state_bits(sim, left), contacts_of(sim, left), len(contacts_of(sim))
    sim.state.numpy("velocity")[right] = (0.0, 0.5)
    sim.collide(DT)
    assert not set(contacts_of(sim)) & set(kept) and len(contacts_of(sim)) < every
    sim.solve()
    sim.advance()
    sim.run(9, DT)
    assert set(left) == asleep_in(sim)
    assert state_bits(sim, left) == before
    assert contacts_of(sim, left) == kept


def test_what_soft_substeps_brought_to_rest_sleeps_and_wakes():
    """Every bit stays, impulses of rods too, in a world that sleeps in part; what wakes stays where it was."""
    sim = simulation(dtype="float64", config=SOFT)
    sim.run(100, DT)
    assert asleep_in(sim) == set(ALL)
    link = sim.joints.numpy("joint_impulse").copy()
    before, contacts = state_bits(sim, [*ON_SHELF, *LINKED]), contacts_of(sim, [*ON_SHELF, *LINKED])
    sim.state.numpy("velocity")[STACK[2]] = (0.0, 1.0)
    sim.run(20, DT)
    assert not sim.asleep[list(STACK)].any() and sim.asleep[[*ON_SHELF, *LINKED]].all()
    assert state_bits(sim, [*ON_SHELF, *LINKED]) == before
    assert contacts_of(sim, [*ON_SHELF, *LINKED]) == contacts
    assert sim.joints.numpy("joint_impulse").tobytes() == link.tobytes()
    sim.run(100, DT)
    assert asleep_in(sim) == set(ALL)
    sim.wake()
    at = sim.state.numpy("position").copy()
    sim.run(10, DT)
    assert asleep_in(sim) == set()
    assert np.abs(sim.state.numpy("position") - at).max() < 1e-3  # less than sleep_speed would


@pytest.mark.parametrize(("config", "close"), [(SLEEP_CONFIG, 1e-6), (SOFT, 1e-3)])
@pytest.mark.parametrize("backend", ["warp", "numpy"])
def test_joints_of_sleepers_keep_their_impulses(backend, config, close):
    """A chain that wakes beside a disc that never slept hangs on as if it had been awake."""
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0.0, -9.8))
    body = builder.add_body(type=dc.BodyType.STATIC)
    for i in range(3):
        link = builder.add_body((0.0, -0.5 - i))
        builder.add_box(link, 0.1, 0.5, mask=0)
        builder.add_revolute_joint(body, link, (0.0, -0.5 if i else 0.0), (0.0, 0.5))
        body = link
    builder.add_disc(builder.add_body((9.0, 0.0), velocity=(1.0, 0.0), gravity_scale=0.0), 0.5)
    sim = dc.Simulation(*builder.finalize("float64", backend=backend), config=config)
    sim.run(40, DT)
    assert asleep_in(sim) == {1, 2, 3}
    before = sim.joints.numpy("joint_impulse").copy()
    weight = float(sim.model.numpy("mass")[1]) * 9.8 * DT
    np.testing.assert_allclose(np.abs(before.reshape(3, 2)[:, 1]), weight * np.array([3.0, 2.0, 1.0]), rtol=close)
    sim.run(5, DT)
    np.testing.assert_allclose(sim.joints.numpy("joint_impulse"), before)
    sim.wake()
    sim.step(DT)
    assert asleep_in(sim) == set() and np.abs(sim.state.numpy("velocity")[1:4]).max() < close * 9.8 * DT
    if config is SLEEP_CONFIG:  # what substeps give by softness they take back
        assert sim.stats.numpy("change")[0] < 1e-9 * weight


def columns(backend, heights):
    """Discs that sleep on the ground, and one above each, at these heights over it."""
    builder = dc.ModelBuilder()
    builder.add_world()
    builder.add_box(builder.add_body(type=dc.BodyType.STATIC), 2.0 * len(heights), 0.5, center=(0.0, -0.5))
    x = 2.0 * np.arange(len(heights))
    lower = builder.add_discs(np.stack([x, np.full_like(x, 0.5)], axis=1), 0.5)
    builder.add_discs(np.stack([x, 1.5 + np.asarray(heights)], axis=1), 0.5)
    sim = dc.Simulation(*builder.finalize(backend=backend), config=SLEEP_CONFIG)
    sim.step(0.1 * DT)  # finds the contacts of the lower discs
    sim.sleep(lower)
    return sim


@pytest.mark.parametrize("backend", ["warp", "numpy"])
def test_what_meets_a_sleeper_wakes_it_in_that_step(backend):
    """A sleeper never has a new contact beside those that it fell asleep with: the colour of one may be the other's."""
    sim = columns(backend, np.linspace(0.001, 0.2, 30))
    woken = set()
    for _ in range(22):
        sim.step(DT)
        slots, _ = dc.contact_slots(sim.contacts)
        bodies = np.stack([sim.contacts.numpy(name)[slots] for name in ("body_a", "body_b")])
        dynamic = sim.model.numpy("body_type")[bodies] == dc.BodyType.DYNAMIC
        both = bodies[:, dynamic.all(axis=0)]
        assert np.array_equal(*sim.asleep[both])
        assert asleep_in(through_file(sim)) == asleep_in(sim)  # which looks at the colours
        woken |= {*both.flat} - asleep_in(sim)
    assert len(woken) == 60
