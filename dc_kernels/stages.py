"""The step as data: its stages in order, the kernel of each, what it reads and writes, and when it is skipped.

``Simulation`` runs the table, ``explain`` and the documentation print it, and the tests compare the backends by it and
check that every kernel takes the groups that its stage names.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any, Literal, NamedTuple

from dc_kernels.model.enums import Activity
from dc_kernels.runtime.backends import has_kernels, kernel_factory, kernel_file, make_kernels
from dc_kernels.runtime.capture import recording
from dc_kernels.solve.rows import COLUMNS

Phase = Literal["advance", "collide", "solve"]
PHASES: tuple[Phase, ...] = ("collide", "solve", "advance")
"""Phases of a step in order."""


class Stage(NamedTuple):
    """One stage of a step: a kernel over the worlds."""

    phase: Phase
    """Phase of a step to which it belongs: ``Simulation`` has a method of that name."""
    kernel: str
    """Name of its kernel in every backend."""
    file: str
    """Module of its kernels below a backend's root."""
    options: tuple[str, ...]
    """Options of its kernels other than the scalar type: "only_discs", "rolls", "traits", "variant"."""
    reads: tuple[str, ...]
    """Groups of arrays that it reads."""
    writes: tuple[str, ...]
    """Groups that it writes."""
    does: str
    """Description of what it does."""
    skipped: str = ""
    """Condition under which it does nothing, or is not run."""


STEP = (
    Stage(
        "collide", "predict", "solve.integrate", ("traits",), ("model", "state", "motion"), ("motion", "state"),
        "applies forces and gravity to velocities; sets the reach of contacts", "a world whose flags are set",
    ),
    Stage(
        "collide", "update_pairs", "collide.broadphase", (), ("model", "state", "motion", "pairs"), ("pairs", "state"),
        "finds candidate pairs of shapes", "kept while no shape leaves its box",
    ),
    Stage(
        "collide", "narrowphase", "collide.narrowphase", ("only_discs",), ("model", "state", "motion", "pairs"),
        ("contacts", "rows", "state", "pairs"), "computes contact points, normals, gaps",
        "hulls, if all moving shapes are centred discs",
    ),
    Stage(
        "collide", "match_contacts", "collide.match", (), ("model", "state", "motion", "cache"),
        ("contacts", "joints", "state"), "takes impulses, colours and ages of contacts from the previous step",
    ),
    Stage(
        "collide", "color_constraints", "collide.color", (), ("model", "state"), ("contacts", "joints", "rows"),
        "colours constraints so that no two of a colour share a dynamic body", "a world without new contacts or joints",
    ),
    Stage(
        "collide", "pack_rows", "solve.pack", ("variant",), ("model", "state", "joints", "motion", "contacts"),
        ("rows", "stats", "state"), "packs the solver's rows in blocks, colour by colour",
    ),
    Stage(
        "solve", "solve_world", "solve.schedules", ("variant",),
        ("model", "state", "joints", "contacts"), ("motion", "rows", "stats"),
        "sweeps from the start impulses until the solve ends", "a world without rows",
    ),
    Stage(
        "solve", "unpack_impulses", "solve.pack", ("variant",), ("model", "state"), ("contacts", "joints", "rows"),
        "copies solved impulses to contacts and joints",
    ),
    Stage(
        "advance", "displace", "solve.integrate", ("traits",), ("model", "state"), ("motion",),
        "computes displacements from the solved velocities",
    ),
    Stage(
        "advance", "correct_positions", "solve.schedules", ("variant",), ("model", "state", "rows"), ("motion",),
        "corrects displacements to remove overlap",
        "another position correction than ngs; a world without overlap beyond the slop and without joints",
    ),
    Stage(
        "advance", "commit", "solve.integrate", ("traits",), ("model", "joints", "motion"),
        ("state", "contacts", "cache"),
        "writes positions, velocities, time, and the contacts from which the next step starts",
    ),
)  # fmt: skip
"""The stages of a step in order. With schedule "color", ``solve_world`` is cut at the colours (``solve.schedules``)."""

