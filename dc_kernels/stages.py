"""The step as data: its stages in order, the kernel of each, what it reads and writes, and when it is skipped.

``Simulation`` runs the table, ``explain`` and the documentation print it, and the tests compare the backends by it and
check that every kernel takes the groups that its stage names.
"""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

from dc_kernels.runtime.backends import make_kernels
from dc_kernels.runtime.capture import recording

Phase = Literal["advance", "collide", "solve"]
PHASES: tuple[Phase, ...] = ("collide", "solve", "advance")
"""Parts of a step in order."""


class Stage(NamedTuple):
    """One stage of a step: a kernel over the worlds."""

    phase: Phase
    """Part of a step that it belongs to: ``Simulation`` has a method of that name."""
    kernel: str
    """Name of its kernel in every backend."""
    file: str
    """Where its kernels stand below a backend's root."""
    options: tuple[str, ...]
    """What its kernels are made for beside the scalar: "only_discs", "variant"."""
    reads: tuple[str, ...]
    """Groups of arrays that it reads."""
    writes: tuple[str, ...]
    """Groups that it writes."""
    does: str
    """What it does, for people."""
    skipped: str = ""
    """When it does nothing, or is not run at all."""


STEP = (
    Stage(
        "collide", "predict", "solve.integrate", (), ("model", "state", "motion"), ("motion", "state"),
        "velocities with forces and gravity applied; how far contacts look ahead", "a world whose flags are set",
    ),
    Stage(
        "collide", "update_pairs", "collide.broadphase", (), ("model", "state", "motion", "pairs"), ("pairs", "state"),
        "candidate pairs of shapes", "kept while no shape leaves its box",
    ),
    Stage(
        "collide", "narrowphase", "collide.narrowphase", ("only_discs",), ("model", "state", "motion", "pairs"),
        ("contacts", "rows", "state"), "contact points, normals, gaps", "hulls, where all that moves is centred discs",
    ),
    Stage(
        "collide", "match_contacts", "collide.match", (), ("model", "state", "motion", "cache"),
        ("contacts", "joints"), "start impulses, colours and ages of contacts known from the step before",
    ),
    Stage(
        "collide", "color_constraints", "collide.color", (), ("model", "state"), ("contacts", "joints", "rows"),
        "colours: no two constraints of one share a dynamic body", "a world without new contacts or joints",
    ),
    Stage(
        "collide", "pack_rows", "solve.pack", ("variant",), ("model", "state", "joints", "motion", "contacts"),
        ("rows", "stats", "state"), "rows of the solver in blocks, colour by colour",
    ),
    Stage(
        "solve", "solve_world", "solve.schedules", ("variant",),
        ("model", "state", "joints", "contacts"), ("motion", "rows", "stats"),
        "sweeps from the start impulses to the tolerance", "a world without rows",
    ),
    Stage(
        "solve", "unpack_impulses", "solve.pack", ("variant",), ("model", "state", "rows"), ("contacts", "joints"),
        "solved impulses back to contacts and joints",
    ),
    Stage(
        "advance", "displace", "solve.integrate", (), ("model", "state"), ("motion",),
        "what the solved velocities move the bodies by",
    ),
    Stage(
        "advance", "correct_positions", "solve.schedules", ("variant",), ("model", "state", "rows"), ("motion",),
        "displacements that undo overlap",
        "another position correction than ngs; a world without overlap beyond the slop and without joints",
    ),
    Stage(
        "advance", "commit", "solve.integrate", (), ("model", "joints", "motion"), ("state", "contacts", "cache"),
        "positions, velocities, time, and the contacts that the next step starts from",
    ),
)  # fmt: skip
"""The stages of a step in order. With schedule "color", ``solve_world`` is cut at the colours (``solve.schedules``)."""

ORDER: dict[str, tuple[tuple[Phase, ...], str]] = {
    "solve": (
        ("collide", "solve"),
        "solve() needs collide(dt) first: the contacts are those of a finished step",
    ),
    "resume": (("solve",), "resume() needs solve(pause=...) first: no solve is in flight"),
    "advance": (("solve",), "advance() needs solve() first: there are no solved velocities"),
}
"""The phases that a call may follow, and what is wrong after another one."""


class Turn:
    """Which phase of a step was called last; calls that become part of a graph have a turn of their own.

    Attributes:
        ran: the phase that ran last.
        recorded: the phase that became part of a graph last.
    """

    def __init__(self) -> None:
        """Begin between two steps."""
        self.ran: Phase = "advance"
        self.recorded: Phase = "advance"

    def check(self, call: str) -> None:
        """Raise ValueError for a call out of turn; a recorded one may follow a phase that was recorded or that ran."""
        follows, wrong = ORDER[call]
        if self.ran not in follows and not (recording() and self.recorded in follows):
            raise ValueError(wrong)


def of_phase(phase: Phase, position_correction: bool = True) -> list[str]:
    """Kernels of a phase in order; without the position phase where the settings want none."""
    names = [stage.kernel for stage in STEP if stage.phase == phase]
    return names if position_correction else [name for name in names if name != "correct_positions"]


def markdown() -> str:
    """The stages as a table for people."""
    rows = ["| phase | kernel | file | reads | writes | what it does | left out |", "| --- " * 7 + "|"]
    for stage in STEP:
        groups = [", ".join(f"`{name}`" for name in names) for names in (stage.reads, stage.writes)]
        place = f"`{stage.file.replace('.', '/')}.py`"
        cells = (stage.phase, f"`{stage.kernel}`", place, *groups, stage.does, stage.skipped)
        rows.append(f"| {' | '.join(cells)} |".replace("|  |", "| |"))
    return "\n".join(rows)


def kernel_table(backend: str, dtype: str, variant: str, only_discs: bool) -> dict[str, Any]:
    """All kernels of a simulation by name.

    Args:
        backend: "warp", or "numpy": the oracle, never fast.
        dtype: "float32" or "float64".
        variant: layout of solver rows, a key of ``rows.COLUMNS``.
        only_discs: whether all that moves are discs about their centre of mass.
    """
    options = {"variant": variant, "only_discs": only_discs}
    table: dict[str, Any] = {}
    for file, names in {stage.file: stage.options for stage in STEP}.items():
        table.update(make_kernels(backend, file, dtype, *(options[name] for name in names)))
    return table
