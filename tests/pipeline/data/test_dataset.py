"""States of a data set as batches: what they hold, their order, and that their images are those of a simulation."""

from __future__ import annotations

import dataclasses
import pickle
import shutil

import h5py
import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels.measure import contact_slots
from dc_kernels.runtime import hdf5

torch = pytest.importorskip("torch")

from pipeline.data import folders, layout  # noqa: E402
from pipeline.data.dataset import Batch, BatchOrder, States, collate, describe, loader  # noqa: E402
from pipeline.data.generate import generate  # noqa: E402
from pipeline.data.recipe import SOLVER, GenerateOptions, Recipe  # noqa: E402
from pipeline.data.splatter import Splatter  # noqa: E402
from pipeline.scenes import Mixed, Thesis  # noqa: E402
from pipeline.seeds import HELD_OUT_SEED  # noqa: E402

torch.set_num_threads(1)
SCENE = Mixed(bodies=9)
OPTIONS = GenerateOptions(worlds=7, seed=3, steps=60, dt=0.02, shard_worlds=3)
GRID = dc.Grid.from_box((0.0, 0.0), (SCENE.side, SCENE.side), 0.25)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Seven small worlds in three shards."""
    path = tmp_path_factory.mktemp("data")
    generate(Recipe(scene=SCENE, options=OPTIONS), path, threads=1, progress=False)
    return path


def simulation() -> dc.Simulation:
    """The worlds of the data set, all at once."""
    return dc.Simulation(*SCENE.build(OPTIONS.worlds, OPTIONS.seed).finalize(), config=SOLVER)


def index_of(states: States, world: int, step: int) -> int:
    """Index of a state of a data set that holds all of them."""
    return world * OPTIONS.steps + step


def same(one: Batch, other: Batch) -> bool:
    """Whether two batches hold the same bits."""
    names = [field.name for field in dataclasses.fields(Batch)]
    return all(torch.equal(getattr(one, name), getattr(other, name)) for name in names)


def test_a_batch_is_what_the_simulation_was_in(folder):
    states = States(folder, min_contacts=0)
    assert len(states) == OPTIONS.worlds * OPTIONS.steps
    sim = simulation()
    model = sim.model
    for step in range(45):
        sim.collide(OPTIONS.dt)
        if step not in (0, 30, 44):
            sim.solve()
            sim.advance()
            continue
        batch = states.batch([index_of(states, w, step) for w in range(OPTIONS.worlds)])
        slots, _ = contact_slots(sim.contacts)
        assert batch.body_start.tolist() == model.numpy("body_start").tolist()
        assert batch.contact_start.diff().tolist() == sim.contacts.numpy("contact_count").tolist()
        assert batch.seed.tolist() == list(range(3, 10)) and set(batch.step.tolist()) == {step}
        for name in ("position", "angle", "velocity", "angular_velocity"):
            np.testing.assert_array_equal(getattr(batch, name).numpy(), sim.state.numpy(name), name)
        for name in ("mass", "inertia", "body_type", "gravity"):
            np.testing.assert_array_equal(getattr(batch, name).numpy(), model.numpy(name), name)
        for name in ("body_a", "body_b", "normal", "gap", "friction", "restitution", "age", "color"):
            np.testing.assert_array_equal(getattr(batch, name).numpy(), sim.contacts.numpy(name)[slots], name)
        place = sim.state.numpy("position")[sim.contacts.numpy("body_a")[slots]] + sim.contacts.numpy("arm_a")[slots]
        np.testing.assert_array_equal(batch.point.numpy(), place)
        np.testing.assert_array_equal(batch.start.numpy(), sim.contacts.numpy("impulse")[slots])
        sim.solve()
        np.testing.assert_array_equal(batch.impulse.numpy(), sim.contacts.numpy("impulse")[slots])
        sim.advance()
    assert len(batch.gap) > 20 and batch.label.shape == batch.impulse.shape
    assert batch.dt.tolist() == [np.float32(OPTIONS.dt)] * OPTIONS.worlds
    assert batch.to(torch.float64).gap.dtype == torch.float64


@pytest.mark.parametrize("walls, bins", [(100.0, 1), (None, 1), (25.0, 4)])
def test_images_are_those_of_the_simulation(folder, walls, bins):
    """Bit by bit: a network then sees in a simulation what it was trained on."""
    spec = dc.ImageSpec(
        GRID,
        body_channels=("mass", "velocity_x", "velocity_y", "omega", "speed", "angle_cos"),
        contact_channels=("normal_x", "normal_y", "gap", "impulse_n", "impulse_t", "friction", "new"),
        walls=walls,
        bins=bins,
    )
    splatter = Splatter(spec)
    states, sim = States(folder, min_contacts=0), simulation()
    images = dc.Images(sim, spec)
    assert splatter.channels == images.channels
    sim.run(39, OPTIONS.dt)
    for step in (39, 40):
        sim.collide(OPTIONS.dt)
        batch = states.batch([index_of(states, w, step) for w in range(OPTIONS.worlds)])
        image, _ = splatter(batch)
        np.testing.assert_array_equal(image.numpy(), dc.to_numpy(images.splat()))
        sim.solve()
        _, label = splatter(dataclasses.replace(batch, label=batch.impulse))
        np.testing.assert_array_equal(label.numpy(), dc.to_numpy(images.impulse_image()))
        assert label.abs().sum() > 0
        sim.advance()


def test_speeds_at_contacts_agree_to_round_off(folder):
    """Their arms are taken from the places, which were rounded."""
    spec = dc.ImageSpec(GRID, body_channels=(), contact_channels=("closing_speed", "sliding_speed"))
    splatter = Splatter(spec)
    states, sim = States(folder, min_contacts=0), simulation()
    images = dc.Images(sim, spec)
    sim.run(35, OPTIONS.dt)
    sim.collide(OPTIONS.dt)
    image, _ = splatter(states.batch([index_of(states, w, 35) for w in range(OPTIONS.worlds)]))
    np.testing.assert_allclose(image.numpy(), dc.to_numpy(images.splat()), atol=2e-6)


def test_images_of_states_without_contacts(folder):
    image, label = Splatter(dc.ImageSpec(GRID))(States(folder, min_contacts=0)[0])
    assert image.shape == (1, 6, *GRID.shape) and image[:, 0].sum() > 100.0 and not image[:, 4:].any()
    assert label.shape == (1, 2, *GRID.shape) and not label.any()


def test_bad_splatters_are_refused():
    with pytest.raises(ValueError, match="area is True; a data set keeps no shapes of bodies that move"):
        Splatter(dc.ImageSpec(GRID, area=True))
    with pytest.raises(ValueError, match="threads is 0"):
        Splatter(dc.ImageSpec(GRID), threads=0)


def test_splits_share_no_world(folder):
    train, validation = (States(folder, split, 0.3, split_seed=5) for split in ("train", "validation"))
    seen = [set(states.world_of(np.arange(len(states))).tolist()) for states in (train, validation)]
    assert not seen[0] & seen[1] and len(seen[1]) == 2
    assert seen[0] | seen[1] == set(range(OPTIONS.worlds))
    again = States(folder, "validation", 0.3, split_seed=5)
    np.testing.assert_array_equal(again.rows, validation.rows)
    assert any((States(folder, "validation", 0.3, split_seed=s).worlds != validation.worlds).any() for s in range(5))


def test_stride_and_contacts_choose_states(folder):
    states = States(folder, stride=7, min_contacts=5)
    batch = states.batch(range(len(states)))
    assert set((batch.step % 7).tolist()) == {0}
    assert batch.contact_start.diff().min() >= 5
    every = States(folder, min_contacts=0).contact_count.reshape(OPTIONS.worlds, OPTIONS.steps)
    assert len(states) == (every[:, ::7] >= 5).sum()


def test_order_depends_on_seed_and_epoch_only(folder):
    def epoch(number: int, **options) -> list[Batch]:
        batches = loader(folder, batch_size=16, split="train", stride=3, **options)
        batches.set_epoch(number)
        return list(batches)

    first = epoch(0, seed=1)
    assert all(map(same, first, epoch(0, seed=1)))
    key = [(int(s), int(t)) for batch in first for s, t in zip(batch.seed, batch.step)]
    assert len(set(key)) == len(key) == len(States(folder, "train", stride=3))
    for other in (epoch(1, seed=1), epoch(0, seed=2)):
        found = [(int(s), int(t)) for batch in other for s, t in zip(batch.seed, batch.step)]
        assert found != key and sorted(found) == sorted(key)
    # shuffled across worlds: a batch holds several
    assert min(len(batch.seed.unique()) for batch in first[:-1]) > 2


def test_pools_bound_what_is_kept(folder):
    """Few worlds are read again and again only where a pool ends."""
    states = States(folder, "train", cache_bytes=0)
    assert states.pool == 2
    order = BatchOrder(states, 8, seed=3)
    worlds = states.world_of(order.order())
    changes = [len(set(worlds[i : i + 8].tolist())) for i in range(0, len(worlds), 8)]
    assert max(changes) <= 4
    small, large = list(loader(folder, batch_size=8, cache_bytes=0)), States(folder, "train")
    assert sorted(int(n) for batch in small for n in batch.step) == sorted(
        int(n) for n in large.batch(range(len(large))).step
    )
    assert len(states._known) <= 2


def test_ranks_share_the_batches(folder):
    whole = list(loader(folder, batch_size=20, seed=4))
    parts = [list(loader(folder, batch_size=20, seed=4, rank=rank, world_size=3)) for rank in range(3)]
    assert len({len(part) for part in parts}) == 1
    joined = [batch for group in zip(*parts) for batch in group]
    assert all(map(same, whole, joined))
    dropped = list(loader(folder, batch_size=20, seed=4, drop_last=True))
    assert {len(batch) for batch in dropped} == {20}


def test_workers_give_the_same_batches(folder):
    options = {"batch_size": 32, "split": "validation", "stride": 5}
    assert all(map(same, loader(folder, **options), loader(folder, num_workers=1, **options)))


def test_options_are_those_of_torch(folder):
    """What is given beside the states' own options reaches torch; batches do not depend on it."""
    options = {"batch_size": 32, "split": "validation", "stride": 5}
    more = {"prefetch_factor": 3, "persistent_workers": False, "multiprocessing_context": "fork", "timeout": 280}
    made = loader(folder, num_workers=2, **more, **options)
    assert (made.num_workers, made.prefetch_factor, made.persistent_workers, made.timeout) == (2, 3, False, 280)
    assert all(map(same, loader(folder, **options), made))
    assert loader(folder, pin_memory=True, **options).pin_memory
    with pytest.raises(TypeError, match="nonsense"):
        loader(folder, nonsense=1, **options)
    for name in ("sampler", "batch_sampler", "collate_fn"):
        with pytest.raises(ValueError, match=rf"{name} is the loader's own"):
            loader(folder, **options, **{name: None})


