"""What a call of a ContactNet leaves to do: the error after it and some sweeps, differentiable.

What is minimized is the logarithm of that error, since the sweeps that a solve still needs go with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dc_kernels.grid.grid import Grid
from dc_kernels.grid.stencil import Stencil
from dc_kernels.learn.channels import Scale
from dc_kernels.learn.differentiable import ContactProblem, sweeps_torch
from dc_kernels.runtime.imports import require
from dc_kernels.torch_ops.transfer import gather_torch, splat_torch
from pipeline.contactnet.network import CARRIED, FREE, STEP, EvenShare

torch = require("torch", "pipeline")

LEAK = 0.1
"""Share of the gradient that passes what the friction cone cuts off [1]."""
FLOOR = 1e-5
"""Error of an impulse below which nothing is gained [N s]."""
CONTACT_FIELDS = ("normal", "arm_a", "arm_b", "friction", "bias", "effective_mass")
BODY_FIELDS = ("inv_mass", "inv_inertia", "velocity")
CALL_FIELDS = ("local", "image_value", "impulse", "step", "rate")
ERRORS = ("velocity", "impulse", "step")


@dataclass(frozen=True)
class CallBatch:
    """Holds calls of a network in B solves, one after the other; their M contacts are in the order of a sweep."""

    problem: ContactProblem
    """What the sweeps after a call solve."""
    local: Any
    """Features of each contact, (M, len(LOCAL))."""
    image_value: Any
    """What each contact adds to the images, (M, len(IMAGE))."""
    places: Sequence[Any]
    """Contact points and centres of the bodies A and B [m], (M, 2) each."""
    impulse: Any
    """Impulses that the contacts carry at the call, (M, 2) [N s]."""
    step: Any
    """Change of the impulses in the last sweep, (M, 2) [N s]."""
    rate: Any
    """Amplification A of Aitken's step near each contact, (M,) [1]."""
    scale: Any
    """Scales of each world, those of ``SolveReader.scale``, (B, 4)."""
    label: Any
    """Impulses of the solution, (M, 2) [N s]."""
    world: Any
    """World of each contact, (M,) int64."""
    start: Any
    """First contact of each world and, last, the number of contacts, (B + 1,) int32."""

    @classmethod
    def of(cls, calls: Sequence[dict[str, Any]]) -> CallBatch:
        """Put calls that ``rollouts.Recorder`` has kept together as a batch."""

        def stack(values: Sequence[np.ndarray]) -> Any:
            return torch.from_numpy(np.ascontiguousarray(np.concatenate(values)))

        problems = [call["problem"] for call in calls]
        counts = np.array([len(call["impulse"]) for call in calls])
        bodies = np.array([len(problem["inv_mass"]) for problem in problems])
        start, body_start = (np.concatenate([[0], np.cumsum(n)]).astype(np.int32) for n in (counts, bodies))
        shift = np.repeat(body_start[:-1], counts)
        problem = ContactProblem(
            contact_start=torch.from_numpy(start),
            body_start=torch.from_numpy(body_start),
            **{
                name: torch.from_numpy((np.concatenate([p[name] for p in problems]) + shift).astype(np.int32))
                for name in ("body_a", "body_b")
            },
            **{name: stack([p[name] for p in problems]) for name in (*CONTACT_FIELDS, *BODY_FIELDS)},
        )
        return cls(
            problem=problem,
            places=[stack([call["places"][i] for call in calls]) for i in range(3)],
            scale=torch.from_numpy(np.stack([call["scale"] for call in calls])),
            label=stack([p["label"] for p in problems]),
            world=torch.from_numpy(np.repeat(np.arange(len(calls)), counts)),
            start=torch.from_numpy(start),
            **{
                name: stack([call[name] for call in calls])
                for name in ("local", "image_value", "impulse", "step", "rate")
            },
        )

    @property
    def count(self) -> int:
        """Number of solves in the batch, B."""
        return len(self.scale)

    def total(self, values: Any) -> Any:
        """Sum over the contacts of each world, (B,), of values (M,)."""
        return values.new_zeros(self.count).index_add(0, self.world, values)

    def squares(self, values: Any) -> Any:
        """Return the squared norm of values (M, 2) in each world, (B,)."""
        return self.total(values.square().sum(dim=1))


def on_cone(impulse: Any, friction: Any) -> Any:
    """Put impulses (M, 2) on the friction cone [N s]; what it cuts off passes ``LEAK`` of the gradient."""

    def leaky(free: Any, cut: Any) -> Any:
        rest = LEAK * (free - cut)
        return cut + rest - rest.detach()

    normal = leaky(impulse[:, 0], impulse[:, 0].clamp(min=0.0))
    limit = friction * normal.clamp(min=0.0)
    tangent = leaky(impulse[:, 1], torch.maximum(torch.minimum(impulse[:, 1], limit), -limit))
    return torch.stack([normal, tangent], dim=1)


def corrected(output: Any, impulse: Any, step: Any, rate: Any, scale: Any) -> Any:
    """Correct impulses (M, 2) by an answer as ``correct_impulses`` does before the cone; the scale is (M, 4)."""
    size, expected = scale[:, Scale.IMPULSE, None], scale[:, Scale.EXPECTED, None]
    by_step = (1.0 + rate)[:, None] * output[:, STEP] * step
    return impulse + by_step + expected * (output[:, FREE] + output[:, CARRIED] * impulse / size)


def predicted(batch: CallBatch, model: Any, grid: Grid) -> Any:
    """Return the impulses after a call, on their cones, (M, 2) [N s]."""
    if isinstance(model, EvenShare):
        output = model.head(batch.local, ())
    else:
        images = splat_torch(batch.places[0], batch.image_value, grid, Stencil("bspline"), start=batch.start)
        output = model(batch.local, images, lambda image: gather_all(batch, image, grid))
    new = corrected(output, batch.impulse, batch.step, batch.rate, batch.scale[batch.world])
    return on_cone(new, batch.problem.friction).contiguous()


def errors_left(batch: CallBatch, model: Any, grid: Grid, sweeps: int) -> dict[str, Any]:
    """Measure the errors that a call and some sweeps after it leave, as the log of their norms, (B,) each.

    Args:
        batch: of calls.
        model: a ContactNet, or ``EvenShare``.
        grid: of its images.
        sweeps: plain ones, after the call, >= 1.

    Returns:
        By the names of ``ERRORS``: of the velocities in the energy norm, of the impulses, and the last sweep's step.
    """
    start = predicted(batch, model, grid)
    impulse, _, step = sweeps_torch(start, batch.problem, sweeps, leak=LEAK)
    floor = FLOOR**2 * batch.start.diff()
    error = impulse - batch.label
    squares = (2.0 * batch.problem.energy(error.contiguous()), batch.squares(error), batch.squares(step))
    return {name: 0.5 * torch.log(value + floor) for name, value in zip(ERRORS, squares)}


def gather_all(batch: CallBatch, image: Any, grid: Grid) -> list[Any]:
    """Gather an image at the contacts and at the centres of bodies A and B, (M, channels) each, differentiably."""
    return [gather_torch(image.contiguous(), place, grid, start=batch.start) for place in batch.places]
