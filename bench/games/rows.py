"""The scenes of the bench ``games``, and how the bodies of each come to where the engines get them."""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import dc_kernels as dc
from bench import cases, timing
from bench.games.engines import Handed
from pipeline import scenes

SETTLE = 300
"""Further steps of what is to be at rest, at the default settings, from no impulses, as the engines begin."""
STATE = ("position", "angle", "velocity", "angular_velocity")
FOLDER = Path(tempfile.gettempdir()) / "deep-contact-games"
"""Where bodies at rest are kept, as letting them fall takes longer than all that is timed."""


@dataclass(frozen=True)
class Row:
    """A scene, the steps that each engine takes in it, and what is told of them."""

    title: str
    scene: scenes.Scene
    worlds: int = 1
    fall: int = 0
    """Steps of at most ``cases.SWEEPS`` sweeps that ours takes before the bodies are handed over; ``SETTLE`` more
    follow where they are to be at rest."""
    copies: int = 1
    """How many of the piles stand side by side in the world."""
    rest: int = 100
    """Steps that each engine takes by itself before the first timed one."""
    steps: int = 20
    """Timed steps of a round."""
    anew: bool = False
    """Each round begins from where the bodies were handed over."""
    created: bool = False
    """Making the worlds belongs to the time of a round."""
    still: bool = True
    """Nothing should move, so that creep and drift say how well it holds."""
    stepwise: bool = False
    """Ours by ``step`` instead of ``run``."""
    asleep: bool = False
    """Ours and the peer that a program drives let bodies sleep, which all of these do."""
    large: bool = False
    """Left out of the quick form unless it is named."""
    peer_worlds: int | None = None
    """Worlds that pymunk and pybox2d take, the first ones; None: all."""


ROWS: Mapping[str, Row] = {
    "thesis_64": Row(
        "64 thesis worlds from placement to rest",
        scenes.Thesis(), worlds=64, rest=0, steps=250, anew=True, created=True, still=False, peer_worlds=4,
    ),
    "settled_discs_1000": Row("1 000 discs at rest", scenes.Thesis(bodies=1_000), fall=2_000, steps=50),
    "settled_discs_10000": Row(
        "10 000 discs at rest", scenes.Thesis(bodies=10_000), fall=800, steps=20, large=True
    ),
    "settled_discs_100000": Row(
        "100 000 discs at rest", scenes.Thesis(bodies=10_000), fall=800, copies=10, steps=5, large=True
    ),
    "impact_discs_1000": Row(
        "1 000 discs fall onto each other",
        scenes.Thesis(bodies=1_000), fall=200, rest=2, steps=50, anew=True, still=False,
    ),
    "impact_discs_10000": Row(
        "10 000 discs fall onto each other",
        scenes.Thesis(bodies=10_000), fall=350, rest=2, steps=25, anew=True, still=False, large=True,
    ),
    "settled_mixed_1000": Row("1 000 bodies of all shapes at rest", scenes.Mixed(bodies=1_000), fall=900, steps=50),
    "settled_mixed_10000": Row(
        "10 000 bodies of all shapes at rest", scenes.Mixed(bodies=10_000), fall=1_000, steps=10, large=True
    ),
    "impact_mixed_1000": Row(
        "1 000 bodies of all shapes fall onto each other",
        scenes.Mixed(bodies=1_000), fall=200, rest=2, steps=50, anew=True, still=False,
    ),
    "pyramid_1275": Row("pyramid of 1 275 boxes", scenes.Pyramid(rows=50), steps=20),
    "pyramid_5050": Row("pyramid of 5 050 boxes", scenes.Pyramid(rows=100), steps=10, large=True),
    "tumbler_2000": Row("2 000 boxes in a drum", scenes.Tumbler(bodies=2_000), fall=300, rest=20, still=False),
    "boxes_64_worlds": Row("64 worlds of 10 boxes", scenes.Stack(), worlds=64, steps=100),
    "boxes_1024_worlds": Row("1 024 worlds of 10 boxes", scenes.Stack(), worlds=1024, steps=20, peer_worlds=64),
    "joint_grid_10000": Row(
        "a net of 10 000 discs on hinges", scenes.JointGrid(bodies=10_000), rest=100, steps=10, still=False, large=True
    ),
    "joint_grid_900": Row(
        "a net of 900 discs on hinges", scenes.JointGrid(bodies=900), rest=100, steps=20, still=False
    ),
    "ragdolls_100": Row(
        "100 ragdolls of 11 bodies", scenes.Ragdolls(bodies=1_100, abreast=20), fall=600, rest=100, steps=20
    ),
    "falling_ragdolls_100": Row(
        "100 ragdolls fall onto each other",
        scenes.Ragdolls(bodies=1_100, abreast=20), rest=100, steps=50, anew=True, still=False,
    ),
    "bridge": Row(
        "5 discs fall on a bridge of 30 planks", scenes.Bridge(), rest=50, steps=100, anew=True, still=False
    ),
    "cars": Row("three cars on hills", scenes.Cars(), rest=100, steps=200, anew=True, still=False),
    "one_disc_run": Row("one disc, `run`", scenes.Thesis(bodies=1), rest=200, steps=2_000),
    "one_disc_step": Row("one disc, `step`", scenes.Thesis(bodies=1), rest=200, steps=2_000, stepwise=True),
    "ten_boxes_run": Row("10 boxes, `run`", scenes.Stack(), rest=200, steps=1_000),
    "ten_boxes_step": Row("10 boxes, `step`", scenes.Stack(), rest=200, steps=1_000, stepwise=True),
    "asleep_10000": Row(
        "10 000 discs asleep, 100 in each world",
        scenes.Thesis(), worlds=100, fall=300, rest=1_000, steps=200, asleep=True, large=True,
    ),
}  # fmt: skip


def hand_over(row: Row) -> Handed:
    """Return the bodies of a row where the engines get them: as the scene places them, or after their fall."""
    builder = row.scene.build(row.worlds)
    bodies = fallen(row) if row.fall else {}
    if row.copies > 1:
        model, state, _ = builder.finalize()
        state.assign("position", bodies["position"])
        builder, bodies = cases.wide_pile(cases.disc_positions(model, state)[0], row.copies), {}
    return Handed(builder, bodies, row.scene if row.created else None)


def fallen(row: Row) -> dict[str, np.ndarray]:
    """Fields of the state by name after the steps of ``fall``, from ``FOLDER`` if they were taken there before."""
    what = f"{row.scene!r} {row.worlds} {row.fall} {SETTLE * row.still} {cases.DT} {cases.SWEEPS}"
    path = FOLDER / f"{hashlib.sha256(what.encode()).hexdigest()[:16]}.npz"
    if path.exists():
        with np.load(path) as found:
            return {name: found[name] for name in STATE}
    timing.progress(f"{row.title}: {row.fall} steps before the bodies are handed over")
    sim = cases.simulation(row.scene, row.worlds, config=dc.SolverConfig(max_sweeps=cases.SWEEPS))
    sim.run(row.fall, cases.DT)
    if row.still:
        sim.reset(state=sim.state.copy())
        sim.config = dc.SolverConfig()
        sim.run(SETTLE, cases.DT)
    values = {name: sim.state.numpy(name).copy() for name in STATE}
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".npz", delete=False) as file:
        np.savez(file, **values)  # type: ignore[arg-type]
    Path(file.name).replace(path)
    return values
