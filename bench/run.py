"""``python -m bench.run [NAME ...] [--quick]``: run benches one after the other and keep what they print.

Each bench runs in a process of its own; its JSON line replaces the earlier one of that bench in
``bench/results/results.jsonl``. The benches ``worlds`` and ``backends`` also give a figure of their name there.
After each bench ``docs/measured.md`` and the figures in ``README.md`` are written from that file; ``--pages`` writes
them and runs none.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bench.__main__ import NAMES
from bench.backends.figure import draw as draw_backends
from bench.pages import page

RESULTS = Path(__file__).resolve().parent / "results"
ENGINES = ("ours", "pymunk_10", "pymunk_50", "pybox2d_10", "pybox2d_50")
LABELS = {
    "ours": "deep-contact\nto 1e-4 N s",
    "pymunk_10": "pymunk\n10 iterations",
    "pymunk_50": "pymunk\n50 iterations",
    "pybox2d_10": "pybox2d\n10 iterations",
    "pybox2d_50": "pybox2d\n50 iterations",
}


def run_bench(name: str, quick: bool) -> dict[str, Any]:
    """Run one bench in a process of its own, pass its table on and return its JSON line.

    Raises:
        RuntimeError: when it fails.
    """
    command = [sys.executable, "-m", "bench", name, "--json", *(["--quick"] if quick else [])]
    done = subprocess.run(command, cwd=RESULTS.parent.parent, stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"bench {name} ended with {done.returncode}")
    *people, last = done.stdout.rstrip("\n").split("\n")
    print(f"\n== {name}", *people, sep="\n", flush=True)
    return json.loads(last)


def store(records: Sequence[dict[str, Any]], path: Path) -> None:
    """Write one line per bench; a new record replaces the earlier one of the same bench."""
    kept = {}
    if path.exists():
        kept = {record["bench"]: record for record in map(json.loads, path.read_text(encoding="utf-8").splitlines())}
    kept.update({record["bench"]: record for record in records})
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("".join(json.dumps(kept[name]) + "\n" for name in sorted(kept)), encoding="utf-8")


def engine_values(record: dict[str, Any]) -> tuple[list[float], list[float]]:
    """Return worlds per second and mean overlaps [mm] in the order of ``ENGINES``."""
    speed = [record["worlds_per_s" if name == "ours" else name] for name in ENGINES]
    overlap = [record["overlap_mean_mm" if name == "ours" else f"{name}_overlap_mm"] for name in ENGINES]
    return speed, overlap


def draw(record: dict[str, Any], path: Path) -> None:
    """Draw the bench ``worlds``: thesis worlds per second, and how far the settled discs overlap."""
    from pipeline.plots import style

    speed, overlap = engine_values(record)
    colors = [style.VERMILION if name == "ours" else style.EDGE for name in ENGINES]
    titles = (
        "thesis worlds per second, one thread\n(more is better)",
        "mean overlap after the run [mm]\n(less is better)",
    )
    with style.figure(9.6, 3.4) as figure:
        axes = figure.subplots(1, 2, sharey=True)
        for axis, values, title in zip(axes, (speed, overlap), titles, strict=True):
            bars = axis.barh(range(len(ENGINES)), values, color=colors, height=0.68)
            axis.bar_label(bars, [f"{value:.3g}" for value in values], padding=4, fontsize=9)
            axis.set_title(title, fontsize=10)
            axis.set_xlim(0, 1.15 * max(values))
            axis.grid(False)
            axis.spines[["top", "right", "bottom"]].set_visible(False)
            axis.tick_params(left=False, bottom=False, labelbottom=False)
        axes[0].set_yticks(range(len(ENGINES)), [LABELS[name] for name in ENGINES], fontsize=9)
        axes[0].invert_yaxis()
        figure.supxlabel(
            f"100 discs fall into a box, 250 steps of 0.01 s; creation included. {record['machine']['cpu']}",
            fontsize=8,
            color=style.MUTED,
        )
        style.save_figure(figure, path, dpi=160)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the named benches, all without a name; store their lines, draw the figure, write the pages."""
    parser = argparse.ArgumentParser(prog="python -m bench.run", description="Run benches and store their results.")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"which ones, of {', '.join(NAMES)}; none: all")
    parser.add_argument("--quick", action="store_true", help="the quick form of each")
    parser.add_argument(
        "--pages", action="store_true", help="run none: write the pages from the results that are there"
    )
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder of the results; pages are of the default one")
    options = parser.parse_args(arguments)
    unknown = [name for name in options.names if name not in NAMES]
    if unknown:
        print(f"there is no bench {', '.join(map(repr, unknown))}; there are: {', '.join(NAMES)}", file=sys.stderr)
        return 2
    if options.pages:
        if options.names:
            print("--pages takes no NAME: it writes what all results say", file=sys.stderr)
            return 2
        print(*page.write(), sep="\n")
        return 0
    for name in options.names or NAMES:
        record = run_bench(name, options.quick)
        store([record], options.out / "results.jsonl")
        if name == "worlds":
            draw(record, options.out / "worlds.png")
        elif name == "backends":
            draw_backends(record, options.out / "backends.png")
        if options.out == RESULTS:
            page.write()
    return 0


if __name__ == "__main__":
    sys.exit(main())
