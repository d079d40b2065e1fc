"""Section of the bench that sets scenes of games beside the engines of games."""

from __future__ import annotations

from collections.abc import Mapping

from bench.games.games import FOREIGN, HELD, PEERS
from bench.games.rows import ROWS
from bench.pages.markdown import Record, figure, paragraphs, table

UNITS = (
    *("mean overlap [mm]", "largest overlap [mm]", "creep [mm/s]", "drift [mm]"),
    *("joints apart in the mean [mm]", "joints apart at most [mm]"),
)
FALLEN = 1e4  # mm that a body of a scene at rest is from its start only where it fell off the floor


def games(record: Record) -> str:
    """Show of each scene the time of a step beside the others, what it holds, and where our time goes."""
    texts, found = record["engines"], record["scenes"]
    labels = {name: texts[name].partition(",")[0] if name == FOREIGN else name for name in texts}
    names = [name for name in (*record["configs"], FOREIGN, *PEERS) if name in texts]
    times, held, shares = [], [], []
    for scene, row in found.items():
        title, engines = ROWS[scene].title, row["engines"]
        ours = [engines.get(name, {}) for name in record["configs"]]
        others = [name for name in names if name not in record["configs"]]
        times.append(
            (
                title,
                *(engines.get(name, {}).get("ms") for name in names),
                *(of.get(f"over_{other}") for of in ours for other in others),
            )
        )
        for key, unit in zip(HELD, UNITS, strict=True):
            if any(key in engines.get(name, {}) for name in names):
                held.append((f"{title}: {unit}", *(engines.get(name, {}).get(key) for name in names)))
        parts = sorted(row.get("shares", {}).items(), key=lambda part: -part[1])[:4]
        if parts:
            shares.append((title, ", ".join(f"`{name}` {share:.0%}" for name, share in parts)))
    over = [
        f"{name} over {labels[other]}"
        for name in record["configs"]
        for other in names
        if other not in record["configs"]
    ]
    told = [labels[name] for name in names]
    return paragraphs(
        f"Milliseconds of a step of 0.01 s, one thread, of {'; '.join(texts[name] for name in names)}. "
        "All begin with the same bodies; a ratio below 1 says that ours is faster. It is the median of the "
        "ratios of each round: where the clock changes during a run, the quotient of two medians of milliseconds is "
        "another one.",
        f"{labels[FOREIGN]} is driven by a program that is not part of this project; "
        "[bench/README.md](../bench/README.md#a-peer-of-your-own) has its protocol."
        if FOREIGN in names
        else "",
        table(("scene", *(f"{name} [ms]" for name in told), *over), times),
        fallen(record, labels),
        "How the bodies then lie: overlaps at the end, of pairs that touch; creep, how far a body moves in a second in "
        "the mean; drift, the farthest that one has moved since the scene was handed over.",
        table(("what is left", *told), held),
        f"Where a step of `{record['configs'][0]}` goes:",
        table(("scene", "largest shares"), shares),
    )


def fallen(record: Record, labels: Mapping[str, str]) -> str:
    """Say in which scenes at rest bodies fell off the floor, whose times are then not those of bodies at rest."""
    where = [
        f"{ROWS[scene].title} in {labels[name]} ({figure(of['drift_mm'] / 1e3)} m)"
        for scene, row in record["scenes"].items()
        for name, of in row["engines"].items()
        if of.get("drift_mm", 0.0) > FALLEN
    ]
    if not where:
        return ""
    return (
        f"Bodies fell off the floor, as their drift below tells, in: {'; '.join(where)}. There stacks fell over, so "
        "the times are not those of bodies at rest."
    )