def test_the_loader_of_torch_takes_states(folder):
    states = States(folder, stride=5)
    batches = list(torch.utils.data.DataLoader(states, batch_size=16, num_workers=1, collate_fn=collate))
    assert sum(map(len, batches)) == len(states)
    assert same(batches[1], states.batch(range(16, 32)))


def test_a_batch_is_pinned_tensor_by_tensor(folder):
    class Pinned:
        def pin_memory(self):
            return "pinned"

    names = [field.name for field in dataclasses.fields(Batch)]
    pinned = Batch(**{name: Pinned() for name in names}).pin_memory()
    assert all(getattr(pinned, name) == "pinned" for name in names)


def test_states_open_nothing_until_asked(folder):
    states = States(folder)
    states[3]
    copy = pickle.loads(pickle.dumps(states))
    assert not copy._known and same(copy[3], states[3])


def test_held_out_worlds_are_not_for_training(tmp_path):
    options = GenerateOptions(worlds=1, seed=HELD_OUT_SEED, steps=40, dt=0.02)
    generate(Recipe(scene=Thesis(bodies=4), options=options), tmp_path, threads=1, progress=False)
    assert len(States(tmp_path)) > 0
    for split in ("train", "validation"):
        with pytest.raises(ValueError, match="for tests, never for training"):
            States(tmp_path, split)


