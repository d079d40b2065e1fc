"""The benches: that they can be listed, named, built and printed. What they measure is for no test to judge."""

from __future__ import annotations

import json

import numpy as np
import pytest

import dc_kernels as dc
from bench import __main__ as command
from bench import cases, run, timing
from bench.pages import page
from bench.peers import peers
from bench.speed import skips
from bench.speed import worlds as bench_worlds
from bench.stability import presets
from pipeline import scenes

DISC_ON_FLOOR = peers.DiscWorld(
    positions=np.array([[1.0, 0.5], [3.0, 0.5]]), radii=np.array([0.5, 0.5]), walls=np.array([[[0.0, 0.0], [5.0, 0.0]]])
)


def fake_worlds() -> dict:
    """A record of the bench ``worlds`` with invented figures."""
    values = {key: float(i + 1) for i, key in enumerate(bench_worlds.KEYS)}
    return {"bench": "worlds", "machine": {"cpu": "none"}, **values}


def test_names_are_listed(capsys):
    assert command.main([]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == list(command.NAMES)
    assert all(len(line.split()) > 3 for line in lines)


def test_unknown_name_fails(capsys):
    assert command.main(["sweeps"]) == 2
    error = capsys.readouterr().err
    assert "sweeps" in error and all(name in error for name in command.NAMES)
    assert run.main(["sweeps"]) == 2


@pytest.mark.parametrize("name", command.NAMES)
def test_json_line_has_the_named_keys(name, monkeypatch, capsys):
    bench = command.load(name)
    monkeypatch.setattr(bench, "measure", lambda quick: dict.fromkeys(bench.KEYS, np.float32(1.5)))
    monkeypatch.setattr(bench, "report", lambda values: "a table")
    assert command.main([name, "--quick", "--json"]) == 0
    *_, people, last = capsys.readouterr().out.splitlines()
    record = json.loads(last)
    assert people == "a table"
    assert record["bench"] == name and record["quick"] is True
    assert all(record[key] == 1.5 for key in bench.KEYS)
    assert record["machine"]["cpu"] and record["machine"]["packages"]["numpy"] == np.__version__


def test_both_forms_of_the_training_bench_have_a_section():
    whole = {"bench": "train", "quick": False, "minutes": 7.5, "steps": 7000, "extrapolated": False}
    quick = {**whole, "quick": True, "step_s": 0.0625, "extrapolated": True}
    assert "| steps | 7 000 |" in page.section(whole) and "extrapolated" not in page.section(whole)
    assert "| a step [s] | 0.0625 |" in page.section(quick)


def test_records_of_quick_forms_and_of_scenes_alone_have_a_section():
    found = page.section({"bench": "presets", "quick": True, **dict.fromkeys(presets.KEYS, 1.5), "scenes": {"one": {}}})
    assert "| `sweeps_over_accurate` | 1.5 |" in found
    records = page.read()
    quick = records["error_time"]
    del quick["scenes"]["thesis_1000"]
    for scene in quick["scenes"].values():
        for race in scene["residual"].values():
            race.pop("adaptive, scalar", None)
    quick["orders"] = dict.fromkeys(quick["orders"])
    assert "Orders in dt: stop -" in page.section(quick)
    assert "overlap below 1 mm" not in page.headlines(records)


def test_json_line_misses_no_key():
    with pytest.raises(ValueError, match="worlds measured no ns_discs"):
        timing.json_line("worlds", {"ns_general": 1.0}, ("ns_general", "ns_discs"), quick=True)


def test_interleave_calls_in_turn():
    calls = []
    functions = {name: lambda name=name: calls.append(name) for name in "ab"}
    ticks = iter(range(100))

    def clock(function):
        function()
        return next(ticks)

    times = timing.interleave(functions, 3, warmup=1, clock=clock)
    assert "".join(calls) == "ab" + "ab" * 3
    assert times == {"a": [0, 2, 4], "b": [1, 3, 5]}
    assert timing.medians(times) == {"a": 2, "b": 3}
    with pytest.raises(ValueError, match="rounds is 0"):
        timing.interleave(functions, 0)


def test_table_aligns():
    text = timing.table(("what", "ns"), [("long name", 12.345), ("b", None), ("c", 20_000)])
    assert text.splitlines() == [
        "what           ns",
        "---------  ------",
        "long name    12.3",
        "b               -",
        "c          20 000",
    ]


def test_disc_worlds_are_those_of_the_simulation():
    scene = scenes.Thesis(bodies=20)
    model, state, _ = scene.build(3, 5).finalize(dtype="float64")
    worlds = cases.disc_worlds(scene, 3, 5)
    assert len(worlds) == 3
    for world, expected in zip(worlds, cases.disc_positions(model, state), strict=True):
        np.testing.assert_array_equal(world.positions, expected)
        assert world.positions.shape == (20, 2) and world.walls.shape == (3, 2, 2)
        assert not peers.overlaps(world.positions, world.radii, world.walls).any()
        # the walls touch a disc in each corner and no smaller box would hold them
        corner = scene.side - 0.499
        inner = np.array([[0.499, 0.499], [corner, 0.499]])
        assert len(peers.overlaps(inner, np.full(2, 0.5), world.walls)) == 4


def test_overlaps_by_hand():
    walls = np.array([[[0.0, 0.0], [10.0, 0.0]]])
    positions = np.array([[2.0, 0.75], [3.5, 1.0], [11.0, 0.0], [20.0, 0.0], [20.0, 2.0005], [20.0, 4.0025]])
    radii = np.array([1.0, 1.0, 1.5, 1.0, 1.0, 1.0])
    # two discs, two with a gap of half a millimetre (the next gap is too wide), the floor, the floor's end
    expected = [2.0 - np.hypot(1.5, 0.25), 0.0, 0.25, 0.0, 0.5]
    np.testing.assert_allclose(peers.overlaps(positions, radii, walls), expected, rtol=1e-12)
    assert peers.mean_overlap_mm(np.array([1e-3, 3e-3])) == pytest.approx(2.0)
    assert peers.mean_overlap_mm(np.empty(0)) == 0.0


@pytest.mark.parametrize("name", peers.PEERS)
def test_peers_let_a_disc_fall_and_rest(name):
    pytest.importorskip({"pymunk": "pymunk", "pybox2d": "Box2D"}[name.split("_")[0]])
    falling = peers.DiscWorld(np.array([[2.0, 1.5]]), np.array([0.5]), DISC_ON_FLOOR.walls)
    # free fall, up to the half step by which the engines' orders of integration differ
    np.testing.assert_allclose(peers.PEERS[name](falling, 10, 0.01)[0], [2.0, 1.5 - 0.5 * 9.8 * 0.1**2], atol=0.005)
    np.testing.assert_allclose(peers.PEERS[name](falling, 200, 0.01)[0], [2.0, 0.5], atol=0.02)


def test_sizes_are_named_once_each():
    assert sorted(cases.SWEEP_PILES) == [2_000, 20_000, 200_000]
    assert cases.SCALING_WORLDS == {100: 64, 1_000: 8, 10_000: 1, 100_000: 1}


def test_simulation_of_a_case_steps():
    sim = cases.simulation(scenes.Settled(bodies=30), worlds=2, config=dc.SolverConfig(max_sweeps=20), threads=1)
    sim.run(2, cases.DT)
    assert cases.dynamic_count(sim) == 60
    assert cases.contact_count(sim) > 60


def test_piles_side_by_side_stay_at_rest():
    pile = cases.simulation(scenes.Settled(bodies=40), config=dc.SolverConfig(max_sweeps=50))
    pile.run(20, cases.DT)
    wide = cases.side_by_side(pile, 3, specialize=False)
    positions = cases.disc_positions(wide.model, wide.state)[0]
    assert positions.shape == (120, 2)
    assert np.abs(wide.state.numpy("velocity")).max() < 0.5
    side = scenes.Thesis(bodies=40).side
    assert np.abs(positions[:, 0]).max() < 1.5 * side - 0.49  # inside the walls
    counts, _ = np.histogram(positions[:, 0], bins=side * np.array([-1.5, -0.5, 0.5, 1.5]))
    np.testing.assert_array_equal(counts, [40, 40, 40])


def test_results_keep_one_line_per_bench(tmp_path):
    path = tmp_path / "results" / "results.jsonl"
    run.store([{"bench": "sweep", "ns": 1}, {"bench": "worlds", "n": 2}], path)
    run.store([{"bench": "sweep", "ns": 3}], path)
    records = [json.loads(line) for line in path.read_text().splitlines()]
    assert records == [{"bench": "sweep", "ns": 3}, {"bench": "worlds", "n": 2}]


def test_figure_of_the_engines(tmp_path):
    pytest.importorskip("matplotlib")
    record = fake_worlds()
    speed, overlap = run.engine_values(record)
    assert speed == [record["worlds_per_s"], *(record[name] for name in peers.PEERS)]
    assert overlap == [record["overlap_mean_mm"], *(record[f"{name}_overlap_mm"] for name in peers.PEERS)]
    run.draw(record, tmp_path / "worlds.png")
    assert (tmp_path / "worlds.png").read_bytes().startswith(b"\x89PNG")


def test_skips_leave_the_others_alone(monkeypatch):
    monkeypatch.setattr(skips, "QUICK_DISCS", 5)
    monkeypatch.setattr(skips, "QUICK_ROUNDS", 1)
    monkeypatch.setattr(skips, "ROWS", {name: skips.ROWS[name] for name in ("friction", "restitution", "history")})
    values = skips.measure(quick=True)
    assert values["largest_difference_mm"] == 0.0 < values["least_ratio"]
    assert all(row.what in skips.report(values) for row in skips.ROWS.values())
