"""A solve with calls of a network, differentiable: calls, sweeps between them, and the error that is left.

What is minimized is the logarithm of that error, since the sweeps that a solve still needs go with it, over a solve in
which every contact makes the same share of Aitken's step. A network that leaves a world with more error than that pays
twice: most of the sweeps of a run are in few worlds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dc_kernels.arrays import require
from dc_kernels.grid import Grid
from dc_kernels.operators import gather_torch, splat_torch
from dc_kernels.solve_channels import LOCAL, OUTPUT
from dc_kernels.sweep_operators import ContactProblem, sweeps_torch

from .contactnet import ACCELERATED, BASE, BASE_LESS, BEGIN

torch = require("torch", "pipeline")

CAP = 200.0  # of Aitken's factor
LEAK = 0.1  # share of the gradient that passes what the friction cone cuts off
TINY = 1e-20
FLOOR = 1e-5  # error of an impulse below which nothing is gained [N s]
CONTACT_FIELDS = ("normal", "arm_a", "arm_b", "friction", "bias", "effective_mass")
BODY_FIELDS = ("inv_mass", "inv_inertia", "velocity")
NEW, SWEEPS, LEFT = LOCAL.index("new"), LOCAL.index("sweeps"), LOCAL.index("left")
ERRORS = ("velocity", "impulse", "step")


@dataclass(frozen=True)
class CallBatch:
    """Calls of a network in B solves, one after the other, in the order of a sweep."""

    problem: ContactProblem
    local: Any
    """(M, len(LOCAL))."""
    image_value: Any
    """(M, len(IMAGE))."""
    places: Sequence[Any]
    """Contact points and centres of the bodies A and B [m], (M, 2) each."""
    impulse: Any
    """(M, 2) [N s]."""
    step: Any
    """Of the last sweep, (M, 2) [N s]."""
    scale: Any
    """See ``SolveReader.scale``, (B, 4)."""
    label: Any
    """Solution, (M, 2) [N s]."""
    world: Any
    """Of each contact, (M,) int64."""
    start: Any
    """First contact of each world and their number, (B + 1,) int32."""

    @classmethod
    def of(cls, calls: Sequence[dict[str, Any]]) -> CallBatch:
        """A batch of calls as ``rollouts.Recorder`` keeps them."""

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
            **{name: stack([call[name] for call in calls]) for name in ("local", "image_value", "impulse", "step")},
        )

    @property
    def count(self) -> int:
        """Solves in the batch."""
        return len(self.scale)

    def total(self, values: Any) -> Any:
        """Sum over the contacts of each world, (B,), of values (M,)."""
        return values.new_zeros(self.count).index_add(0, self.world, values)

    def squares(self, values: Any) -> Any:
        """Squared norm of values (M, 2) in each world, (B,)."""
        return self.total(values.square().sum(dim=1))


def features(batch: CallBatch, impulse: Any, step: Any, before: Any, since: Any, sweeps: Any) -> tuple[Any, Any, Any]:
    """The features of ``_warp/solve_features.py`` in mid-solve, as tensors.

    Args:
        batch: of the first call, whose world it is.
        impulse: present ones, (M, 2) [N s].
        step: of the last sweep, (M, 2) [N s].
        before: squared step of the sweep before that, (B,).
        since: change since the last correction, (M, 2) [N s].
        sweeps: done so far, (B,).

    Returns:
        ``local``, ``image_value`` and ``scale``.
    """
    problem, world = batch.problem, batch.world
    count = batch.start.diff()
    a, b = problem.body_a.long(), problem.body_b.long()
    squares = batch.squares(step)
    sigma = (squares / count).sqrt() + TINY
    size = (batch.squares(impulse) / count).sqrt() + TINY
    rate = aitken(squares, before)
    normal = problem.normal
    tangent = torch.stack([normal[:, 1], -normal[:, 0]], dim=1)
    velocity = problem.velocities(impulse)
    speeds = [_speed(problem, velocity, a, b, u) for u in (normal, tangent)]
    mass = problem.effective_mass
    free = torch.stack([-mass[:, 0] * (speeds[0] + problem.bias), -mass[:, 1] * speeds[1]], dim=1)
    inverse = (1.0 / sigma)[world, None]
    own, free, since = step * inverse, free * inverse, since * inverse
    local_step = problem.natural_map(impulse) * inverse
    world_step = step[:, :1] * normal + step[:, 1:] * tangent
    ones = torch.ones_like(normal[:, :1])
    sums = torch.zeros(len(problem.inv_mass), 3)
    sums.index_add_(0, a, torch.cat([-world_step, ones], dim=1))
    sums.index_add_(0, b, torch.cat([world_step, ones], dim=1))
    mass_a, mass_b = problem.inv_mass[a], problem.inv_mass[b]
    moving = [(m > 0).float() for m in (mass_a, mass_b)]
    limit = problem.friction * impulse[:, 0]
    cone = torch.where(limit > 0, impulse[:, 1] / limit.clamp(min=1e-30), 0.0)
    closed, sliding = (impulse[:, 0] > 0).float(), (cone.abs() > 0.999).float()
    new = batch.local[:, NEW]
    double_x, double_y = normal[:, 0] ** 2 - normal[:, 1] ** 2, 2.0 * normal[:, 0] * normal[:, 1]
    bodies = [
        torch.asinh((sums[body, :2] * u).sum(dim=1) * move * inverse[:, 0])
        for body, move in zip((a, b), moving)
        for u in (normal, tangent)
    ]
    columns = [
        *torch.asinh(own).unbind(1),
        *torch.asinh(local_step).unbind(1),
        *(0.5 * torch.asinh(since)).unbind(1),
        *(0.25 * torch.asinh(impulse * inverse)).unbind(1),
        cone,
        closed,
        sliding,
        new,
        double_x,
        double_y,
        *torch.asinh(free).unbind(1),
        *bodies,
        *(0.25 * sums[body, 2] * move for body, move in zip((a, b), moving)),
        mass_a / (mass_a + mass_b + TINY),
        (0.5 * torch.log1p(rate))[world],
        torch.zeros_like(cone),
        (0.25 * torch.log1p(sweeps))[world],
        (0.25 * torch.log(sigma / size))[world],
        # the tolerance is that of the first call
        batch.local[:, LEFT] + (0.25 * torch.log(sigma / batch.scale[:, 0]))[world],
        batch.local[:, ACCELERATED],
        (0.25 * torch.log(count.float()))[world],
    ]
    image = []
    for value, weight in ((own, 1.0), (since, 0.5), (impulse * inverse, 0.25)):
        vector = value[:, :1] * normal + value[:, 1:] * tangent
        length = vector.norm(dim=1, keepdim=True) + TINY
        vector = vector * (weight * torch.asinh(length) / length)
        image += [vector[:, i] * normal[:, j] for i in range(2) for j in range(2)]
    image += [ones[:, 0], double_x, double_y, new, closed, sliding]
    scale = torch.stack([sigma, size, rate, sigma * (1.0 + rate)], dim=1)
    return torch.stack(columns, dim=1), torch.stack(image, dim=1), scale


def _speed(problem: ContactProblem, velocity: Any, a: Any, b: Any, direction: Any) -> Any:
    """Speed of B against A at the contact along a direction, (M,)."""

    def turn(arm: Any, body: Any) -> Any:
        return (arm[:, 0] * direction[:, 1] - arm[:, 1] * direction[:, 0]) * velocity[body, 2]

    along = ((velocity[b, :2] - velocity[a, :2]) * direction).sum(dim=1)
    return along + turn(problem.arm_b, b) - turn(problem.arm_a, a)


def aitken(now: Any, before: Any) -> Any:
    """Aitken's r / (1 - r), for the ratio r of the last two steps, from their squares, up to ``CAP``."""
    ratio = (now / (before + TINY)).sqrt()
    return torch.where(ratio < CAP * (1.0 - ratio), ratio / (1.0 - ratio).clamp(min=1e-9), CAP)


