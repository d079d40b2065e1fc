"""What makes the stepper of a simulation; this module loads without torch."""

from __future__ import annotations

from pathlib import Path

from pipeline.starts.registry import Maker
from pipeline.stepper.choice import StepperOptions

PRETRAINED = Path(__file__).resolve().with_name("stepnet.safetensors")
"""The file of the pretrained stepper, which comes with the package."""


def stepper_maker(options: StepperOptions) -> Maker:
    """Return what makes the stepper of a simulation; its file is read here, before anything runs.

    Raises:
        OSError: the file cannot be read.
        ValueError: it holds no network; where the stepper is made, one that cannot step the simulation.
        ImportError: naming the extra, without torch.
    """
    from pipeline.networks.checkpoint import load_checkpoint
    from pipeline.stepper.solve import NetworkStepper

    model, manifest = load_checkpoint(options.weights or PRETRAINED)
    return lambda sim: NetworkStepper(sim, model, manifest, options)