SLEEP = (
    Stage(
        "collide", "notice_writes", "sleep.wake", ("rolls",), ("model", "state", "joints", "contacts", "sleepers"),
        ("sleepers",), "rouses sleepers where a program wrote to them or to bodies that they touch",
        "except once in a call",
    ),
    Stage(
        "collide", "enter_worlds", "sleep.wake", ("rolls",), ("state", "sleepers"), ("state", "stats"),
        "lets the stages of a phase skip worlds in which nothing is awake",
    ),
    Stage(
        "collide", "mark_sleepers", "sleep.wake", ("rolls",),
        ("model", "state", "joints", "motion", "pairs", "contacts", "sleepers"), ("motion", "sleepers"),
        "wakes roused bodies; lets the narrowphase skip pairs of sleepers",
        "a world without sleepers",
    ),
    Stage(
        "collide", "wake_touched", "sleep.wake", ("rolls",),
        ("model", "state", "joints", "motion", "pairs", "contacts", "sleepers"), ("state", "motion", "sleepers"),
        "wakes sleepers that a moving body touches", "a world without sleepers",
    ),
    Stage(
        "collide", "admit_worlds", "sleep.wake", ("rolls",), ("state", "contacts", "rows", "sleepers"),
        ("state", "contacts", "rows", "sleepers"), "reserves slots for the contacts of sleepers",
        "a world without sleepers",
    ),
    Stage(
        "collide", "leave_worlds", "sleep.wake", ("rolls",), ("state",), ("state",), "ends a phase",
    ),
    Stage(
        "advance", "show_sleepers", "sleep.fall", ("rolls",), ("state", "motion", "contacts", "sleepers"),
        ("contacts", "sleepers"), "inserts the contacts of sleepers among those of the step",
        "a world without sleepers",
    ),
    Stage(
        "advance", "rest", "sleep.fall", ("rolls",), ("model", "state", "motion", "sleepers"), ("state", "sleepers"),
        "counts how long bodies have rested; advances the time of skipped worlds",
    ),
    Stage(
        "advance", "fall_asleep", "sleep.fall", ("rolls",), ("model", "state", "joints", "contacts", "sleepers"),
        ("state", "sleepers"), "puts islands that have come to rest to sleep", "where no island can have",
    ),
)  # fmt: skip
"""What ``SolverConfig.sleep`` adds to the stages, by the phase in which each is first (see ``of_phase``)."""

NEEDS = {
    "notice_writes": Activity(0),
    "enter_worlds": Activity.ASLEEP,
    "mark_sleepers": Activity.ASLEEP | Activity.AWAKE,
    "wake_touched": Activity.ASLEEP | Activity.AWAKE,
    "admit_worlds": Activity.ASLEEP | Activity.AWAKE,
    "leave_worlds": Activity.ASLEEP,
    "show_sleepers": Activity.ASLEEP | Activity.AWAKE,
    "rest": Activity(0),
    "fall_asleep": Activity.RESTED,
    "note_overlaps": Activity(0),
    "note_touches": Activity(0),
}
"""Activity without which a kernel of ``SLEEP`` does nothing and is not launched; all others need AWAKE."""

ORDER: dict[str, tuple[tuple[Phase, ...], str]] = {
    "solve": (
        ("collide", "solve"),
        "solve() needs collide(dt) first: the contacts are those of a finished step",
    ),
    "resume": (("solve",), "resume() needs solve(pause=...) first: no solve is in flight"),
    "advance": (("solve",), "advance() needs solve() first: there are no solved velocities"),
}
"""The phases that a call may follow, and the error after another phase."""


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