def test_description(folder):
    found = describe(folder)
    assert found["seeds"] == (3, 10) and found["worlds"] == 7 and found["states"] == 420
    np.testing.assert_allclose(found["box"], (0.0, 0.0, SCENE.side, SCENE.side), rtol=1e-6)
    lengths = SCENE.build(7, 3).finalize()[0].numpy("length_scale")
    assert found["slop"] == pytest.approx(5e-4 * lengths.mean())
    assert found["config"]["scene"]["name"] == "mixed"


def test_bad_arguments_and_folders_are_named(folder, tmp_path):
    with pytest.raises(ValueError, match="stride is 0"):
        States(folder, stride=0)
    with pytest.raises(ValueError, match="validation is 1"):
        States(folder, validation=1.0)
    with pytest.raises(ValueError, match="split is 'test'"):
        States(folder, "test")
    with pytest.raises(ValueError, match=r"rank is 2; it must lie in \[0, 2\)"):
        loader(folder, batch_size=4, rank=2, world_size=2)
    with pytest.raises(ValueError, match="no state with split"):
        loader(folder, batch_size=4, min_contacts=10_000)
    with pytest.raises(ValueError, match=r"has no index\.h5"):
        States(tmp_path)
    (tmp_path / layout.INDEX).write_bytes(b"no data set")
    with pytest.raises(ValueError, match="not an HDF5 file"):
        States(tmp_path)


def test_a_shard_that_changes_is_checked_anew(folder, tmp_path, monkeypatch):
    checks, check = [], folders.check_shapes
    monkeypatch.setattr(folders, "check_shapes", lambda *args: (checks.append(1), check(*args)))
    monkeypatch.setattr(hdf5, "SETTLE_NS", 0)
    copy = shutil.copytree(folder, tmp_path / "copy")
    states = States(copy)
    shards = len(checks)
    first, last = np.unique(states.world_of(np.arange(len(states))), return_index=True)[1][[0, -1]]
    assert len(states[first]) == len(states[last]) == 1 and len(checks) == shards  # checked when the index was read
    for path in copy.glob("shard-*.h5"):
        with h5py.File(path, "r+") as file:
            file["step/motion_start"][-1] += 1
    states = pickle.loads(pickle.dumps(states))  # as a worker has it, which knows what was checked
    with pytest.raises(ValueError, match=r"shard-.*h5 is damaged: step/motion_start must ascend"):
        states[last]


def test_what_is_no_index_of_a_state_is_refused(folder):
    states = States(folder)
    for index in (1.5, True, "1", None, np.zeros(len(states), bool)):
        with pytest.raises(TypeError, match=r"index is .*; it must be an integer, or several"):
            states[index]
    for index in (len(states), -len(states) - 1):
        with pytest.raises(IndexError, match=rf"index is {index}; it must lie in \[-\d+, \d+\]"):
            states[index]
    assert same(states[-1], states[np.int32(len(states) - 1)])
