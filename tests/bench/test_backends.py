"""The bench of the backends: what its engines answer, its keys and tables from invented figures."""

from __future__ import annotations

import dataclasses
import io
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dc_kernels as dc
from bench import cases
from bench.backends import backends, figure, jobs, worker
from bench.pages import page
from dc_kernels.stages import STEP
from pipeline import scenes


def told(seconds: float, **more: Any) -> dict[str, Any]:
    """What an engine measured of a step of 64 worlds."""
    return {"rounds": [{"step, 64 worlds": seconds}] * 3, "first_s": 1.0, "memory_mb": 200.0, "equal": True, **more}


def invented() -> list[backends.Row]:
    """Rows of a case with one thread and with two; Quadrants fails with two."""
    one = {"warp": told(1e-3), "taichi": told(2e-3, difference=1e-6), "quadrants": told(3e-3, equal=False)}
    two = {"warp": told(1e-3), "taichi": told(1e-3), "quadrants": {"error": "no room"}}
    rows = []
    for threads, found in ((1, one), (2, two)):
        case = jobs.Case("step", "64 worlds", threads)
        rows += backends.rows_of(case, ["step, 64 worlds"], found)
    return rows


def test_keys_are_of_the_rows():
    values = backends.summary(invented())
    assert values["step_64_worlds_over_warp"] == 2.0 and values["step_64_worlds_over_warp_2_threads"] == 1.0
    assert values["quadrants_step_64_worlds_over_warp"] == 3.0
    assert values["quadrants_step_64_worlds_over_warp_2_threads"] is None
    assert values["threads_ratio"] == 2.0 and values["quadrants_threads_ratio"] is None
    assert values["rows_filled"] == 5 / 6 and values["bits_equal"] == 1.0 and values["quadrants_bits_equal"] == 0.0
    assert set(backends.KEYS) - set(values) == set(backends.STARTS)


def test_tables_and_figure_tell_of_empty_cells(tmp_path):
    rows = invented()
    values = {**backends.summary(rows), "cold_s": None, "warm_s": 2.5, "rows": rows, "compilers": {"taichi": "1.0"}}
    text = backends.report(values)
    assert "step, 64 worlds, quadrants: no room" in text and "1 000" in text and "differ" in text
    record = {"bench": "backends", "quick": True, "machine": {"cpu": "none"}, **values}
    section = page.section(json.loads(json.dumps(record)))
    assert "| step, 64 worlds, 2 threads | us | 1 000 | 1 000 | - |" in section
    assert "Cells that failed: step, 64 worlds, 2 threads, Quadrants: no room." in section
    pytest.importorskip("matplotlib")
    figure.draw(record, tmp_path / "backends.png")
    assert (tmp_path / "backends.png").read_bytes().startswith(b"\x89PNG")


def test_every_key_is_of_a_case_of_the_quick_form():
    quick = [case for case in jobs.CASES if case.quick]
    named = {(f"step, {case.what}", case.threads) for case in quick if case.kind == "step"}
    named |= {(f"sweep of a contact, {case.dtype}", 1) for case in quick if case.kind == "sweep"}
    named |= {(f"{case.kind}, {case.what} particles", 1) for case in quick if case.kind in ("splat", "gather")}
    named |= {(f"neighbors, {case.what} points", 1) for case in quick if case.kind == "neighbors"}
    assert set(backends.RATIOS.values()) <= named
    assert {case.what for case in jobs.CASES if case.kind == "step"} == set(jobs.SCENES)


@pytest.mark.parametrize("kind", ["splat", "gather", "neighbors"])
def test_engines_do_the_same_on_points(kind, tmp_path):
    case = jobs.Case(kind, "60", oracle=True)
    found = {engine: jobs.make(case, engine, tmp_path) for engine in ("warp", "numpy", "peer")}
    results = {engine: job.result() for engine, job in found.items()}
    if kind == "neighbors":
        pairs = {engine: sorted(map(tuple, values.reshape(-1, 2).tolist())) for engine, values in results.items()}
        assert pairs["warp"] == pairs["numpy"] == pairs["peer"] and len(pairs["warp"]) > 60
    else:
        for values in results.values():
            np.testing.assert_allclose(values, results["warp"], atol=1e-5)
    (row,) = found["warp"].once()
    assert row.startswith(f"{kind}, 60 ")


