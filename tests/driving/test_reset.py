"""A world that is reset goes on as one that was built anew, and the others with their bits."""

import numpy as np
import pytest
import warp as wp

import dc_kernels as dc
from tests.driving.scenes import DT, bits, of_worlds, simulation, worlds_of_one_size


@pytest.mark.parametrize(
    ("dtype", "backend", "threads"), [("float32", "warp", 2), ("float64", "warp", 1), ("float64", "numpy", 1)]
)
@pytest.mark.parametrize("world", [0, 1])
def test_a_world_goes_on_as_if_built_anew_and_the_others_with_their_bits(world, dtype, backend, threads):
    steps = 30 if backend == "warp" else 5
    sim, anew, other = (simulation(dtype, backend, threads=threads) for _ in range(3))
    for one in (sim, other):
        one.state.numpy("force")[3] = (0.1, 0.2)
        one.run(steps, DT)
    before = other.clone()
    sim.reset(np.arange(2) == world)
    assert of_worlds(sim, [1 - world]) == of_worlds(before, [1 - world])
    assert sim.contacts.numpy("contact_count")[world] == 0 and sim.phase == "advance"
    for one in (sim, anew, other):
        one.run(steps, 1.25 * DT)
    assert of_worlds(sim, [1 - world]) == of_worlds(other, [1 - world])
    assert of_worlds(sim, [world]) == of_worlds(anew, [world])
    sim.reset()
    for one in (sim, anew := simulation(dtype, backend)):
        one.run(steps, DT)
    assert of_worlds(sim, [0, 1]) == of_worlds(anew, [0, 1])


def test_masks_and_indices_of_any_library_mean_the_same():
    torch = pytest.importorskip("torch")
    given = [
        [2, 0],
        np.array([0, 2], np.int32),
        np.array([True, False, True]),
        torch.tensor([True, False, True]),
        torch.tensor([0, 2]),
        wp.array([0, 2], dtype=wp.int32, device="cpu"),
        (0, 2),
    ]
    found = []
    for worlds in given:
        sim = worlds_of_one_size()
        sim.run(5, DT)
        sim.reset(worlds)
        found.append(bits(sim))
        assert sim.state.numpy("time").tolist() == [0, pytest.approx(5 * DT), 0]
    assert all(one == found[0] for one in found)
    sim.reset([], {"velocity": np.zeros((0, 3, 2)), "angle": []})
    with pytest.raises(ValueError, match="state has 'angel'; it may have"):
        sim.reset([], {"angel": 0.0})
    assert bits(sim) == found[0]
    sim.reset(1)
    assert not sim.state.numpy("time").any()


def test_worlds_begin_with_the_rows_that_are_given():
    sim = worlds_of_one_size()
    sim.run(20, DT)
    kept = sim.state.copy()
    position = np.arange(12.0).reshape(2, 3, 2)
    sim.reset([2, 0], {"position": position, "angle": np.ones(6), "time": [1.0, 2.0]})
    found = sim.state.numpy("position").reshape(3, 3, 2)
    assert np.array_equal(found[[2, 0]], position)
    assert np.array_equal(found[1], kept.numpy("position").reshape(3, 3, 2)[1])
    assert sim.state.numpy("angle").tolist()[:3] == [1, 1, 1] and sim.state.numpy("time").tolist()[::2] == [2, 1]
    assert np.array_equal(sim.state.numpy("velocity")[:3], sim.built.numpy("velocity")[:3])
    sim.reset([1, 2], kept)
    for name in ("position", "velocity", "time"):
        first, *others = np.split(sim.state.numpy(name) == kept.numpy(name), 3)
        assert np.all(others) and not first.all()
    sim.reset(state={"velocity": np.zeros((3, 3, 2))})
    assert np.array_equal(sim.state.numpy("position"), sim.built.numpy("position"))


def test_a_frozen_world_is_revived():
    sim = simulation()
    sim.run(3, DT)
    sim.state.numpy("force")[4] = np.nan
    sim.run(2, DT)
    assert sim.state.numpy("flags").tolist() == [dc.Flag.NONFINITE, 0]
    sim.reset(sim.state.numpy("flags") != 0)
    anew = simulation()
    for one in (sim, anew):
        one.run(5, DT)
    assert not sim.state.numpy("flags").any()
    assert of_worlds(sim, [0]) == of_worlds(anew, [0])


def test_in_the_middle_of_a_step_all_worlds_are_reset_or_none():
    sim = simulation()
    sim.run(5, DT)
    sim.collide(DT)
    before = bits(sim)
    with pytest.raises(ValueError, match=r"reset\(\) of some worlds in the middle of a step"):
        sim.reset([1])
    assert bits(sim) == before
    sim.reset()
    assert sim.phase == "advance"
    with pytest.raises(ValueError, match="needs collide"):
        sim.solve()
    anew = simulation()
    for one in (sim, anew):
        one.run(5, DT)
    assert of_worlds(sim, [0, 1]) == of_worlds(anew, [0, 1])


@pytest.mark.parametrize(
    ("worlds", "state", "error", "message"),
    [
        ([0, 3], None, ValueError, r"worlds\[1\] is 3; it must lie in \[0, 2\] and be there once"),
        ([1, 0, 1], None, ValueError, r"worlds\[2\] is 1; .* be there once"),
        (-1, None, ValueError, r"worlds\[0\] is -1"),
        ([True, False], None, ValueError, r"worlds is a mask of shape \(2,\); it must be \(3,\)"),
        ([[0]], None, ValueError, r"worlds has shape \(1, 1\)"),
        (0.5, None, TypeError, "worlds is 0.5; it must be a mask of bool, or integers"),
        ("all", None, TypeError, "worlds is 'all'"),
        (0, {"speed": 1}, ValueError, "state has 'speed'; it may have position, angle, "),
        (0, {"flags": [1]}, ValueError, "state has 'flags'"),
        (0, {"angle": np.zeros(2)}, ValueError, r"state\['angle'\] has shape \(2,\); it must be \(3,\)"),
        (0, {"velocity": [[0, 0], [0, np.inf], [0, 0]]}, ValueError, r"state\['velocity'\]\[1, 1\] is inf"),
        (0, 3.0, TypeError, "state is 3.0; it must be a State, or values by name of a field"),
        (0, "other", ValueError, r"state has 6 on axis 'body'; it must be the model's 9"),
    ],
)
def test_what_is_wrong_is_named_and_nothing_changes(worlds, state, error, message):
    sim = worlds_of_one_size()
    sim.run(5, DT)
    before = bits(sim)
    if state == "other":
        state = worlds_of_one_size(2).state
    with pytest.raises(error, match=message):
        sim.reset(worlds, state)
    assert bits(sim) == before


def test_a_graph_cannot_hold_it():
    sim = worlds_of_one_size()
    with wp.ScopedCapture("cpu"), pytest.raises(RuntimeError, match="reset cannot be recorded"):
        sim.reset()
