"""A copy of a simulation goes on with its bits, whenever and however it was made."""

import copy
import io
import pickle
import subprocess
import sys

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels.model.fields import PER_CONTACT
from dc_kernels.runtime import stepping
from tests.driving.scenes import DT, bits, scene, simulation


def through_file(sim):
    file = io.BytesIO()
    sim.save(file)
    file.seek(0)
    return dc.Simulation.load(file, threads=sim.threads)


WAYS = {
    "clone": dc.Simulation.clone,
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
    "pickle": lambda sim: pickle.loads(pickle.dumps(sim)),
    "file": through_file,
}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize(
    ("dtype", "backend", "threads"), [("float32", "warp", 2), ("float64", "warp", 1), ("float64", "numpy", 1)]
)
def test_a_copy_goes_on_with_the_same_bits(way, dtype, backend, threads):
    steps = 30 if backend == "warp" else 6
    sim = simulation(dtype, backend, threads=threads)
    sim.run(steps, DT)
    other = WAYS[way](sim)
    assert type(other) is dc.Simulation
    assert (other.config, other.threads, other.backend, other.dtype) == (sim.config, threads, backend, sim.dtype)
    before = bits(other)
    sim.run(steps, DT)
    assert bits(other) == before  # its memory is its own
    other.run(steps, DT)
    for group in ("state", "joints", "contacts", "cache"):
        for name, field in getattr(sim, group).table.items():
            one, two = (getattr(s, group).numpy(name) for s in (sim, other))
            if field.per in PER_CONTACT and len(one):
                one, two = (a[dc.contact_slots(s.contacts)[0]] for a, s in ((one, sim), (two, other)))
            if name != "contact_start":  # rooms may differ
                assert one.tobytes() == two.tobytes(), f"{group}.{name}"
    if way != "file":
        assert bits(sim) == bits(other)  # to the last number of its rows


@pytest.mark.parametrize("way", ["clone", "pickle"])
@pytest.mark.parametrize("threads", [1, 2])
def test_a_copy_from_within_a_step_ends_it_with_the_same_bits(way, threads):
    sim = simulation(threads=threads)
    sim.run(25, DT)
    sim.collide(DT)
    others = [WAYS[way](sim)]
    assert others[0].phase == "collide"
    sim.solve(pause=7)
    others.append(WAYS[way](sim))
    assert others[1].phase == "solve" and sim.running.any()
    sim.resume()
    others.append(WAYS[way](sim))
    assert not others[2].running.any()
    others[0].solve(pause=7)
    others[0].resume()
    others[1].resume()
    for one in (sim, *others):
        one.advance()
        one.run(3, DT)
    assert bits(sim) == bits(others[0]) == bits(others[1]) == bits(others[2])


def test_within_a_step_nothing_is_saved():
    sim = simulation()
    sim.collide(DT)
    file = io.BytesIO()
    with pytest.raises(ValueError, match="middle of a step"):
        sim.save(file)
    assert file.getvalue() == b""


def test_a_copy_of_a_frozen_world_is_frozen_and_goes_on_when_it_is_revived():
    sim = simulation()
    sim.run(5, DT)
    sim.state.numpy("force")[3] = np.nan
    sim.run(2, DT)
    assert sim.state.numpy("flags")[0] == dc.Flag.NONFINITE
    other = pickle.loads(pickle.dumps(sim))
    assert bits(other) == bits(sim)
    for one in (sim, other):
        one.state.numpy("force")[3] = 0.0
        one.state.numpy("flags")[:] = 0
        one.run(3, DT)
    assert bits(other) == bits(sim)


def test_a_copy_after_growth_has_the_room_that_there_is():
    sim = simulation(pairs_per_shape=0.1, contacts_per_body=0.1)
    sim.run(30, DT)
    other = sim.clone()
    assert other.capacity() == sim.capacity()
    sim.run(30, DT)
    other.run(30, DT)
    assert bits(other) == bits(sim)


def test_a_copy_of_small_worlds_is_cut_into_as_many_tiles_after_they_got_more_room(monkeypatch):
    monkeypatch.setattr(stepping, "TILE", 20)
    sim = simulation()
    sim.run(5, DT)
    most = {name: room["peak_of_a_world"] for name, room in sim.capacity().items()}
    sim.reserve(bodies=40)
    assert {name: room["peak_of_a_world"] for name, room in sim.capacity().items()} == most
    other = sim.clone()
    for one in (sim, other):
        one.run(5, DT)
    assert len(sim.peak) == len(other.peak) and bits(sim) == bits(other)


def test_what_is_copied_together_belongs_together():
    sim = simulation()
    for made in (copy.deepcopy((sim, sim.model, sim.state)), pickle.loads(pickle.dumps((sim, sim.model, sim.state)))):
        other, model, state = made
        assert other.model is model and other.state is state
        assert model is not sim.model


@pytest.mark.parametrize("way", [copy.copy, copy.deepcopy, lambda group: pickle.loads(pickle.dumps(group))])
def test_groups_are_copied_with_their_memory(way):
    model, state, joints = scene()
    dc.Simulation(model, state, joints)
    for group in (model, state, joints):
        other = way(group)
        assert type(other) is type(group) and other.sizes == group.sizes
        for name in group.table:
            assert np.array_equal(other.numpy(name), group.numpy(name))
            assert not group.table[name].per or not np.shares_memory(other.numpy(name), group.numpy(name))
        assert other.writable("mass" if group is model else next(iter(group.table)))


def test_settings_are_pickled():
    config = dc.SolverConfig(method="jacobi", tolerance=1e-3)
    assert pickle.loads(pickle.dumps(config)) == copy.deepcopy(config) == config


def test_files_that_are_none():
    sim = simulation()
    with pytest.raises(TypeError, match=r"path is a StringIO, a file of text; it must be a binary file, or a path"):
        sim.save(io.StringIO())
    with pytest.raises(TypeError, match="path is a StringIO"):
        dc.Simulation.load(io.StringIO())
    with pytest.raises(ValueError, match=r"<BytesIO> is not an HDF5 file, or is truncated"):
        dc.Simulation.load(io.BytesIO(b"nothing"))
    file = io.BytesIO()
    sim.save(file)
    with pytest.raises(ValueError, match="<BytesIO>"):
        dc.Simulation.load(io.BytesIO(file.getvalue()[:-100]))


def test_a_snapshot_goes_to_where_a_file_stands(tmp_path):
    sim = simulation()
    with open(tmp_path / "two.h5", "w+b", buffering=0) as file:
        file.write(b"head")
        sim.save(file)
        file.seek(4)
        assert bits(dc.Simulation.load(file)) == bits(dc.Simulation.load(through(sim)))


def through(sim):
    file = io.BytesIO()
    sim.save(file)
    file.seek(0)
    return file


def test_another_process_goes_on_with_a_pickle(tmp_path):
    sim = simulation("float64", "numpy")
    sim.run(4, DT)
    (tmp_path / "sim.pickle").write_bytes(pickle.dumps(sim))
    sim.run(2, DT)
    code = (
        "import pickle, sys, numpy as np\n"
        "sim = pickle.load(open(sys.argv[1], 'rb'))\n"
        f"sim.run(2, {DT})\n"
        "np.save(sys.argv[2], sim.state.numpy('position'))"
    )
    subprocess.run([sys.executable, "-c", code, tmp_path / "sim.pickle", tmp_path / "position.npy"], check=True)
    assert np.array_equal(np.load(tmp_path / "position.npy"), sim.state.numpy("position"))