def on_cone(impulse: Any, friction: Any) -> Any:
    """Impulses on the friction cone; what it cuts off passes ``LEAK`` of the gradient."""

    def leaky(free: Any, cut: Any) -> Any:
        rest = LEAK * (free - cut)
        return cut + rest - rest.detach()

    normal = leaky(impulse[:, 0], impulse[:, 0].clamp(min=0.0))
    limit = friction * normal.clamp(min=0.0)
    tangent = leaky(impulse[:, 1], torch.maximum(torch.minimum(impulse[:, 1], limit), -limit))
    return torch.stack([normal, tangent], dim=1)


def corrected(output: Any, impulse: Any, step: Any, scale: Any) -> Any:
    """What ``correct_impulses`` makes of an answer, before the cone; scale of each contact (M, 4)."""
    sigma, size, rate, expected = scale.unbind(1)
    near = output[:, 0:2] * step + sigma[:, None] * output[:, 2:4]
    carried = output[:, 4:6] * impulse / size[:, None]
    return impulse + (1.0 + rate)[:, None] * near + expected[:, None] * carried


def even_share(local: Any) -> Any:
    """The answer that a ContactNet begins with: the same share of the step for every contact."""
    output = local.new_zeros(len(local), len(OUTPUT))
    output[:, :2] = ((BASE - BASE_LESS * local[:, ACCELERATED]) * (1.0 - local[:, BEGIN]))[:, None]
    return output


