"""StepNet: from a state and its contacts to the velocities after the contacts acted.

A small U-Net reads an image of bodies, contacts and walls; its answer is read at the bodies. A head then goes along the
contacts for some rounds, as an iteration of a solver would: each contact sees how its bodies move against each other,
what the U-Net and the other contacts say at both, and answers with a change of its impulse, which moves the bodies.
Impulses stay on their friction cones, and act on both bodies: whatever the weights, no momentum is made or lost.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

from dc_kernels.grid.grid import Grid
from dc_kernels.learn.step_channels import ANSWER, CHANNELS, LEAST_GIVE, MOTION
from dc_kernels.learn.step_layers import StepLayers
from dc_kernels.model.settings import Limits, Positive, Settings
from dc_kernels.runtime.imports import require
from dc_kernels.torch_ops.transfer import gather_torch
from pipeline.networks.models import Channels
from pipeline.networks.registry import register
from pipeline.networks.trunk import Trunk
from pipeline.networks.weights import as_arrays, runs_as_written
from pipeline.stepper.view import ContactFrame, StepView

torch = require("torch", "pipeline")
nn = torch.nn
F = torch.nn.functional
Module: Any = nn.Module  # a name that mypy takes as a base

LEAK = 0.1
"""Share of the gradient that passes where the friction cone cuts an impulse off [1]."""


@dataclass(frozen=True, kw_only=True)
class StepNetConfig(Settings):
    """Sizes of the layers of a StepNet, and of the grid that it reads."""

    settings_prefix: ClassVar[str] = "StepNetConfig."

    spacing: Positive = 0.5
    """Distance of the grid's nodes [typical diameters]."""
    channels: tuple[Channels, ...] = (12, 16, 24)
    """Channels of the U-Net at each scale; each scale halves the grid [1]."""
    near: Channels = 8
    """Channels that are read at the bodies [1]."""
    rounds: Annotated[int, Limits(least=1, most=1024)] = 12
    """Rounds along the contacts [1]."""
    hidden: Channels = 16
    """Numbers that a contact keeps from round to round [1]."""
    width: Channels = 48
    """Width of the layer of a round [1]."""

    def check(self) -> None:
        """Raise a ``ValueError`` where there is no scale."""
        if not self.channels:
            raise ValueError(f"{self.settings_prefix}channels is (); it must hold widths >= 1")


@register("stepnet", StepNetConfig, None)
class StepNet(Trunk):
    """Maps a view of worlds before a step to the ways of their bodies with contacts."""

    def __init__(self, config: StepNetConfig | None = None) -> None:
        """Draw random weights; the answer begins as rounds of damped Jacobi steps."""
        config = config or StepNetConfig()
        super().__init__(len(CHANNELS), config.channels, config.near)
        self.config = config
        self.first = nn.Linear(MOTION, config.hidden)
        inputs = MOTION + 2 * config.near + 3 * config.hidden
        self.rounds = nn.ModuleList(
            nn.Sequential(nn.Linear(inputs, config.width), nn.ReLU(), nn.Linear(config.width, ANSWER + config.hidden))
            for _ in range(config.rounds)
        )
        with torch.no_grad():
            for cell in self.rounds:
                cell[-1].weight[:ANSWER] *= 0.1
                cell[-1].bias[:ANSWER] = 0.0
        self.to(memory_format=torch.channels_last)  # half the time of a convolution on a CPU

    def forward(self, view: StepView, grid: Grid) -> tuple[Any, Any]:
        """Return ways of the bodies with contacts, (N, 3) [unit], and the impulses of them, (M, 2) [kg unit]."""
        frame = view.of_contacts()
        image = view.image(frame, grid).contiguous(memory_format=torch.channels_last)
        seen = gather_torch(self.trunk(image).contiguous(), view.position, grid, start=view.body_start)
        moving = view.dynamic
        return self.head(view, frame, seen * moving, moving)

    def head(self, view: StepView, frame: ContactFrame, seen: Any, moving: Any) -> tuple[Any, Any]:
        """Go along the contacts; ``seen`` is what bodies read of the image, (N, near)."""
        a, b, count = view.body_a, view.body_b, len(view.way)
        give, slip_give = (give.clamp(min=LEAST_GIVE) for give in frame.give)
        around = torch.cat([seen[a], seen[b]], dim=1)
        share = torch.stack([view.inv_mass[a] / give, view.inv_mass[b] / give, view.friction], dim=1)
        normal = tangent = torch.zeros_like(view.gap)
        way, hidden = view.way, None
        for cell in self.rounds:
            closing, sliding = frame.relative(way)
            left = closing + view.gap
            motion = torch.stack(
                [left, left.clamp(max=0.0), sliding, normal * give, tangent * slip_give, view.gap, closing], dim=1
            )
            motion = torch.cat([motion, share], dim=1)
            if hidden is None:
                hidden = F.relu(self.first(motion))
            heard = frame.summed(hidden, count) * moving
            answer = cell(torch.cat([motion, around, hidden, heard[a] - hidden, heard[b] - hidden], dim=1))
            step = -torch.sigmoid(answer[:, 0]) * left + answer[:, 2]
            slip = -torch.sigmoid(answer[:, 1]) * sliding + answer[:, 3]
            normal, tangent = on_cone(normal + step / give, tangent + slip / slip_give, view.friction)
            way = frame.pushed(view.way, normal, tangent)
            hidden = F.relu(answer[:, ANSWER:])
        return way, torch.stack([normal, tangent], dim=1)

    def in_lanes(self) -> StepLayers | None:
        """Return the weights for kernels.

        None: with another ``forward``, ``trunk`` or ``head``, or hooks, torch answers.
        """
        if not runs_as_written(self, StepNet, "forward", "trunk", "head"):
            return None
        weight, bias = as_arrays(self.near)
        return StepLayers(
            down=[as_arrays(layer) for layer in self.down],
            up=[as_arrays(layer) for layer in self.up],
            near=(weight.reshape(len(weight), -1), bias),
            first=as_arrays(self.first),
            rounds=[(as_arrays(cell[0]), as_arrays(cell[-1])) for cell in self.rounds],
        )


def on_cone(normal: Any, tangent: Any, friction: Any) -> tuple[Any, Any]:
    """Put impulses (M,) each on the friction cone; a normal one that it cuts off passes ``LEAK`` of the gradient."""
    rest = LEAK * normal.clamp(max=0.0)
    normal = normal.clamp(min=0.0) + rest - rest.detach()
    limit = friction * normal
    return normal, torch.maximum(torch.minimum(tangent, limit), -limit)
