"""What a program lets a simulation call within its steps."""

from __future__ import annotations

from typing import Any, Protocol

from dc_kernels.model.settings import WrongType, shown
from dc_kernels.runtime.capture import refuse_recording
from dc_kernels.runtime.inputs import check_maybe_callable


class Stepper(Protocol):
    """What takes the place of the contact solver in the steps of a simulation: a start with corrections, a network."""

    sim: Any
    """The simulation that it steps."""

    def solve(self) -> None:
        """Leave the velocities of the step in ``sim.motion.solved``, between ``sim.collide`` and ``sim.advance``.

        It calls ``sim.solve`` once at least, ``sim.solve(pause=0)`` where no sweep is wanted, and may write into
        ``motion.solved`` after that: velocities [m/s] and spin [rad/s] of each body, its first three components.
        """


def check_between(sim: Any, start: Any, callback: Any, stepper: Any) -> None:
    """Check what is to be called within the steps of a simulation.

    Raises:
        TypeError: naming the argument: ``start`` or ``callback`` cannot be called, ``stepper`` has no method ``solve``.
        ValueError: the stepper was made for another simulation, or the method is "tgs_soft".
        RuntimeError: within a recording, as all of them run in Python.
    """
    if not callable(start) and callable(getattr(start, "solve", None)):
        raise WrongType(f"start is {shown(start)}; it must be callable: what has a method solve is given as stepper")
    check_maybe_callable("start", start)
    check_maybe_callable("callback", callback)
    if stepper is not None:
        if not callable(getattr(stepper, "solve", None)):
            raise WrongType(f"stepper is {shown(stepper)}; it must have a method solve")
        if sim.config.soft:
            raise ValueError("SolverConfig.method is 'tgs_soft', whose solve moves the bodies too: a stepper cannot")
        if getattr(stepper, "sim", None) is not sim:
            raise ValueError("the stepper was made for another simulation")
    refuse_recording("a step with start, stepper or callback", "these run in Python")


def run_between(sim: Any, steps: int, dt: float, start: Any, callback: Any, stepper: Any) -> None:
    """Make steps of dt [s] one by one, with what a program has to say within them or after each."""
    parts = sim.config.whole_substeps
    for _ in range(steps):
        if start is None and stepper is None:
            sim.run(1, dt)
        else:
            for _ in range(parts):
                sim.collide(dt / parts)
                if start is not None:
                    start(sim)
                    sim.check_start()
                (stepper or sim).solve()
                sim.advance()
        if callback is not None:
            callback(sim)
