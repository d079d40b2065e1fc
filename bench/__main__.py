"""``python -m bench NAME [ARGUMENT ...] [--quick] [--json]``: run one bench; without a name, list them."""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Sequence
from typing import Any, Protocol

from bench import timing

# name: its module in bench
MODULES = {
    "sweep": "speed.sweep",
    "worlds": "speed.worlds",
    "scaling": "speed.scaling",
    "threads": "speed.threads",
    "protocol": "learning.protocol",
    "transfer": "speed.transfer",
    "roundtrip": "learning.roundtrip",
    "neighbors": "speed.neighbors",
    "queries": "speed.queries",
    "generate": "speed.generate",
    "learning": "learning.learning",
    "stepper": "learning.stepper",
    "train": "speed.train",
    "startup": "speed.startup",
    "overhead": "speed.overhead",
    "backends": "backends.backends",
    "foreign": "speed.foreign",
    "accuracy": "accuracy.accuracy",
    "error_time": "error_time.error_time",
    "fc2d": "error_time.fc2d",
    "stability": "stability.stability",
    "presets": "stability.presets",
    "faults": "faults.faults",
    "games": "games.games",
    "sleep": "speed.sleep",
    "population": "speed.population",
    "skips": "speed.skips",
    "house": "house",
}
NAMES = tuple(MODULES)


class Bench(Protocol):
    """Interface of a bench's module."""

    SUMMARY: str  # one line
    KEYS: tuple[str, ...]  # values that are always there
    THREADS: int  # the most threads that it uses

    def measure(self, quick: bool) -> dict[str, Any]:
        """Measure and return the values by key."""

    def report(self, values: dict[str, Any]) -> str:
        """Return the table for people."""


def load(name: str) -> Bench:
    """Import the module of a bench; nothing heavy is imported before it measures."""
    return importlib.import_module(f"bench.{MODULES[name]}")  # type: ignore[return-value]


def listing() -> str:
    """Return the names of the benches with a line each."""
    width = max(map(len, NAMES))
    return "\n".join(f"{name.ljust(width)}  {load(name).SUMMARY}" for name in NAMES)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one bench and print its table, and its JSON line if asked for; return 0, or 2 for an unknown name."""
    parser = argparse.ArgumentParser(prog="python -m bench", description="Benches of deep-contact.")
    parser.add_argument("name", nargs="?", help="which bench; without it they are listed")
    parser.add_argument(
        "more", nargs="*", metavar="argument", help="what a bench takes beside: fc2d a folder, games scenes"
    )
    parser.add_argument("--config", metavar="NAME[,NAME]", help="settings of ours by name, for the bench games")
    parser.add_argument("--quick", action="store_true", help="fewer repeats and worlds: ends within 40 s")
    parser.add_argument("--json", action="store_true", help="print one JSON line last")
    options = parser.parse_intermixed_args(arguments)  # names may stand behind --quick
    if options.name is None:
        print(listing())
        return 0
    if options.name not in NAMES:
        print(f"there is no bench {options.name!r}; there are: {', '.join(NAMES)}", file=sys.stderr)
        return 2
    import warp as wp

    from dc_kernels.model.settings import UnknownName

    wp.config.log_level = wp.LOG_WARNING  # its lines on loading modules would stand between ours
    bench = load(options.name)
    takes = getattr(bench, "TAKES", "")
    if len(options.more) > len(takes.split()) and not takes.endswith("..."):
        wanted = f"{takes} and no more" if takes else "no argument"
        print(f"bench {options.name} takes {wanted}; there is {' '.join(options.more)!r}", file=sys.stderr)
        return 2
    given = {} if options.config is None else {"config": options.config}
    if given and not hasattr(bench, "CONFIGS"):
        print(f"bench {options.name} takes no --config", file=sys.stderr)
        return 2
    print(timing.machine_line(timing.machine(bench.THREADS)))
    try:
        values = bench.measure(options.quick, *options.more, **given)
    except UnknownName as error:
        if not options.more and not given:  # no word of the user's
            raise
        print(error, file=sys.stderr)
        return 2
    print(bench.report(values), flush=True)
    if options.json:
        print(timing.json_line(options.name, values, bench.KEYS, quick=options.quick, threads=bench.THREADS))
    return 0


if __name__ == "__main__":
    sys.exit(main())
