"""Commands that train: ``train`` a network of the theses, ``train-contactnet``, and ``train-stepper``."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from pipeline.commands.common import Common, Positional
from pipeline.contactnet.options import ContactTrainOptions
from pipeline.stepper.options import StepperTrainOptions
from pipeline.training.options import TrainOptions
from pipeline.training.summary import describe


@dataclass(frozen=True, kw_only=True)
class Train(Common):
    """Train a network on a data set; write network, state to resume from, curves and predictions."""

    network: Positional[str]
    """Which network: convfc, pressure, peak, unet, one of a plugin, or one of an installed package."""
    training: TrainOptions = field(default_factory=TrainOptions)

    def __call__(self) -> dict[str, Any]:
        from pipeline.training.grid import train_grid_network

        summary = train_grid_network(self.network, self.training, progress=not self.json)
        if not self.json and "files" in summary:  # the first of several processes
            print(describe(summary))
        return summary


@dataclass(frozen=True, kw_only=True)
class TrainContactnet(Common):
    """Train ContactNet, which corrects impulses during a solve, on its own calls; no data set is needed."""

    training: ContactTrainOptions = field(default_factory=ContactTrainOptions)

    def __call__(self) -> dict[str, Any]:
        from pipeline.contactnet.training import describe_contact_training, train_contactnet

        summary = train_contactnet(self.training, progress=not self.json)
        if not self.json and summary:
            print(describe_contact_training(summary))
        return summary


@dataclass(frozen=True, kw_only=True)
class TrainStepper(Common):
    """Train a network that replaces the contact solver, on recorded motions; without --data it records some."""

    network: Positional[str] = "stepnet"
    """Network: stepnet; or convfc, pressure, peak, unet, or one of a plugin or an installed package, which map an
    image of the state to an image of the velocity change."""
    training: StepperTrainOptions = field(default_factory=StepperTrainOptions)

    def __call__(self) -> dict[str, Any]:
        from pipeline.stepper.training import describe_stepper_training, train_stepper

        summary = train_stepper(self.network, self.training, progress=not self.json)
        if not self.json:
            print(describe_stepper_training(summary))
        return summary
