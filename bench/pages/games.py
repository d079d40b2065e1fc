"""Section of the bench that sets scenes of games beside the engines of games."""

from __future__ import annotations

from bench.games.games import FOREIGN, HELD, PEERS
from bench.games.rows import ROWS
from bench.pages.markdown import Record, paragraphs, table

UNITS = (
    *("mean overlap [mm]", "largest overlap [mm]", "creep [mm/s]", "drift [mm]"),
    *("joints apart in the mean [mm]", "joints apart at most [mm]"),
)


def games(record: Record) -> str:
    """Show of each scene the time of a step beside the others, what it holds, and where our time goes."""
    texts, found = record["engines"], record["scenes"]
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
    over = [f"{name} over {other}" for name in record["configs"] for other in names if other not in record["configs"]]
    return paragraphs(
        f"Milliseconds of a step of 0.01 s, one thread, of {'; '.join(texts[name] for name in names)}. "
        "All begin with the same bodies; a ratio below 1 says that ours is faster.",
        table(("scene", *(f"{name} [ms]" for name in names), *over), times),
        "How the bodies then lie: overlaps at the end, of pairs that touch; creep, how far a body moves in a second in "
        "the mean; drift, the farthest that one has moved since the scene was handed over.",
        table(("what is left", *names), held),
        f"Where a step of `{record['configs'][0]}` goes:",
        table(("scene", "largest shares"), shares),
    )
