"""Options of a run with a stepper; this module loads without torch."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from dc_kernels.model.settings import Limits, Settings, Whole, WrongType, shown

Stepper = Literal["solver", "network"]
"""Who makes the velocities of a step."""


def check_stepper(name: str, value: Any) -> None:
    """Raise a TypeError or ValueError, with the name, for no ``Stepper``; it says where the file of a network goes."""
    names = get_args(Stepper)
    if not isinstance(value, str | Path):
        raise WrongType(f"{name} is {shown(value)}; it must be {' or '.join(names)}")
    if str(value) not in names:
        file = Path(value).suffix or len(Path(value).parts) > 1
        way = f"; the file of a network goes with --stepper network --weights {value}" if file else ""
        raise ValueError(f"{name} is {str(value)!r}; it must be {' or '.join(names)}{way}")


@dataclass(frozen=True, kw_only=True)
class StepperOptions(Settings):
    """Options of the computation of a step's velocities."""

    stepper: Stepper = "solver"
    """What computes the velocities of a step: the contact solver, or a network."""
    weights: Path | None = None
    """File of the network of --stepper network, .safetensors, by train-stepper; None: the one in the package."""
    project: Whole | Literal["tolerance"] = 0
    """Sweeps of the solver on the network's velocities; 0: none, as in Wu's draft; tolerance: to its own [1]."""
    energy: Annotated[float, Limits(least=1.0, size=1e6)] = 1.02
    """Kinetic energy relative to that without contacts above which a world falls back to the solver for the step
    [1]."""

    def __post_init__(self) -> None:
        """Check all fields; the stepper first, as its error says where a file belongs."""
        check_stepper("stepper", self.stepper)
        super().__post_init__()
