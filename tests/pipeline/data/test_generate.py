"""Data sets: what their files hold, read by plain h5py, and the recipes that they are made by."""

from __future__ import annotations

import dataclasses
import functools
import io
import json

import h5py
import hdf5plugin  # noqa: F401  (for h5py, which reads zstd with it)
import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels.measure import contact_slots
from pipeline.cli import main, parse
from pipeline.data import generate as generation
from pipeline.data import layout, shards
from pipeline.data.recipe import GenerateOptions, Recipe, load_recipe, parse_recipe
from pipeline.data.recorder import make_shard
from pipeline.scenes import Chain, Conveyor, Mixed, Stack, Thesis
from tests.pipeline.data.making import FILTERS, SHARDS, SMALL, changed, contents, filters, make


def test_layout_is_as_documented(whole):
    config = SMALL.config()
    for name in (*SHARDS, layout.INDEX):
        with h5py.File(whole / name) as file:
            assert (file.attrs["schema"], file.attrs["version"]) == ("deep-contact.dataset", layout.VERSION)
            index = file.attrs["kind"] == "index"
            known = config if index else {key: value for key, value in config.items() if key != "worlds"}
            assert json.loads(file.attrs["config"]) == known
            assert json.loads(file.attrs["versions"])["warp-lang"]
            assert file.attrs["flags"] == 0 and 0.9 < file.attrs["label_reached"] <= 1.0
            worlds = {"shard-00002.h5": 1, layout.INDEX: 5}.get(name, 2)
            assert (file.attrs["worlds"], file.attrs["steps"]) == (worlds, 70)
            assert file["world/seed"][0] == file.attrs["seed"]
            for axis, columns in layout.LAYOUT.items():
                for key, column in columns.items():
                    data = file[axis][key]
                    assert (data.attrs["unit"], data.attrs["meaning"]) == (column.unit, column.meaning)
                    assert data.dtype == column.dtype
                    if index and f"{axis}/{key}" not in layout.STARTS:
                        assert data.is_virtual
                    else:
                        assert filters(data) == FILTERS["gzip" if index else "zstd"]
            for start, rows in layout.STARTS.items():
                offsets = file[start][...]
                count = next(d for k, d in file[rows].items() if f"{rows}/{k}" not in layout.STARTS).shape[0]
                if rows == "contact":
                    count = file["contact/gap"].shape[0]
                assert offsets[0] == 0 and offsets[-1] == count and (np.diff(offsets) >= 0).all(), start
            assert list(file["contact/impulse"].attrs["stages"]) == ["start", "impulse", "label"]
    assert sorted(path.name for path in whole.iterdir()) == [layout.INDEX, *SHARDS]


def test_readers_without_our_code_find_a_state(whole):
    """The example of the README, against the simulation itself."""
    with h5py.File(whole / "index.h5") as file:
        s = file["world/step_start"][3] + 65  # world 3, step 65
        a, b = file["step/contact_start"][s : s + 2]
        start, impulse, label = file["contact/impulse"][:, a:b]
        key, point = file["contact/key"][a:b], file["contact/point"][a:b]
        a, b = file["step/motion_start"][s : s + 2]
        position = file["motion/position"][a:b]
        note = {name: file[f"step/{name}"][s] for name in ("sweeps", "change", "label_change", "label_sweeps", "step")}
    sim = dc.Simulation(*SMALL.scene.build(1, 10).finalize(), config=SMALL.solver)
    sim.run(65, 0.02)
    sim.collide(0.02)
    slots, _ = contact_slots(sim.contacts)
    np.testing.assert_array_equal(position, sim.state.numpy("position"))
    np.testing.assert_array_equal(key, sim.contacts.numpy("key")[slots])
    place = position[sim.contacts.numpy("body_a")[slots]] + sim.contacts.numpy("arm_a")[slots]
    np.testing.assert_array_equal(point, place)
    np.testing.assert_array_equal(start, sim.contacts.numpy("impulse")[slots])
    sim.solve()
    np.testing.assert_array_equal(impulse, sim.contacts.numpy("impulse")[slots])
    assert (note["sweeps"], note["change"]) == (sim.stats.numpy("sweeps")[0], sim.stats.numpy("change")[0])
    sim.solve(SMALL.label_config)
    np.testing.assert_array_equal(label, sim.contacts.numpy("impulse")[slots])
    assert (note["label_sweeps"], note["label_change"]) == (sim.stats.numpy("sweeps")[0], sim.stats.numpy("change")[0])
    assert note["step"] == 65 and len(key) > 5 and (label != impulse).any()


