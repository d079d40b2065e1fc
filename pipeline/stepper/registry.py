"""What makes the stepper of a simulation; this module loads without torch."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from pipeline.starts.registry import Maker, maker
from pipeline.stepper.choice import StepperOptions

PRETRAINED = Path(__file__).resolve().with_name("stepnet.safetensors")
"""The file of the pretrained stepper, which comes with the package."""


DEFAULT_START = "builtin"
"""The start of a contact solver where nothing else is asked for."""


def solve_maker(options: StepperOptions, start: str, seed: int) -> Maker:
    """Return what makes the solve of a simulation's steps: a start of its solver, or a network in its place.

    Raises:
        OSError, ValueError, ImportError: see ``stepper_maker`` and ``starts.registry.maker``; for options that belong
            to the other of the two.
    """
    if options.stepper == "network":
        if start != DEFAULT_START:
            raise ValueError(f"start is {start!r}; a network in the solver's place has no start: leave it out")
        return stepper_maker(options)
    for name in ("weights", "project", "energy"):
        given, default = getattr(options, name), getattr(StepperOptions, name)
        if given != default:
            raise ValueError(f"{name} is {str(given)!r}, and stepper 'solver'; it is an option of --stepper network")
    return maker(start, seed)


def stepper_maker(options: StepperOptions) -> Maker:
    """Return what makes the stepper of a simulation; its file is read here, before anything runs.

    Raises:
        OSError: the file cannot be read.
        ValueError: it holds no network; where the stepper is made, one that cannot step the simulation.
        ImportError: naming the extra, without torch.
    """
    from pipeline.networks.checkpoint import load_checkpoint
    from pipeline.stepper.solve import NetworkStepper

    path = options.weights or PRETRAINED
    model, manifest = load_checkpoint(path)
    if not isinstance(manifest.get("stepper"), Mapping):
        raise ValueError(f"{path}: its manifest has no 'stepper'; the network was not trained by train-stepper")
    return lambda sim: NetworkStepper(sim, model, manifest, options)
