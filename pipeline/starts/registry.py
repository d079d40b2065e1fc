"""The starts by name. A new one is a class in a file of its own and a line in ``STARTS``."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from pathlib import Path

import dc_kernels as dc
from dc_kernels.model.settings import WrongType, checker, shown
from pipeline.seeds import check_seed
from pipeline.starts.impulses import Bad, Builtin, Random, Zero
from pipeline.starts.solution import Copy, Transfer
from pipeline.starts.start import Start

check_name = checker(str)
"""Returns a name, or raises an error with what it is the name of."""
Maker = Callable[[dc.Simulation], Start]
"""Makes a start for a simulation."""

STARTS: dict[str, Callable[[dc.Simulation, int], Start]] = {
    "none": lambda sim, seed: Zero(sim),
    "builtin": lambda sim, seed: Builtin(sim),
    "random": Random,
    "bad": lambda sim, seed: Bad(sim),
    "copy": lambda sim, seed: Copy(sim),
    "grid": lambda sim, seed: Transfer(sim),
    "grid-bilinear": lambda sim, seed: Transfer(sim, reverse=False),
}
"""Makes a start for a simulation and a seed, by name; ``maker`` understands copyN, and networks, too."""
CHECKPOINT = ".safetensors"
"""Ends the names of the files of trained networks."""
PRETRAINED = Path(__file__).resolve().parents[1] / "contactnet" / f"contactnet{CHECKPOINT}"
"""The file of the pretrained network, which comes with the package."""
CNN = {"cnn": True, "cnn-start": False}
"""Names of the pretrained network, and whether it is called in mid-solve too."""


def maker(name: str, seed: int = 0) -> Maker:
    """Return what makes the start of a name for a simulation; files are read here, before anything runs.

    Args:
        name: a key of ``STARTS``; copyN, the solution rounded to N decimals; cnn, the pretrained network at the start
            and in mid-solve; cnn-start, at the start only; or the path of a trained network (.safetensors).
        seed: of the random start.

    Raises:
        OSError: a network's file cannot be read.
        TypeError: what is registered under the name cannot make a start of a simulation and a seed.
        ValueError: for an unknown name, a negative seed, or a file that holds no network.
    """
    name, seed = check_name("name", name), check_seed("seed", seed)
    lower = name.lower()
    if is_network(name):
        return _network_maker(name)
    if lower in STARTS:
        return _checked(lower, STARTS[lower], seed)
    match = re.fullmatch(r"copy(\d{1,2})", lower)
    if match is None:
        raise ValueError(
            f"start is {name!r}; it must be one of {(*STARTS, *CNN)}, copyN with N decimals, or the file of a trained "
            f"network, whose name ends with {CHECKPOINT}"
        )
    decimals = int(match[1])
    return lambda sim: Copy(sim, decimals)


def _checked(name: str, make: Callable[[dc.Simulation, int], Start], seed: int) -> Maker:
    """Return what makes a start that is named in ``STARTS``, which may be anybody's.

    Raises:
        TypeError: it cannot be called with a simulation and a seed; where it is called, what it makes is no start.
    """
    try:
        inspect.signature(make).bind(None, seed)
    except TypeError as error:
        raise WrongType(f"start {name!r} must take a simulation and a seed: {error}") from None
    except ValueError:
        pass  # something built in, without a signature

    def of(sim: dc.Simulation) -> Start:
        start = make(sim, seed)
        if not (callable(getattr(start, "solve", None)) and callable(getattr(start, "report", None))):
            raise WrongType(f"start {name!r} makes {shown(start)}; it must have the methods solve and report")
        return start

    return of


def is_network(name: str) -> bool:
    """Tell whether a name for ``maker`` is that of a network."""
    return name.lower() in CNN or name.lower().endswith(CHECKPOINT)


def _network_maker(name: str) -> Maker:
    """Return what makes the start of a network, whose file is read.

    Raises:
        ValueError: it holds no network, or one that takes the place of the solver.
    """
    from pipeline.networks.checkpoint import load_checkpoint

    model, manifest = load_checkpoint(PRETRAINED if name.lower() in CNN else name)
    if "stepper" in manifest:
        raise ValueError(
            f"{name} holds a network that takes the place of the solver, so that it starts none; "
            f"run it by deep-contact simulate --stepper network --weights {name}"
        )
    if hasattr(model, "trunk") and hasattr(model, "head"):  # it corrects a solve in flight
        from pipeline.starts.learned import CallOptions, LearnedSolve

        middle = CNN.get(name.lower(), True)
        options = CallOptions(begin=None if middle else True, middle=middle)
        return lambda sim: LearnedSolve(sim, model, options)
    from pipeline.starts.grid_network import GridNetworkStart

    return lambda sim: GridNetworkStart(sim, model, manifest)
