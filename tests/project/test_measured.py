"""The measured page, and the README's figures, are what the committed results say."""

from __future__ import annotations

import json
import re

import pytest

from bench import run
from bench.pages import page, solving
from bench.pages.markdown import figure, paragraphs, span, table
from bench.speed.overhead import SIZES


@pytest.fixture(scope="module")
def records():
    return page.read()


def test_the_page_is_that_of_the_results(records):
    assert page.MEASURED.read_text(encoding="utf-8") == page.measured(records)


def test_the_readme_quotes_the_results(records):
    text = page.README.read_text(encoding="utf-8")
    assert text == page.with_headlines(text, records)
    rows = re.findall(r"^\| .* \|$", page.headlines(records), re.MULTILINE)
    assert len(rows) == 2 + 5


def test_the_readme_has_no_figure_of_a_bench_elsewhere():
    """Outside its marks the README quotes no time, speed or ratio."""
    before, _, rest = page.README.read_text(encoding="utf-8").partition(page.BEGIN)
    prose = re.sub(r"```.*?```", "", before + rest.partition(page.END)[2], flags=re.DOTALL)
    assert not re.findall(r"\d[\d.]* ?(?:ns|us|ms|times|x|worlds/s|%)\b", prose)


def test_every_record_has_its_section(records):
    text = page.measured(records)
    for name in records:
        assert f"`python -m bench {name}" in text
    machine = records["worlds"]["machine"]
    assert machine["cpu"] in text and machine["packages"]["numpy"] in text
    assert max(map(len, (line for line in text.splitlines() if line[:1] not in "|!"))) <= 120


def test_figures_of_a_section_are_those_of_its_record(records):
    changed = json.loads(json.dumps(records["worlds"]))
    changed["worlds_per_s"], changed["pymunk_10"], changed["pymunk_10_overlap_mm"] = 120.0, 60.0, 7.25
    changed["overlap_mean_mm"] = 0.0025
    text = page.section(changed)
    assert "| **deep-contact**, to 1e-4 N s | 120 | 1 |" in text
    assert "| pymunk, 10 iterations | 60 | 2 | 7.25 |" in text
    figures = page.headlines({**records, "worlds": changed})
    assert "| 120; 0.0025 mm | pymunk, 10 iterations 60; 7.25 mm | 2 times its speed, " in figures


def test_failures_are_told(records):
    broken = {**records["accuracy"], "failed": 1, "failures": ["billiard"]}
    assert "1 failed: billiard" in page.section(broken)
    assert "none failed" in page.section(records["accuracy"])


def test_a_bench_without_a_section_shows_its_keys(records):
    record = {"bench": "house", "quick": True, "machine": records["worlds"]["machine"]}
    from bench import house

    text = page.section(record | {key: 7_000 + i for i, key in enumerate(house.KEYS)})
    assert "`python -m bench house --quick`" in text and "| `longest_module` | 7 005 |" in text


def test_scenes_of_games_are_shown(records):
    values = {"ms": 0.5, "overlap_mean_mm": 0.25, "overlap_max_mm": 1.0, "over_peer": 0.75, "shares": {"predict": 1.0}}
    engines = {"default": values, "peer": {"ms": 2.0, "overlap_mean_mm": 4.0, "overlap_max_mm": 8.0, "shares": {}}}
    engines["peer"]["drift_mm"] = 2e4
    record = {
        "scenes": {"tumbler_2000": {**values, "engines": engines}},
        "configs": ["default"],
        "engines": {"default": "deep-contact, default", "peer": "Box2D 3, 4 substeps"},
    }
    text = page.section({"bench": "games", "quick": True, "machine": records["worlds"]["machine"], **record})
    assert "of deep-contact, default; Box2D 3, 4 substeps." in text.replace("\n", " ")
    assert "| scene | default [ms] | Box2D 3 [ms] | default over Box2D 3 |" in text
    assert "Bodies fell off the floor, as their drift below tells, in: 2 000 boxes in a drum in Box2D 3 (20 m)." in text
    assert "| 2 000 boxes in a drum | 0.5 | 2 | 0.75 |" in text
    assert "| 2 000 boxes in a drum: mean overlap [mm] | 0.25 | 4 |" in text and "creep [mm/s] |" not in text
    assert "| 2 000 boxes in a drum | `predict` 100% |" in text


def test_overheads_are_shown(records):
    times = {f"{name}_us_1_body": 2.5 for name in ("step", "run", "graph", "pymunk")}
    times |= {f"threads{threads}_us_{worlds * discs}": float(threads) for threads in (1, 2) for worlds, discs in SIZES}
    record = {"step_over_graph_us": -1.5, "run_over_graph_us": 0.25, "threads2_penalty_us": 1.0, **times}
    text = page.section({"bench": "overhead", "quick": False, "machine": records["worlds"]["machine"], **record})
    assert "| `step()` | 2.5 | -1.5 |" in text and "| `run()`, a step | 2.5 | 0.25 |" in text
    assert text.count("| 1 | 2 |") == len(SIZES)


def test_two_machines_are_named(records):
    other = json.loads(json.dumps(records["sweep"]))
    other["machine"]["cpu"] = "Another"
    text = page.machines({"worlds": records["worlds"], "sweep": other})
    assert "- `sweep`: Another" in text and "- `worlds`: " in text
    assert page.machines({"worlds": records["worlds"]}).startswith("All figures are from one machine")


def test_closest_check():
    rows = [{"value": value, "limit": limit} for value, limit in ((1.0, 2.0), (3.0, 4.0), (None, 1.0), (0.0, 0.0))]
    assert solving.closest(rows)["value"] == 3.0


def test_markdown():
    assert figure(0.000218) == "0.00022" and figure(1234.5) == "1 234" and figure(None) == "-"
    assert table(("a", "b"), [("x", 1.5)]) == "| a | b |\n| --- | --- |\n| x | 1.5 |"
    assert span([1.04, 71.2, 3.0]) == "1 to 71.2" and span([2.0]) == "2"
    assert paragraphs("a " * 100, "", "| t |").count("\n\n") == 1


def test_pages_are_written(tmp_path, records):
    results, readme = tmp_path / "results.jsonl", tmp_path / "README.md"
    results.write_text("".join(json.dumps(record) + "\n" for record in records.values()))
    readme.write_text(f"# x\n\n{page.BEGIN}\nold\n{page.END}\n")
    page.write(results, tmp_path / "docs" / "measured.md", readme)
    assert (tmp_path / "docs" / "measured.md").read_text() == page.measured(records)
    assert "old" not in readme.read_text() and page.headlines(records) in readme.read_text()
    with pytest.raises(ValueError, match=r"README\.md must hold the marks"):
        page.with_headlines("# no marks", records)


def test_pages_take_no_name(capsys):
    assert run.main(["worlds", "--pages"]) == 2
    assert "--pages takes no NAME" in capsys.readouterr().err
