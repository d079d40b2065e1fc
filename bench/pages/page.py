"""The page ``docs/measured.md`` and the README's figures, from the records that the benches left."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path

from bench.__main__ import NAMES, load
from bench.pages import backends, games, learning, solving, speed, transfer
from bench.pages.markdown import Record, figure, paragraphs, table

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "bench" / "results" / "results.jsonl"
MEASURED = ROOT / "docs" / "measured.md"
README = ROOT / "README.md"
BEGIN, END = "<!-- figures: python -m bench.run --pages -->", "<!-- end of figures -->"

# bench: title of its section, what makes it
SECTIONS = {
    "worlds": ("Thesis worlds", speed.worlds),
    "games": ("Scenes of games", games.games),
    "skips": ("What a scene does without", speed.skips),
    "sleep": ("Sleep", speed.sleep),
    "population": ("Scenes that change as they run", speed.population),
    "sweep": ("One sweep", speed.sweep),
    "scaling": ("Everything but the solve", speed.scaling),
    "threads": ("Threads within a world", speed.threads),
    "protocol": ("The thesis protocol", learning.protocol),
    "error_time": ("Run time against error", solving.error_time),
    "fc2d": ("Problems of others", solving.fc2d),
    "accuracy": ("Closed forms", solving.accuracy),
    "stability": ("Stability", solving.stability),
    "faults": ("Faults looked for", solving.faults),
    "learning": ("Learned starts and corrections", learning.learning),
    "stepper": ("A network in the solver's place", learning.stepper),
    "generate": ("Data sets", speed.generate),
    "train": ("Training", speed.train),
    "transfer": ("Particles to grid and back", transfer.transfer),
    "roundtrip": ("The theses' round trip", transfer.roundtrip),
    "neighbors": ("Neighbour search", speed.neighbors),
    "startup": ("Start of a process", speed.startup),
    "overhead": ("A step beside its kernels", speed.overhead),
    "backends": ("Backends", backends.backends),
}


def read(path: Path = RESULTS) -> dict[str, Record]:
    """Read the records of a results file, by bench."""
    return {record["bench"]: record for record in map(json.loads, path.read_text(encoding="utf-8").splitlines())}


def section(record: Record) -> str:
    """Write the section of a bench: title, command, body; without a writer of its own it holds the promised keys."""
    name = record["bench"]
    bench = load(name)
    title, write = SECTIONS.get(name, (f"{name[0].upper()}{name[1:]}", None))
    command = f"`python -m bench {name}{' --quick' if record['quick'] else ''}`"
    if write is None:
        rows = [(f"`{key}`", record[key]) for key in bench.KEYS if not isinstance(record[key], dict | list)]
        body = paragraphs(f"{bench.SUMMARY}.", table(("key", "value"), rows))
    else:
        body = write(record)
    return paragraphs(f"## {title}", command, body)


def machines(records: Mapping[str, Record]) -> str:
    """Name the machine or machines that the records were taken on, and which benches on which."""
    found: dict[str, list[str]] = {}
    for name, record in records.items():
        facts = record["machine"]
        packages = ", ".join(f"{package} {number}" for package, number in facts["packages"].items())
        line = f"{facts['cpu']}, {facts['cores']} cores, {facts['system']}; Python {facts['python']}, {packages}"
        found.setdefault(line, []).append(name)
    if len(found) == 1:
        return f"All figures are from one machine: {next(iter(found))}."
    lines = (f"- {', '.join(f'`{name}`' for name in names)}: {line}." for line, names in found.items())
    return "\n".join(
        textwrap.fill(line, 120, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False)
        for line in lines
    )


def measured(records: Mapping[str, Record]) -> str:
    """Write the page with a section for each bench that has a record."""
    order = [*SECTIONS, *(name for name in NAMES if name not in SECTIONS)]
    kept = {name: records[name] for name in order if name in records}
    return (
        paragraphs(
            "# Measured",
            "`python -m bench.run` runs the benches and writes this page from what they printed "
            "([bench/results/results.jsonl](../bench/results/results.jsonl)); `python -m bench.run --pages` writes "
            "it again without running any. Times are medians of interleaved runs; "
            "[bench/README.md](../bench/README.md) says how each is taken.",
            machines(kept),
            *[section(record) for record in kept.values()],  # not by map, which any StopIteration would end
        )
        + "\n"
    )


def headlines(records: Mapping[str, Record]) -> str:
    """Write the README's five figures beside those of others, and the time to a first step."""
    worlds, transfers, near = records["worlds"], records["transfer"], records["neighbors"]
    solved = records["fc2d"]["solved"]["1e8"]
    first_order = max(count for name, count in solved.items() if name not in ("newton", "auto"))
    files, states = len({row["file"] for row in records["fc2d"]["rows"]}), records["fc2d"]["states"]

    def times(theirs: float, ours: float) -> str:
        return figure(theirs / ours)

    rows = [
        (
            "worlds of 100 discs per second, each step to 1e-4 N s; mean overlap left",
            f"{figure(worlds['worlds_per_s'])}; {figure(worlds['overlap_mean_mm'])} mm",
            f"pymunk, 10 iterations {figure(worlds['pymunk_10'])}; {figure(worlds['pymunk_10_overlap_mm'])} mm",
            f"{times(worlds['worlds_per_s'], worlds['pymunk_10'])} times its speed, "
            f"1 / {figure(round(worlds['pymunk_10_overlap_mm'] / worlds['overlap_mean_mm'], -3))} of its overlap",
        ),
        (
            "splat of 1e5 particles in random order, each",
            f"{figure(transfers['splat_100000_ns'])} ns",
            f"torch `index_add_` {figure(transfers['index_add_100000_ns'])} ns",
            f"{figure(transfers['over_index_add'])} times faster",
        ),
        (
            "pairs of 1e5 points with 6 neighbours, each",
            f"{figure(near['hash_ns 2D 100000'])} ns",
            f"SciPy's k-d tree {figure(near['ckdtree_ns 2D 100000'])} ns",
            f"{times(near['ckdtree_ns 2D 100000'], near['hash_ns 2D 100000'])} times faster",
        ),
        (
            f"contact problems ({files} of others, {states} of our scenes) solved to 1e-8",
            figure(solved["auto"]),
            f"best first-order method {first_order}",
            f"{times(solved['auto'], first_order)} times as many",
        ),
    ]
    if scene := records["error_time"]["scenes"].get("thesis_1000"):  # not in the quick form
        pile = scene["runs"]["penetration"][solving.PENETRATION]
        ours, *others = (1e3 * pile["default"], *(1e3 * pile[name]["seconds"] for name in ("pymunk", "pybox2d")))
        row = (
            "1 000 discs at rest, overlap below 1 mm, per simulated second",
            f"{figure(ours)} ms",
            f"pymunk {figure(others[0])}, pybox2d {figure(others[1])} ms",
            f"{times(others[0], ours)} and {times(others[1], ours)} times faster",
        )
        rows.insert(1, row)
    cold, warm = records["startup"]["cold_s"], records["startup"]["warm_s"]
    return paragraphs(
        table(("one thread", "deep-contact", "other", "ratio"), rows),
        f"From the start of a process to the end of its first step it takes {figure(cold)} s with an empty kernel "
        f"cache, {figure(warm)} s afterwards.",
    )


def with_headlines(text: str, records: Mapping[str, Record]) -> str:
    """Return the README with its figures written anew between their marks.

    Raises:
        ValueError: where the marks are missing.
    """
    before, found, rest = text.partition(BEGIN)
    _, ended, after = rest.partition(END)
    if not (found and ended):
        raise ValueError(f"README.md must hold the marks {BEGIN!r} and {END!r}")
    return f"{before}{BEGIN}\n\n{headlines(records)}\n\n{END}{after}"


def write(results: Path = RESULTS, page: Path = MEASURED, readme: Path = README) -> Sequence[Path]:
    """Write the page and the README's figures from a results file; return the paths of both."""
    records = read(results)
    text = with_headlines(readme.read_text(encoding="utf-8"), records)
    page.parent.mkdir(parents=True, exist_ok=True)
    page.write_text(measured(records), encoding="utf-8")
    readme.write_text(text, encoding="utf-8")
    return page, readme