def test_bodies_start_from_one_snapshot_in_both_scalars(tmp_path):
    sim = cases.simulation(scenes.Settled(bodies=12), 2, config=dc.SolverConfig(max_sweeps=20))
    sim.run(5, cases.DT)
    narrow, wide = (jobs.snapshot(tmp_path, "small", dtype) for dtype in ("float32", "float64"))
    sim.save(narrow)
    backends.widen(narrow, wide)
    case = jobs.Case("step", "small", 2)
    exact = jobs.make(case, "warp", tmp_path, "float64").result()
    single = jobs.make(case, "warp", tmp_path).result()
    assert exact.dtype == np.float64 and single.dtype == np.float32
    assert 0.0 < np.abs(single - exact).max() < 1e-4
    whole = jobs.make(dataclasses.replace(case, kind="stages"), "warp", tmp_path)
    assert list(whole.once()) == [f"{stage.kernel}, small" for stage in STEP]
    jobs.make(dataclasses.replace(case, kind="step", threads=1), "warp", tmp_path).once()
    np.testing.assert_array_equal(jobs.bodies(jobs.loaded(case, "warp", tmp_path, "float32")), jobs.bodies(sim))


def test_stages_by_hand_leave_the_bits_of_a_step(tmp_path):
    sim = cases.simulation(scenes.Settled(bodies=12), 2, config=dc.SolverConfig(max_sweeps=20))
    sim.run(5, cases.DT)
    sim.save(jobs.snapshot(tmp_path, "small", "float32"))
    for threads in (1, 2):
        by_hand = jobs.make(jobs.Case("stages", "small", threads), "warp", tmp_path).result()
        steps = jobs.make(jobs.Case("step", "small", calls=1), "warp", tmp_path)
        steps.once()  # by hand comes after a step too
        assert steps.result().tobytes() == by_hand.tobytes()


def test_a_worker_answers_and_goes_on_after_an_error(tmp_path, monkeypatch, capfd):
    number = next(i for i, case in enumerate(jobs.CASES) if case.kind == "neighbors")
    orders = [{"do": "time"}, {"do": "prepare", "case": number}, {"do": "time"}]
    monkeypatch.setattr("sys.stdin", io.StringIO("".join(json.dumps(order) + "\n" for order in orders)))
    kept = os.dup(1)
    try:
        worker.main("warp", tmp_path)
    finally:
        os.dup2(kept, 1)
        os.close(kept)
    none, ready, timed = map(json.loads, capfd.readouterr().out.splitlines())
    assert none["error"].startswith("IndexError") and ready["first_s"] > 0.0 and ready["memory_mb"] > 10.0
    assert next(iter(timed["seconds"].values())) > 0.0
    assert (tmp_path / f"warp_{number}.npy").is_file()


def test_a_process_that_ends_leaves_cells_empty(tmp_path: Path):
    gone = worker.Worker("warp", tmp_path / "x")
    gone.close()
    gone.ask(do="time")
    assert gone.answer() == {"error": "the process ended with 0"}


def test_a_run_that_was_cut_short_goes_on(tmp_path, monkeypatch):
    made = []

    def measured(number: int, workers: dict[str, Any], rounds: int, folder: Path) -> list[backends.Row]:
        if len(made) == 3:
            raise KeyboardInterrupt
        made.append(number)
        return invented()[:1]

    monkeypatch.setenv(backends.KEPT, str(tmp_path / "kept"))
    monkeypatch.setattr(backends, "save_scenes", lambda folder, missing: None)
    monkeypatch.setattr(backends, "starts", lambda quick: {})
    monkeypatch.setattr(backends, "Worker", lambda engine, folder: io.BytesIO())
    monkeypatch.setattr(backends, "measure_case", measured)
    with pytest.raises(KeyboardInterrupt):
        backends.measure(True)
    first = made.copy()
    made.clear()
    with pytest.raises(KeyboardInterrupt):
        backends.measure(True)
    assert len(first) == len(made) == 3 and not set(first) & set(made)
    while len(made) == 3:
        made.clear()
        try:
            rows = backends.measure(True)["rows"]
        except KeyboardInterrupt:
            continue
    assert rows == invented()[:1] * sum(case.quick for case in jobs.CASES)