def test_index_shows_the_shards_as_one(whole):
    with h5py.File(whole / layout.INDEX) as index:
        parts = [h5py.File(whole / name) for name in SHARDS]
        for name, data in shards.datasets(parts[0]):
            axis = 1 if name == "contact/impulse" else 0
            if name not in layout.STARTS:
                np.testing.assert_array_equal(index[name], np.concatenate([part[name] for part in parts], axis))
            else:
                sizes = np.concatenate([np.diff(part[name]) for part in parts])
                np.testing.assert_array_equal(np.diff(index[name]), sizes)
            assert index[name].attrs["meaning"] == data.attrs["meaning"]
        assert index["world/seed"][...].tolist() == [7, 8, 9, 10, 11]
        assert index["shard/world_start"][...].tolist() == [0, 2, 4, 5]


def test_threads_and_shards_change_no_bit(whole, tmp_path):
    make(SMALL, tmp_path / "threads", threads=2)
    assert contents(tmp_path / "threads") == contents(whole)
    make(changed(SMALL, shard_worlds=5), tmp_path / "one")
    with h5py.File(tmp_path / "one" / layout.INDEX) as one, h5py.File(whole / layout.INDEX) as three:
        for name, data in shards.datasets(three):
            if not name.startswith("shard/"):
                np.testing.assert_array_equal(one[name], data, name)


def test_growth_within_a_shard_changes_no_bit(whole, monkeypatch):
    """Room runs out in mid-run: the step is repeated, no state is kept twice."""
    monkeypatch.setattr(dc, "Simulation", functools.partial(dc.Simulation, contacts_per_body=0.2, pairs_per_shape=0.2))
    assert bytes(make_shard(SMALL, 0)) == (whole / SHARDS[0]).read_bytes()


def test_labels_are_tighter_than_the_run(whole):
    with h5py.File(whole / layout.INDEX) as file:
        busy = np.diff(file["step/contact_start"]) > 0
        change, label = file["step/change"][...][busy], file["step/label_change"][...][busy]
        reached = file["step/label_reached"][...][busy] == 1
        residual, label_residual = file["step/residual"][...][busy], file["step/label_residual"][...][busy]
    np.testing.assert_array_equal(reached, label <= np.float32(1e-5))
    assert (label[reached] <= 1e-5).all() and (change > 1e-5).any()
    assert np.median(label_residual) < 0.3 * np.median(residual)


def test_labels_may_stop_by_the_residual():
    recipe = dataclasses.replace(SMALL, solver=dc.SolverConfig(stop="residual", tolerance=1e-3))
    recipe = changed(recipe, worlds=1, label_tolerance=1e-4)
    with h5py.File(io.BytesIO(make_shard(recipe, 0))) as file:
        reached, residual = file["step/label_reached"][...] == 1, file["step/label_residual"][...]
        np.testing.assert_array_equal(reached, residual <= np.float32(1e-4))
        assert reached.mean() > 0.9


def test_a_world_that_stops_is_marked(tmp_path):
    recipe = Recipe(scene=Thesis(bodies=2, gravity=1e37), options=GenerateOptions(worlds=1, steps=30, dt=1.0))
    summary = make(recipe, tmp_path)
    assert summary["flags"] == "NONFINITE"
    with h5py.File(tmp_path / layout.INDEX) as file:
        flags = file["step/flags"][...]
        assert flags[-1] and file.attrs["flags"] == flags[-1]
        first = int(np.argmax(flags != 0))
        assert not np.diff(file["step/contact_start"])[first + 1 :].any()
        assert np.isfinite(file["motion/position"][...]).all()
    assert "NONFINITE" in generation.describe(summary)


# ---------------------------------------------------------------------- ranges