def unroll(batch: CallBatch, model: Any, grid: Grid, *, calls: int, every: int, rest: int) -> dict[str, Any]:
    """Errors after some calls with sweeps between them and after them; log of the norms, (B,) each.

    Worlds whose solver is accelerated make an Aitken step half way between two calls, and one in the rest.

    Args:
        batch: of calls; the first one is theirs.
        model: a ContactNet; None: ``even_share``.
        grid: of its images.
        calls: how many, >= 1.
        every: sweeps between two calls, >= 4.
        rest: sweeps after the last one, >= 4.

    Returns:
        By the names of ``ERRORS``: of the velocities in the energy norm, of the impulses, and the last sweep's step.
    """
    problem, world = batch.problem, batch.world
    impulse, step, scale = batch.impulse, batch.step, batch.scale
    local, image_value = batch.local, batch.image_value
    accelerated = batch.total(local[:, ACCELERATED]) > 0.0
    sweeps = torch.expm1(4.0 * batch.total(local[:, SWEEPS]) / batch.start.diff())

    def run(impulse: Any, count: int) -> tuple[Any, Any, Any]:
        """Sweeps, the squared step of the one before the last, and the last one's step."""
        impulse, _, before = sweeps_torch(impulse, problem, count - 1, leak=LEAK)
        impulse, _, step = sweeps_torch(impulse, problem, 1, leak=LEAK)
        return impulse, batch.squares(before.detach()), step

    for call in range(calls):
        if model is None:
            output = even_share(local)
        else:
            images = splat_torch(batch.places[0], image_value, grid, kernel="bspline", start=batch.start)
            output = model(local, images, lambda image: gather_all(batch, image, grid))
        start = on_cone(corrected(output, impulse, step, scale[world]), problem.friction).contiguous()
        count = every if call < calls - 1 else rest
        impulse, before, step = run(start, count // 2)
        if accelerated.any():
            now = batch.squares(step.detach())
            alpha = torch.where(accelerated & (now < before), aitken(now, before), 0.0)
            impulse = on_cone(impulse + alpha[world, None] * step, problem.friction).contiguous()
        impulse, before, step = run(impulse, count - count // 2)
        sweeps = sweeps + count
        if call < calls - 1:
            step = step.detach()
            with torch.no_grad():
                now = impulse.detach()
                local, image_value, scale = features(batch, now, step, before, now - start.detach(), sweeps)
    floor = FLOOR**2 * batch.start.diff()
    error = impulse - batch.label
    squares = (2.0 * problem.energy(error.contiguous()), batch.squares(error), batch.squares(step))
    return {name: 0.5 * torch.log(value + floor) for name, value in zip(ERRORS, squares)}


def gather_all(batch: CallBatch, image: Any, grid: Grid) -> list[Any]:
    """An image at the contacts and at both their bodies, differentiable."""
    return [gather_torch(image.contiguous(), place, grid, start=batch.start) for place in batch.places]