LINKED = (
    Stage(
        "collide", "separate_joined", "collide.joined", (), ("model", "state", "joints", "rows", "pairs"), ("pairs",),
        "removes pairs of bodies that a joint keeps from colliding", "a scene whose joints let all bodies collide",
    ),
    Stage(
        "collide", "make_joint_rows", "solve.joints", (), ("model", "state", "joints"), ("motion", "rows", "state"),
        "makes the rows of the joints", "a scene whose joints are all rods",
    ),
    Stage(
        "advance", "break_joints", "solve.joints", (), ("model", "state", "motion", "rows"), ("joints",),
        "breaks joints whose force exceeds their break force", "a scene whose joints never break",
    ),
)  # fmt: skip
"""What joints that are not all rods add to the stages (see ``of_phase``)."""
EVENTS = (
    Stage(
        "collide", "sense_overlaps", "events.overlaps", (), ("model", "state", "pairs"), ("overlaps", "pairs"),
        "removes pairs of sensors from the candidates; lists those that overlap", "a scene without sensors",
    ),
    Stage(
        "advance", "note_overlaps", "events.overlaps", (), ("state", "pairs"), ("overlaps",),
        "lists overlaps of sensors that have begun and ended", "a scene without sensors",
    ),
    Stage(
        "advance", "note_touches", "events.touches", (), ("model", "state", "contacts"), ("touches",),
        "lists pairs that touch, have begun or ceased to touch, or hit each other", "without `contact_events`",
    ),
)  # fmt: skip
"""What sensors and contact events add to the stages (see ``of_phase``)."""
SWITCHED = (
    Stage(
        "collide", "screen_contacts", "collide.switches", ("rolls",),
        ("model", "state", "motion", "rows", "contacts", "switches"), ("contacts", "rows", "switches"),
        "removes the contacts that one-way shapes let through",
        "without one-way shapes and `contact_switches`",
    ),
    Stage(
        "advance", "show_switched", "collide.switches", ("rolls",), ("state", "contacts", "switches"),
        ("contacts", "switches"), "inserts the inactive contacts among those of the step", "as `screen_contacts`",
    ),
)  # fmt: skip
"""What contacts that may be off add to the stages (see ``of_phase``)."""
FOLLOWED = (
    Stage(
        "collide", "drop_missed", "collide.continuous", (), ("model", "state", "motion", "contacts"), ("contacts",),
        "removes contacts of pairs that pass each other in the step", "without `continuous`",
    ),
    Stage(
        "advance", "stop_short", "collide.continuous", (),
        ("model", "state", "joints", "motion", "contacts", "pairs", "rows"), ("motion",),
        "stops bodies that would penetrate others deeply", "as `drop_missed`",
    ),
)  # fmt: skip
"""What continuous detection adds to the stages (see ``of_phase``)."""
ROLLED = (
    Stage(
        "collide", "match_rolling", "collide.rolling", (), ("state", "motion", "cache"), ("contacts",),
        "takes start impulses of rolling resistance", "a scene without rolling resistance",
    ),
    Stage(
        "advance", "keep_rolling", "collide.rolling", (), ("state", "contacts"), ("cache",),
        "keeps impulses of rolling resistance for the next step", "as `match_rolling`",
    ),
)  # fmt: skip
"""What rolling resistance adds to the stages (see ``of_phase``)."""
SOFT = (
    Stage(
        "solve", "solve_soft", "solve.soft", ("variant",), ("model", "state", "joints", "contacts"),
        ("motion", "rows", "stats"), "makes all substeps with soft contacts and joints, and their displacements",
    ),
)  # fmt: skip
"""What stands in the place of ``solve_world``, ``displace`` and ``correct_positions`` with method "tgs_soft"."""

ADDED = (*LINKED, *EVENTS, *SWITCHED, *FOLLOWED, *ROLLED)
"""What scenes and settings add to the stages."""
BEFORE = {
    "sense_overlaps": "narrowphase",
    "separate_joined": "narrowphase",
    "drop_missed": "match_contacts",
    "match_rolling": "color_constraints",
    "screen_contacts": "color_constraints",
    "make_joint_rows": "color_constraints",
    "show_switched": "commit",
    "stop_short": "commit",
    "break_joints": "commit",
    "note_overlaps": "commit",
    "note_touches": "commit",
}
"""Kernels of ``LINKED``, ``EVENTS``, ``SWITCHED``, ``FOLLOWED`` and ``ROLLED``, and those of a step that they precede;
``stop_short`` looks for contacts that are off, so that it comes once they are shown;
``keep_rolling`` alone follows one, ``commit``."""
NOTES = ("note_overlaps", "note_touches")
"""Kernels that look at the contacts of sleepers too, so that they run once these are shown."""
LACKING = {
    "collide.continuous": "continuous detection (SolverConfig.continuous)",
    "events.overlaps": "sensors",
    "events.touches": "contact events (SolverConfig.contact_events)",
    "collide.switches": "contacts that may be off (one-way shapes, one-sided chains, SolverConfig.contact_switches)",
}
"""What kernels of files that a backend may lack are for."""


def of_phase(
    phase: Phase,
    position_correction: bool = True,
    sleep: bool = False,
    added: Collection[str] = (),
    soft: bool = False,
) -> list[str]:
    """Kernels of a phase in order.

    Args:
        phase: of a step.
        position_correction: whether it has the position phase.
        sleep: whether bodies may sleep; then ``solve`` is the part between what these give for it first and last.
        added: kernels of ``ADDED`` that the scene needs.
        soft: whether the method is "tgs_soft".
    """
    names = [stage.kernel for stage in STEP if stage.phase == phase]
    for name, before in BEFORE.items():
        if name in added and before in names:
            names.insert(names.index(before), name)
    if not position_correction:
        names = [name for name in names if name != "correct_positions"]
    if soft:
        names = ["solve_soft" if name == "solve_world" else name for name in names if name != "displace"]
    noting = [name for name in names if name in NOTES]
    names = [name for name in names if name not in NOTES]
    last = [*names[-1:], *(["keep_rolling"] if phase == "advance" and "keep_rolling" in added else [])]
    if not sleep:
        return [*names[:-1], *noting, *last]
    if phase == "collide":
        found = names.index("narrowphase")
        begin = ["notice_writes", "enter_worlds", *names[:found], "mark_sleepers", "narrowphase", "wake_touched"]
        return [*begin, "narrowphase", "admit_worlds", *names[found + 1 :], "leave_worlds"]
    if phase == "solve":
        return ["enter_worlds", *names, "leave_worlds"]
    return ["enter_worlds", *names[:-1], "show_sleepers", *noting, *last, "rest", "fall_asleep"]


