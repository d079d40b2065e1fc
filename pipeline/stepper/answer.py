"""What networks answer to a view, as ways of the bodies: of StepNet, and of the networks that answer images."""

from __future__ import annotations

from typing import Any, NamedTuple

from dc_kernels.grid.grid import Grid
from dc_kernels.grid.stencil import POLY6
from dc_kernels.model.settings import shown
from dc_kernels.runtime.imports import require
from dc_kernels.torch_ops.transfer import gather_torch, splat_torch
from pipeline.stepper.view import StepView

torch = require("torch", "pipeline")

OUTPUTS = 3
"""Channels of an image that a network answers: change of the way by the contacts, x, y and turn [1]."""
SEEN = 1e-6
"""Sum of the weights of the bodies at a node from which an image has a value there [1]."""


class Answer(NamedTuple):
    """What a network answers."""

    way: Any
    """Of each body, with contacts, (N, 3) [unit]."""
    image: Any = None
    """Change of the way at the nodes, (B, OUTPUTS, rows, columns) [unit]; None of a network that answers bodies."""
    impulse: Any = None
    """Impulses of the contacts that make this change, (M, 2) [kg unit]; None of a network that answers none."""


def reads_views(model: Any) -> bool:
    """Tell whether a network reads a view itself, as StepNet does; others map an image to an image."""
    return getattr(model, "network_name", "") == "stepnet"


def answer(model: Any, view: StepView, grid: Grid) -> Answer:
    """Ask a network for the ways of a view's bodies; those that are not dynamic keep theirs.

    Raises:
        TypeError, ValueError: what it answers is no tensor, or of another shape than a way and an impulse have.
    """
    if reads_views(model):
        answered = model(view, grid)
        if not isinstance(answered, tuple) or len(answered) != 2:
            raise TypeError(f"the network answers {shown(answered)}; it must be two tensors, ways and impulses")
        way, impulse = answered
        _check_answer("ways", way, view.way.shape)
        if impulse is not None:
            _check_answer("impulses", impulse, (len(view.gap), 2))
        return Answer(way, impulse=impulse)
    image = model(view.image(view.of_contacts(), grid))
    _check_answer("an image", image, (len(view.walls), OUTPUTS, *grid.shape))
    change = gather_torch(image.contiguous(), view.position, grid, start=view.body_start)
    return Answer(view.way + change * view.dynamic, image=image)


def _check_answer(name: str, values: Any, shape: tuple[int, ...]) -> None:
    """Raise a ``TypeError`` or ``ValueError`` where a network answers something else than floats of a shape."""
    if not isinstance(values, torch.Tensor) or not values.is_floating_point():
        what = values.dtype if isinstance(values, torch.Tensor) else shown(values)
        raise TypeError(f"the network answers {what} for {name}; it must be a tensor of floats")
    if tuple(values.shape) != tuple(shape):
        raise ValueError(f"the network answers {name} of shape {tuple(values.shape)}; it must be {tuple(shape)}")


def image_of(view: StepView, way: Any, grid: Grid) -> tuple[Any, Any]:
    """Return how contacts change the ways as an image, and where it has a value.

    Args:
        view: of the bodies.
        way: of the bodies with contacts, (N, 3) [unit].
        grid: of the image.

    Returns:
        The average of the bodies near each node by their weights, (B, OUTPUTS, rows, columns) [unit], and 1 where there
        are bodies, else 0, (B, 1, rows, columns).
    """
    moving = view.dynamic
    values = torch.cat([(way - view.way) * moving, moving], dim=1).contiguous()
    image = splat_torch(view.position, values, grid, POLY6, start=view.body_start)
    weight = image[:, OUTPUTS:]
    return image[:, :OUTPUTS] / weight.clamp(min=SEEN), (weight > SEEN).to(image.dtype)


def errors(view: StepView, way: Any, truth: Any) -> tuple[Any, Any]:
    """Measure ways against the truth as energies, and so those of no contacts at all.

    Args:
        view: of the bodies.
        way: what a network answers, (N, 3) [unit].
        truth: the ways, (N, 3) [unit].

    Returns:
        For each world the sum over its bodies of the squared error, turns by the radius of gyration, each body by its
        share of the mean mass, (B,) [unit^2]; and that of the predicted ways.
    """
    turning = view.inv_inertia > 0
    inertia = torch.where(turning, view.mass * view.inv_mass / view.inv_inertia.clamp(min=1e-30), 0.0)
    weight = torch.stack([view.mass, view.mass, inertia], dim=1)
    world, count = view.world, len(view.body_start) - 1

    def total(found: Any) -> Any:
        square = (weight * (found - truth).square()).sum(dim=1)
        return square.new_zeros(count).index_add(0, world, square)

    return total(way), total(view.way.detach())