def test_ranges_are_drawn_from_each_worlds_seed(tmp_path):
    ranges = (("radius", 0.2, 0.4), ("bodies", 3, 8), ("dt", 0.01, 0.03))
    recipe = changed(SMALL, worlds=6, ranges=ranges, steps=3)
    make(recipe, tmp_path)
    with h5py.File(tmp_path / layout.INDEX) as file:
        drawn = {name: file[f"drawn/{name}"][...] for name, _, _ in ranges}
        for name, low, high in ranges:
            assert len(set(drawn[name].tolist())) > 2 and low <= drawn[name].min() and drawn[name].max() <= high
        assert drawn["bodies"].dtype == np.int64
        np.testing.assert_array_equal(file["world/dt"], drawn["dt"].astype(np.float32))
        bodies, steps = file["world/body_start"][...], file["world/step_start"][...]
        motion, velocity = file["step/motion_start"][...], file["motion/velocity"][...]
        for w in range(6):
            scene = dataclasses.replace(SMALL.scene, radius=drawn["radius"][w], bodies=int(drawn["bodies"][w]))
            model, state, _ = scene.build(1, 7 + w).finalize()
            rows = slice(motion[steps[w]], motion[steps[w] + 1])
            np.testing.assert_array_equal(file["motion/position"][rows], state.numpy("position"))
            np.testing.assert_array_equal(file["body/mass"][bodies[w] : bodies[w + 1]], model.numpy("mass"))
            fallen = velocity[motion[steps[w] + 1] + 1]
            np.testing.assert_allclose(fallen, [0.0, -9.8 * drawn["dt"][w]], rtol=1e-6, atol=1e-7)
    # a further range changes nothing in what is drawn for the others
    more = changed(recipe, ranges=(*ranges, ("friction", 0.1, 0.9)))
    assert {**more.draw(9), "friction": None} == {**recipe.draw(9), "friction": None}


@pytest.mark.parametrize(
    "ranges, match",
    [
        ((("weight", 0.0, 1.0),), r"ranges.weight: thesis has .*'radius'.* to draw from"),
        ((("radius", 0.6, 0.4),), r"ranges.radius is \(0.6, 0.4\)"),
        ((("bodies", 2.5, 4.0),), "ranges.bodies .* must be integers"),
        ((("radius", -0.1, 0.4),), "thesis.radius is -0.1"),
        ((("restitution", 0.0, 1.5),), "thesis.restitution is 1.5"),
        ((("dt", 0.0, 0.1),), "dt is 0.0"),
        ((("radius", 0.1, 0.2), ("radius", 0.3, 0.4)), "ranges.radius is given twice"),
    ],
)
def test_bad_ranges_are_named(ranges, match, tmp_path):
    with pytest.raises(ValueError, match=match):
        make(changed(SMALL, ranges=ranges), tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "options, match",
    [
        ({"worlds": 0}, "worlds is 0; it must be an integer"),
        ({"seed": -1}, "seed is -1"),
        ({"label_tolerance": 1e-3}, "label_tolerance is 0.001; it must not exceed solver.tolerance"),
        ({"label_sweeps": 0}, "label_sweeps is 0"),
        ({"grids": True, "grid_spacing": 0.0}, "spacing is 0"),
        ({"grids": True, "grid_spacing": 0.01}, "grid_spacing is 0.01: 2253001 nodes; 349525 can be stored"),
    ],
)
def test_bad_options_are_named(options, match, tmp_path):
    with pytest.raises(ValueError, match=match):
        make(changed(SMALL, **options), tmp_path)


def test_joints_are_refused(tmp_path):
    with pytest.raises(ValueError, match="scene chain has joints"):
        make(Recipe(scene=Chain(), options=SMALL.options), tmp_path)
    with pytest.raises(ValueError, match="scene conveyor has surfaces that move or resist rolling"):
        make(Recipe(scene=Conveyor(), options=SMALL.options), tmp_path)


# ---------------------------------------------------------------------- grids


