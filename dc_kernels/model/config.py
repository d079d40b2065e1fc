"""Settings of the contact solver and of the stages around it."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Annotated, Any, ClassVar, Literal

import numpy as np

from dc_kernels.model.fields import Field
from dc_kernels.model.settings import (
    Count,
    Limits,
    NotNegative,
    Positive,
    Settings,
    Whole,
    check_choice,
    checker,
    field_types,
    meant,
    plain_type,
    required,
)

# how kernels know a choice of SolverConfig
METHODS = {"pgs": 0, "jacobi": 1, "tgs_soft": 2}
ACCELERATIONS = {"none": 0, "sor": 1, "aitken": 2, "nncg": 3, "adaptive": 4}
STOPS = {"change": 0, "residual": 1, "motion": 2}
STARTS = {"zero": 0, "cache": 1}
POSITION_CORRECTIONS = {"none": 0, "ngs": 1, "baumgarte": 2}
JOINT_SOLVERS = {"sweeps": 0, "direct": 1}
CHOICES = {
    "method": METHODS,
    "joint_solver": JOINT_SOLVERS,
    "acceleration": ACCELERATIONS,
    "stop": STOPS,
    "start": STARTS,
    "position_correction": POSITION_CORRECTIONS,
}
Room = Annotated[float, Limits(least=0.0, most=1e6)]
Tolerance = Annotated[float, Limits(least=0.0, size=math.inf)]
TOLERANCE = 1e-4  # [N s], or [1] of a residual, where none is given
RELATIVE_TOLERANCE = 1.3e-3  # [1], where none is given
PRESETS: dict[str, dict[str, Any]] = {
    "default": {},
    "strict": {"motion_mean": 0.0},
    "accurate": {"stop": "change"},
    "fast": {"max_sweeps": 10},
    "thesis": {
        "stop": "change",
        "acceleration": "none",
        "min_sweeps": 1,
        "slop": 5e-3,
        "speculative": 0.0,
        "speculative_max": 0.0,
    },
}
"""Settings by the names of ``SolverConfig.preset``, where they are not the default."""
SLACK = 0.05  # of the slop: within it two separating axes count as equal and the first body's is taken


@dataclass(frozen=True, kw_only=True)
class SolverConfig(Settings):
    """Settings of the contact solver and of the stages around it.

    Lengths are multiples of each world's ``length_scale``, so that a scene of millimetres behaves like
    one of kilometres.
    """

    settings_prefix: ClassVar[str] = "SolverConfig."

    method: Literal["pgs", "jacobi", "tgs_soft"] = "pgs"
    """Projected Gauss-Seidel in colour order ("pgs"); Jacobi with mass splitting (Tonge et al. 2012); or substeps of
    one sweep with soft contacts and one relaxing sweep (Catto 2024, as in Box2D 3), without any tolerance."""
    joint_solver: Literal["direct", "sweeps"] = "direct"
    """How joints are solved: "direct" solves all joints whose bodies form trees at once, exactly whatever their masses,
    where sweeps leave an error; "sweeps" solves them row by row like contacts, as method "jacobi" always does."""
    substeps: Count = 1
    """Substeps of a step. With method "tgs_soft" they share pairs, contacts and rows, whose gaps follow the bodies
    to first order; with other methods ``step`` and ``run`` take whole steps of dt / substeps, each with its own
    narrowphase, which keep pairs while no shape leaves its box [1]."""
    soft_frequency: Annotated[float, Limits(above=0.0, most=1.0)] = 0.125
    """With method "tgs_soft" the natural frequency of a contact between two dynamic bodies, half of that of a contact
    with another body and of joints; 30 Hz at 240 substeps a second, as in Box2D 3 [1/substep]."""
    soft_damping: Positive = 10.0
    """With method "tgs_soft" the damping ratio of contacts, as in Box2D 3 [1]."""
    acceleration: Literal["none", "sor", "aitken", "nncg", "adaptive"] = "adaptive"
    """Acceleration of the sweeps: "none"; "sor", over-relaxation by omega; "aitken", extrapolation with back-off;
    "nncg", nonsmooth nonlinear conjugate gradients (Silcowitz et al. 2010); "adaptive", Aitken's extrapolation,
    Nesterov's momentum or Anderson's update, chosen by their gains so far."""
    max_sweeps: Whole = 1000
    """Largest number of sweeps: a solve then ends even if it has not converged [1]."""
    min_sweeps: Whole = 10
    """Smallest number of sweeps of a solve, if max_sweeps allows: each step at rest continues from the error of the
    previous one, so that piles lie still (up to 1e3 times less creep than with 1) and need fewer long solves [1]."""
    tolerance: Tolerance | None = None
    """A solve ends when a sweep changes no impulse by more than this [N s]; with stop "residual", when the residual is
    not above it [1]. None: 1e-4, and ``stop`` may end a solve earlier."""
    relative_tolerance: Tolerance | None = None
    """Second bound on the impulse change, as a multiple of the impulse of a typical body's weight in a
    step. A solve ends when both bounds hold, so that light bodies and short steps are also solved accurately; inf
    disables it. None: 1.3e-3, with which the tolerance of 1e-4 N s is the smaller bound for the theses' discs [1]."""
    stop: Literal["change", "residual", "motion"] | None = None
    """Criterion that ends a solve: "change", the largest impulse change of a sweep, at the tolerances; "residual", the
    natural map of the contact problem relative to its size, at the tolerance; "motion", the impulse change, or the
    change of the bodies' motion by a sweep (``motion_tolerance``): worlds without gravity use the motion alone, worlds
    of rods the impulse change alone. None: "change" if a tolerance is given, else "motion"."""
    motion_tolerance: NotNegative = 0.02
    """With stop "motion" a contact counts as moving if a sweep changes its relative speed, along the normal or the
    tangent, by more than this many slops a step, plus a term by ``motion_share`` or ``motion_mean``. A solve ends when
    at most one contact in ten moves, at most one in 5 000 by more than 50 times its limit, none by more than 200 times,
    or 50 if one of its bodies is ten times as heavy as the other, no row that holds a joint by more than 5 times, and
    the residual is below 0.25 [slop/step]."""
    motion_share: NotNegative = 0.05
    """Share of the velocity change by contacts in the step, of the faster body, beyond 1.5 times that by gravity and up
    to twice the largest speed before it, by which the limit of ``motion_tolerance`` is raised: impacts are solved to
    five per cent [1]."""
    motion_mean: NotNegative = 0.1
    """Share of the mean of that velocity change over all bodies that contacts push, weighted by mass; the larger
    of both terms raises the limit. So a world with many collisions is solved less far than one at rest; 0: only
    ``motion_share`` counts [1]."""
    residual_every: Count = 5
    """Number of sweeps between two checks of the residual or of the motion [1]."""
    start: Literal["cache", "zero"] = "cache"
    """Start impulses of a step: those of the previous step, or zero."""
    omega: Annotated[float, Limits(above=0.0, most=2.0)] = 1.4
    """Relaxation factor of acceleration "sor" [1]."""
    aitken_period: Annotated[int, Limits(least=3, most=2**29)] = 3
    """Smallest number of sweeps between two Aitken extrapolations: with 100 discs 3 needs a tenth fewer sweeps in
    total than 5 [1]."""
    aitken_period_max: Annotated[int, Limits(least=3, most=2**29)] = 40
    """Largest number of sweeps between two Aitken extrapolations after back-off [1]."""
    aitken_cap: NotNegative = 200.0
    """Largest multiple of the last sweep's change that Aitken's extrapolation adds [1]."""
    aitken_threshold: Annotated[float, Limits(above=0.0, most=1.0)] = 0.95
    """Aitken's extrapolation backs off when the change of a sweep is more than this multiple of the change one
    period before [1]."""
    aitken_patience: Count = 20
    """Number of periods without a new smallest change after which sweeps without extrapolation follow:
    2 aitken_period_max of them the first time, twice as many each later time. Extrapolation alone can cycle forever
    where plain Gauss-Seidel converges [1]."""
    stretch: Annotated[int, Limits(least=10, most=2**30)] = 120
    """Number of sweeps for which acceleration "adaptive" keeps a method before it compares them; between 80 and 240
    the total number of sweeps differs by 5 % [1]."""
    position_correction: Literal["ngs", "baumgarte", "none"] = "ngs"
    """How overlap is corrected: "ngs", by a phase that moves the bodies after the velocities are solved (nonlinear
    Gauss-Seidel, as in Box2D 2.3); "baumgarte", by a bias of the velocities; "none", not at all."""
    position_iterations: Whole = 3
    """Sweeps of the "ngs" phase; a world without joints skips it where nothing overlaps by more than the slop [1]."""
    position_factor: Annotated[float, Limits(above=0.0, most=1.0)] = 0.2
    """Share of an overlap that a sweep of the "ngs" phase removes, or a step with "baumgarte" [1]."""
    slop: NotNegative = 5e-4
    """Overlap that is not corrected, and gap that counts as closed [length_scale]."""
    max_correction: Positive = 0.2
    """Largest overlap corrected at once [length_scale]."""
    speculative: NotNegative = 0.02
    """A gap below this is a contact, as is one that closes within the step [length_scale]."""
    speculative_max: NotNegative = 0.1
    """If a body moves by more than ``speculative`` in a step, gaps up to the largest such motion are contacts, but no
    larger ones than this [length_scale]."""
    continuous: bool = False
    """Whether pairs are followed along their path in a step: near misses do not deflect bodies, and bodies pass through
    nothing (``collide/continuous.py``)."""
    margin: NotNegative = 0.1
    """Enlargement of broadphase boxes on each side, with which pairs are kept for several steps [length_scale]."""
    restitution_threshold: NotNegative = 0.32
    """Approach speed below which a contact does not bounce unless it is elastic: the speed after a fall from a
    twentieth of the length scale, 1 m/s for 1 m on Earth [sqrt(gravity length_scale)]."""
    sleep: bool = False
    """Whether bodies fall asleep when they and all bodies that they touch have come to rest, until a disturbance."""
    sleep_speed: NotNegative = 0.01
    """Speed below which a body counts as slow, for its centre and for the rim of a disc of typical size with the
    body's rotation: 3 cm/s for 1 m on Earth [sqrt(gravity length_scale)]."""
    sleep_time: Positive = 1.6
    """Time for which all bodies of an island must be slow before it falls asleep: 0.5 s for 1 m on Earth; without
    gravity it never does [sqrt(length_scale / gravity)]."""
    contact_events: bool = False
    """Whether each step lists the pairs of shapes that touch, and those that have begun and ended to touch or hit each
    other (``Simulation.touches``)."""
    hit_speed: NotNegative = 1.0
    """With contact_events the approach speed above which a pair counts as a hit [m/s]."""
    contact_switches: bool = False
    """Whether contacts may be switched off between ``collide`` and ``solve`` (``Simulation.change_contacts``)."""
    history: bool = False
    """Whether to keep the largest impulse change of every sweep (``SolveStats.history``)."""

    @classmethod
    def preset(cls, name: str, **changed: Any) -> SolverConfig:
        """Return the settings of a preset, with some ``changed``.

        "default" is ``SolverConfig()``. "strict" also ends by motion, but solves each contact of an impact as far as
        in a world at rest. "accurate" solves every step to an impulse change of 1e-4 N s, or
        1.3e-3 of the impulse of a typical weight, with up to 1000 sweeps. "fast" makes at most 10 sweeps a step.
        "thesis" is the protocol of the theses: plain sweeps to 1e-4 N s, contacts where surfaces touch, a slop of 5 mm.

        Raises:
            ValueError: the name is unknown, or ``min_sweeps`` exceeds the sweeps that the preset allows.
            TypeError: there is no setting of a name in ``changed``.
        """
        known = [f.name for f in fields(cls)]
        for setting in changed:
            if setting not in known:
                raise TypeError(f"SolverConfig has no setting {setting!r}{meant(setting, known)}")
        config = cls(**{**PRESETS[check_choice("preset", name, PRESETS)], **changed})
        if "min_sweeps" in changed and "max_sweeps" not in changed and config.min_sweeps > config.max_sweeps:
            raise ValueError(
                f"SolverConfig.min_sweeps is {config.min_sweeps}; the preset {name!r} allows {config.max_sweeps} sweeps"
                ": give max_sweeps too"
            )
        return config

    def check(self) -> None:
        """Raise a ``ValueError`` for settings that do not go together."""
        if self.aitken_period_max < self.aitken_period:
            raise ValueError(
                f"SolverConfig.aitken_period_max is {self.aitken_period_max}; "
                f"it must not be below aitken_period = {self.aitken_period}"
            )
        if self.method == "jacobi" and self.acceleration == "sor" and self.omega > 1.0:
            raise ValueError(f"SolverConfig.omega is {self.omega}; Jacobi with mass splitting is proven only up to 1")

    def to_dict(self) -> dict[str, object]:
        """The settings by name, as stored in snapshots and summaries."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    @property
    def corrects_positions(self) -> bool:
        """Whether a step has the position phase."""
        return self.position_correction == "ngs" and self.position_iterations > 0 and not self.soft

    @property
    def soft(self) -> bool:
        """Whether the method makes its own substeps, which also move the bodies."""
        return self.method == "tgs_soft"

    @property
    def choosing(self) -> tuple[bool, ...]:
        """Settings on which the choice of kernels depends."""
        return self.sleep, self.soft, self.contact_events, self.contact_switches, self.continuous

    @property
    def whole_substeps(self) -> int:
        """Number of whole steps that ``Simulation.step`` makes."""
        return 1 if self.soft else self.substeps

    def restitution_speed(self, gravity: np.ndarray, length_scale: np.ndarray) -> np.ndarray:
        """Return the approach speed below which contacts of each world do not bounce, unless elastic, (W,) [m/s].

        Args:
            gravity: (W, 2) [m/s^2].
            length_scale: (W,) [m].
        """
        return np.asarray(self.restitution_threshold * np.sqrt(np.hypot(gravity[:, 0], gravity[:, 1]) * length_scale))

    @property
    def ends_at(self) -> tuple[Literal["change", "residual", "motion"], float, float]:
        """``stop``, ``tolerance`` and ``relative_tolerance``, with None replaced by the default."""
        given = self.tolerance is not None or self.relative_tolerance is not None
        stop = self.stop or ("change" if given else "motion")
        tolerance = TOLERANCE if self.tolerance is None else self.tolerance
        return stop, tolerance, RELATIVE_TOLERANCE if self.relative_tolerance is None else self.relative_tolerance

    def kernel_values(self) -> dict[str, Any]:
        """Return the settings as kernel arguments: a choice as its number, and inf as a large number."""
        stop, tolerance, relative = self.ends_at
        # a float32 kernel argument holds no product of inf and 0
        known = {"stop": stop, "tolerance": tolerance, "relative_tolerance": min(relative, 1e30)}
        values = {name: getattr(self, name) for name in CONFIG if hasattr(self, name)} | known
        values.update({name: codes[values[name]] for name, codes in CHOICES.items()})
        if self.soft:  # contacts and joints are corrected by their softness
            values["position_correction"] = POSITION_CORRECTIONS["none"]
        switches = ("history", "sleep", "continuous", "contact_events", "contact_switches")
        values |= {name: int(getattr(self, name)) for name in switches}
        values["slack"] = SLACK * self.slop
        return values


@dataclass(frozen=True)
class SimulationOptions(Settings):
    """Arguments of ``Simulation`` other than arrays; they are described there."""

    config: SolverConfig | None = None
    threads: Count = 1
    schedule: Literal["world", "color"] = "world"
    on_overflow: Literal["grow", "raise"] = "grow"
    specialize: bool = True
    pairs_per_shape: Room = 4.0
    contacts_per_body: Room = 2.5


def _config_table() -> dict[str, Field]:
    kinds = {
        name: "real" if plain_type(required(hint)) is float else "int32"
        for name, hint in field_types(SolverConfig).items()
    }
    table = {name: Field(name, "launch", kind, "1", "") for name, kind in kinds.items()}
    for name, meaning in (
        ("slack", "overlap within which two separating axes count as equal [length_scale]"),
        ("uniform_friction", "coefficient that all shapes have in common, -1 if they differ"),
        ("uniform_restitution", "coefficient that all shapes have in common, -1 if they differ"),
    ):
        table[name] = Field(name, "launch", "real", "1", meaning)
    return table


check_config = checker(SolverConfig)
"""Returns settings of a solver, or raises a TypeError with the name."""


def check_awake(config: SolverConfig) -> SolverConfig:
    """Return settings of a stage that moves no bodies, and so supports neither sleep nor substeps.

    Raises:
        ValueError: the settings ask for these.
    """
    if config.soft or config.substeps > 1:
        raise ValueError(
            f"SolverConfig.method is {config.method!r}, substeps {config.substeps}; only a Simulation takes substeps"
        )
    if config.sleep:
        raise ValueError("SolverConfig.sleep is True; only a Simulation lets bodies sleep")
    if config.continuous:
        raise ValueError("SolverConfig.continuous is True; only a Simulation follows bodies along their way")
    for name, does in (("contact_events", "tells of events"), ("contact_switches", "switches contacts off")):
        if getattr(config, name):
            raise ValueError(f"SolverConfig.{name} is True; only a Simulation {does}")
    return config


DEFAULT = SolverConfig()
"""Settings where none are given."""
CONFIG = _config_table()
"""Fields of the struct of settings that kernels take, by the names that ``SolverConfig`` has for them."""