def needs_of(names: Sequence[str]) -> list[Activity]:
    """Without what each kernel of a phase, as ``of_phase`` gives them with ``sleep``, has nothing to do."""
    needs = [NEEDS.get(name, Activity.AWAKE) for name in names]
    if "wake_touched" in names:  # the narrowphase is repeated for worlds in which a sleeper was touched
        needs[names.index("wake_touched") + 1] |= Activity.ASLEEP
    return needs


WORDS = {"surfaces": "surfaces that move or resist rolling", "rows": "joints but rods, or rods with `across`"}
"""What rows are of that a backend may lack, by variant."""


def variants_of(backend: str) -> Sequence[str]:
    """The variants of rows that a backend has, keys of ``rows.COLUMNS``.

    Raises:
        ImportError: the backend is not installed.
    """
    return getattr(kernel_file(backend, "solve.pack"), "VARIANTS", tuple(COLUMNS))


def markdown(stages: Sequence[Stage] = STEP) -> str:
    """Return stages as a Markdown table."""
    rows = ["| phase | kernel | file | reads | writes | what it does | skipped |", "| --- " * 7 + "|"]
    for stage in stages:
        groups = [", ".join(f"`{name}`" for name in names) for names in (stage.reads, stage.writes)]
        place = f"`{stage.file.replace('.', '/')}.py`"
        cells = (stage.phase, f"`{stage.kernel}`", place, *groups, stage.does, stage.skipped)
        rows.append(f"| {' | '.join(cells)} |".replace("|  |", "| |"))
    return "\n".join(rows)


def files_of(
    backend: str, variant: str, *, sleep: bool = False, added: Collection[str] = (), soft: bool = False
) -> dict[str, tuple[str, ...]]:
    """The files of the kernels of a simulation, and what those of each are made for; no kernel is made.

    Args:
        backend: see ``kernel_table``.
        variant: see ``kernel_table``.
        sleep: whether bodies may sleep.
        added: kernels of ``ADDED`` that the scene needs.
        soft: whether the method is "tgs_soft".

    Raises:
        ValueError: where a backend has not got the kernels, naming those that have.
    """
    if variant not in variants_of(backend):
        having = [name for name in ("warp", "numpy") if variant in variants_of(name)]  # which need no extra
        raise ValueError(f"backend is {backend!r}, which has no rows of {WORDS[variant]}; it must be one of {having}")
    more = (*(SLEEP if sleep else ()), *(SOFT if soft else ()))
    more += tuple(stage for stage in ADDED if stage.kernel in added)
    files = {stage.file: stage.options for stage in (*STEP, *more)}
    for file in files:
        if file in LACKING and not has_kernels(backend, file):
            raise ValueError(f"backend is {backend!r}, which has no {LACKING[file]}; use 'warp' or 'numpy'")
        kernel_factory(backend, file)
    return files


def kernel_table(
    backend: str,
    dtype: str,
    variant: str,
    only_discs: bool,
    *,
    sleep: bool = False,
    traits: bool = False,
    added: Collection[str] = (),
    soft: bool = False,
) -> dict[str, Any]:
    """All kernels of a simulation by name.

    Args:
        backend: "warp", or "numpy": the oracle, never fast.
        dtype: "float32" or "float64".
        variant: layout of solver rows, a key of ``rows.COLUMNS``.
        only_discs: whether all that moves are discs about their centre of mass.
        sleep: whether bodies may sleep.
        traits: whether bodies have damping, or a gravity of their own.
        added: kernels of ``ADDED`` that the scene needs.
        soft: whether the method is "tgs_soft".

    Raises:
        ValueError: see ``files_of``.
    """
    options = {"variant": variant, "only_discs": only_discs, "traits": traits, "rolls": "keep_rolling" in added}
    table: dict[str, Any] = {}
    for file, names in files_of(backend, variant, sleep=sleep, added=added, soft=soft).items():
        table.update(make_kernels(backend, file, dtype, *(options[name] for name in names)))
    return table
