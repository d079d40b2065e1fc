"""What a training on images begins with: its grid, and a network of its shape."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

from dc_kernels.grid.grid import Grid
from dc_kernels.grid.image_spec import ImageSpec
from dc_kernels.runtime.imports import require
from pipeline.networks import models, registry
from pipeline.training.options import TrainOptions
from pipeline.training.processes import own_randomness

torch = require("torch", "pipeline")


def make_grid(box: Any, nodes: int) -> Grid:
    """Make the grid over a box (low x, low y, high x, high y) [m] with ``nodes`` nodes along its longer side."""
    low, high = box[:2], box[2:]
    return Grid.from_box(low, high, max(high[0] - low[0], high[1] - low[1]) / (nodes - 1))


def check_network(network: str) -> registry.Setup:
    """Return how a network is trained.

    Raises:
        ValueError: for an unknown name, or a network that reads no images of a data set.
    """
    setup = registry.entry(network).setup
    if setup is None:
        raise ValueError(f"network is {network!r}, which reads no images; it must be one of {registry.trained()}")
    return setup


def configuration(network: str, given: Mapping[str, Any], sizes: Sequence[tuple[str, str]]) -> dict[str, Any]:
    """Return the configuration of a network by field: what a training gives, as far as it has such fields, and sizes.

    Args:
        network: name of the network.
        given: values that it takes where it has a field of their name.
        sizes: further fields: name and value, in JSON or else a string.

    Raises:
        ValueError: for a field that it does not have, or that the training sets.
    """
    names = [field.name for field in fields(registry.entry(network).config)]
    found = {name: value for name, value in given.items() if name in names}
    own = tuple(name for name in names if name not in given)
    for name, text in sizes:
        if name not in own:
            raise ValueError(f"sizes.{name} is no field of {network}'s own; it has {own}")
        try:
            found[name] = json.loads(text)
        except json.JSONDecodeError:
            found[name] = text
    return found


def build_network(network: str, images: ImageSpec, options: TrainOptions) -> Any:
    """Build a network that reads and answers images of a specification, with random weights.

    Raises:
        ValueError: for sizes that it does not have, an answer of another shape, or one that cannot be scaled though the
            options ask for it.
    """
    rows, columns = images.grid.shape
    given = {
        "rows": rows,
        "columns": columns,
        "channels": len(images.channels),
        "outputs": images.impulse_channels,
        "width": options.width,
        "dropout": options.dropout,
    }
    model = models.build(network, configuration(network, given, options.sizes))
    with torch.no_grad(), own_randomness():
        answer = model.eval()(torch.zeros(1, len(images.channels), rows, columns))
    wanted = (1, images.impulse_channels, rows, columns)
    if tuple(answer.shape) != wanted:
        raise ValueError(f"{network} answers an image with shape {tuple(answer.shape)}; it must be {wanted}")
    if options.scaling != "none" and not hasattr(model, "set_scales"):
        raise ValueError(
            f"{network} has no set_scales: derive it from models.GridNetwork, or train with scaling 'none'"
        )
    return model