def test_stored_grids_are_those_made_from_the_states(tmp_path):
    dataset = pytest.importorskip("pipeline.data.dataset")
    splatter = pytest.importorskip("pipeline.data.splatter")
    recipe = Recipe(scene=Mixed(bodies=6), options=changed(SMALL, worlds=2, grids=True, grid_size=(5.0, 5.0)).options)
    make(recipe, tmp_path)
    states = dataset.States(tmp_path, min_contacts=0)
    image, label = splatter.Splatter(dc.ImageSpec(recipe.options.grid))(states.batch(range(len(states))))
    with h5py.File(tmp_path / layout.INDEX) as file:
        np.testing.assert_array_equal(file["grid/input"], image)
        np.testing.assert_array_equal(file["grid/label"], label)
        assert label.any() and file["grid/input"].is_virtual
    with h5py.File(tmp_path / SHARDS[0]) as file:
        assert filters(file["grid/input"]) == FILTERS["zstd"]


# ---------------------------------------------------------------------- recipes and the command line

TOML = """
worlds = 3
steps = 30
dt = 0.02
grid_size = [4.0, 4.0]
[scene]
name = "mixed"
bodies = 5
radius = 1
[ranges]
friction = [0.2, 0.8]
[solver]
max_sweeps = 300
"""


def test_a_toml_file_is_a_recipe(tmp_path):
    path = tmp_path / "recipe.toml"
    path.write_text(TOML)
    recipe = load_recipe(path)
    assert recipe.scene == Mixed(bodies=5, radius=1.0) and recipe.solver == dc.SolverConfig(
        max_sweeps=300, min_sweeps=1, stop="change", tolerance=1e-4, relative_tolerance=1.3e-3
    )
    options = GenerateOptions(worlds=3, steps=30, dt=0.02, grid_size=(4.0, 4.0), ranges=(("friction", 0.2, 0.8),))
    assert recipe.options == options
    assert parse_recipe(recipe.config()) == recipe


@pytest.mark.parametrize(
    "text, match",
    [
        ("world = 3", r"recipe.toml: world is unknown; there are \('worlds'"),
        ("worlds = 3.5", "worlds is 3.5; it must be an integer"),
        ("[scene]\nname = 'box'", "scene is 'box'"),
        ("[scene]\nname = 'thesis'\nweight = 1.0", "scene.weight is unknown"),
        ("[scene]\nbodies = 8", r"scene.name is missing; it must say whose \('bodies',\) are"),
        ("[solver]\nmethod = 'newton'", "solver.method is 'newton'"),
        ("[solver]\nhistory = true", "solver.history is True"),
        ("[solver]\nstop = 'motion'", "solver.stop is 'motion'"),
        ("[solver]\nmethod = 'tgs_soft'", "solver.method is 'tgs_soft'"),
        ("[solver]\nsubsteps = 2", "solver.substeps is 2; a data set holds every step"),
        ("[ranges]\nradius = 0.5", r"ranges.radius is 0.5; it must be \[low, high\]"),
        ("worlds = ", "recipe.toml"),
    ],
)
def test_bad_toml_is_named(text, match, tmp_path):
    path = tmp_path / "recipe.toml"
    path.write_text(text)
    with pytest.raises(ValueError, match=match):
        load_recipe(path)


def test_options_take_the_place_of_the_files(tmp_path):
    path = tmp_path / "recipe.toml"
    path.write_text(TOML)
    command = parse(["generate", f"--config={path}", "--steps", "7"])
    assert (command.options.steps, command.options.worlds, command.scene) == (7, 3, Mixed(bodies=5, radius=1.0))
    command = parse(["generate", "mixed", "--config", str(path), "--bodies", "4", "--ranges", "radius", "0.3", "0.4"])
    assert (command.scene.bodies, command.options.ranges) == (4, (("radius", 0.3, 0.4),))
    assert parse(["generate", "stack"]).scene == Stack()


def test_command_makes_and_reports(tmp_path, capsys):
    arguments = ["generate", "thesis", "--bodies", "4", "--worlds", "2", "--steps", "50", "--dt", "0.02"]
    arguments += ["--out", str(tmp_path / "data"), "--threads", "1"]
    assert main(arguments) == 0
    assert "100 states" in capsys.readouterr().out
    assert main([*arguments, "--json"]) == 0
    summary = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert summary["shards_kept"] == 1 and summary["config"]["scene"]["bodies"] == 4
    with pytest.raises(SystemExit):
        main([*arguments, "--steps", "51"])
    assert "steps = 50, not 51" in capsys.readouterr().err
