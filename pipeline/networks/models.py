"""Networks that map an image of a world's bodies and contacts to an image of its impulses.

The four of the theses (Copenhagen, 2018) map (B, channels, rows, columns) to (B, outputs, rows, columns):

- ``convfc`` (J. Wu): four times [3x3 convolution, batch norm, ReLU, 2x2 max pool] of 64, 128, 256, 512 filters, then
  dropout, dense 4000, dropout, dense. At 41 x 41 x 5 it has 33.4 million parameters, which tells that an odd side is
  pooled up (41, 21, 11, 6, 3): pooled down, it would have 23.2 million.
- ``pressure`` (L. Engedal, after Tompson et al. 2016): 4x4 convolution to 16 filters; two more at each of three scales,
  brought back to full size and summed; 1x1 convolutions 16, 8, 4, 2.
- ``peak`` (L. Engedal): 4x4 convolutions of 8, 16, 32, 64 filters with average pooling between; each scale and the
  input reduced to 6 channels, brought back to full size and summed; dense layers.
- ``unet`` (L. Tirca): encoder and decoder with skip connections, dilated convolutions at the bottom.

Where the theses are silent: ReLU follows every convolution and dense layer but the last; convolutions pad with zeros to
the same size, those of even width with one node less before than after; odd sides are pooled up; an image comes back to
full size bilinearly, and what lies beyond the grid is cut off. ConvFC's dense layer has a ReLU and both its dropouts
Peak's rate. Peak has one hidden dense layer of 512. UNet has three scales of 16, 32, 64 filters, two 3x3 convolutions
each, dilations 1, 2, 4 of 128 filters below them, and no normalization: impulses have a scale that must get through.
Inputs are divided by a scale for each channel and clipped at a bound, outputs multiplied by a scale
(``GridNetwork.set_scales``; by default nothing is changed), because the walls' 100 kg a node would otherwise dominate a
body's 0.1 kg. ``width`` multiplies the filters and hidden units of all.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, is_dataclass
from typing import Annotated, Any, ClassVar

from dc_kernels.model.settings import Limits, Settings
from dc_kernels.runtime.imports import require
from pipeline.networks.registry import Setup, Share, Width, entry, register

torch = require("torch", "pipeline")
nn, functional = torch.nn, torch.nn.functional
Module: Any = nn.Module  # a name that mypy takes as a base


def build(name: str, config: Any = None) -> Any:
    """Build a network with fresh weights, drawn from torch's global generator.

    Args:
        name: convfc, pressure, peak, unet, or another one that is registered.
        config: its configuration, or a mapping of its fields, in which a list stands for a tuple, as JSON knows none;
            None: the defaults.

    Returns:
        The module, with the attributes ``network_name`` and ``config``, from which a checkpoint builds it again.

    Raises:
        ValueError: for an unknown name, an unknown field, or a value out of range.
    """
    kind, module, *_ = entry(name)
    if config is None:
        config = kind()
    elif isinstance(config, Mapping):
        known = [f.name for f in fields(kind)]
        for key in config:
            if key not in known:
                raise ValueError(f"config of {name} has the field {key!r}; it has {tuple(known)} only")
        config = kind(**{key: tuple(value) if isinstance(value, list) else value for key, value in config.items()})
    elif type(config) is not kind:
        raise ValueError(f"config of {name} is a {type(config).__name__}; it must be a {kind.__name__}")
    network = module(config)
    if isinstance(network, GridNetwork):
        network = network.to(memory_format=torch.channels_last)  # a third faster on a CPU
    network.network_name, network.config = name, config
    return network


def config_dict(network: Any) -> dict[str, Any]:
    """Return the configuration of a network that ``build`` made, by field.

    Raises:
        ValueError: for a module that ``build`` did not make.
    """
    config = getattr(network, "config", None)
    if not is_dataclass(config) or not hasattr(network, "network_name"):
        raise ValueError(f"model is a {type(network).__name__} that models.build did not make")
    return asdict(config)  # type: ignore[arg-type]


def parameter_count(network: Any) -> int:
    """Count the weights that training changes."""
    return sum(p.numel() for p in network.parameters() if p.requires_grad)


Nodes = Annotated[int, Limits(least=8, below=2**16)]
Channels = Annotated[int, Limits(least=1, below=2**16)]


@dataclass(frozen=True, kw_only=True)
class GridConfig(Settings):
    """Sizes of a network of the theses; the defaults are Engedal's grid and channels."""

    settings_prefix: ClassVar[str] = "GridConfig."

    rows: Nodes = 61
    """Nodes along y [1]."""
    columns: Nodes = 61
    """Nodes along x [1]."""
    channels: Channels = 6
    """Channels of the input [1]."""
    outputs: Channels = 2
    """Channels of the answer: normal and tangential impulse of each bin of normal directions [1]."""
    width: Width = 1.0
    """Factor on the number of filters and hidden units [1]."""
    dropout: Share = 0.4
    """Dropout rate of ConvFC and Peak [1]."""

    def filters(self, count: int) -> int:
        """Scale a number of filters or units by the width."""
        return max(1, round(self.width * count))

    @property
    def nodes(self) -> int:
        """Number of nodes of the grid [1]."""
        return self.rows * self.columns


class GridNetwork(Module):
    """Checks images, scales their channels and the answer: what the theses' networks have in common."""

    def __init__(self, config: GridConfig) -> None:
        super().__init__()
        self.shape = (config.channels, config.rows, config.columns)
        self.register_buffer("input_scale", torch.ones(config.channels, 1, 1))
        self.register_buffer("output_scale", torch.ones(config.outputs, 1, 1))
        self.register_buffer("input_bound", torch.tensor(math.inf))

    def set_scales(self, channels: Any, outputs: Any, bound: float = math.inf) -> None:
        """Divide each input channel, and multiply each channel of the answer, by a positive number.

        Args:
            channels: of the input, (channels,).
            outputs: of the answer, (outputs,).
            bound: scaled inputs are cut to [-bound, bound].

        Raises:
            ValueError: for another number of them, or one that is not positive; only the bound may be inf.
        """
        for name, buffer, given in (("channels", self.input_scale, channels), ("outputs", self.output_scale, outputs)):
            values = torch.as_tensor(given, dtype=buffer.dtype)
            if values.shape != (len(buffer),):
                raise ValueError(f"{name} has shape {tuple(values.shape)}; it must be ({len(buffer)},)")
            wrong = ~(torch.isfinite(values) & (values > 0))
            if wrong.any():
                i = int(wrong.nonzero()[0])
                raise ValueError(f"{name}[{i}] is {float(values[i])}; it must be finite and > 0")
            buffer.copy_(values[:, None, None])
        if not bound > 0.0:
            raise ValueError(f"bound is {bound}; it must be > 0")
        self.input_bound.fill_(bound)

    def forward(self, images: Any) -> Any:
        """Answer input images (B, channels, rows, columns) with impulse images (B, outputs, rows, columns).

        Raises:
            ValueError: for images of another shape, or a network whose answer has another one.
        """
        if images.dim() != 4 or tuple(images.shape[1:]) != self.shape:
            wanted = ", ".join(map(str, self.shape))
            raise ValueError(f"images has shape {tuple(images.shape)}; the network reads (B, {wanted})")
        scaled = torch.clamp(images / self.input_scale, -self.input_bound, self.input_bound)
        scaled = scaled.contiguous(memory_format=torch.channels_last)
        answer = self.answer(scaled)
        wanted_answer = (len(images), len(self.output_scale), *self.shape[1:])
        if tuple(answer.shape) != wanted_answer:
            name = type(self).__name__
            raise ValueError(f"{name}.answer gave shape {tuple(answer.shape)}; it must give {wanted_answer}")
        return (answer * self.output_scale).contiguous()

    def answer(self, x: Any) -> Any:
        """Answer scaled images, in units of the answer's scale."""
        raise NotImplementedError


CONVFC = Setup(contacts=("normal_x",), nodes=41, decode="bilinear", optimizer="sgd", schedule="decay", rate=0.01)
"""What ConvFC reads and how it is trained (Wu 2018)."""
UNET = Setup(bodies=("velocity_x", "velocity_y", "omega", "mass", "inertia"), contacts=())
"""What UNet reads and how it is trained (Tirca 2018)."""


@register("convfc", GridConfig, CONVFC)
class ConvFC(GridNetwork):
    """Convolutions, then two dense layers, of which the last one is as wide as the image (Wu 2018)."""

    def __init__(self, config: GridConfig) -> None:
        super().__init__(config)
        sizes = [config.channels, *(config.filters(n) for n in (64, 128, 256, 512))]
        rows, columns = config.rows, config.columns
        layers = []
        for before, after in itertools.pairwise(sizes):
            layers += [nn.Conv2d(before, after, 3, padding=1), nn.BatchNorm2d(after), nn.ReLU()]
            layers.append(nn.MaxPool2d(2, ceil_mode=True))
            rows, columns = -(-rows // 2), -(-columns // 2)
        hidden = config.filters(4000)
        self.layers = nn.Sequential(
            *layers,
            nn.Flatten(),
            nn.Dropout(config.dropout),
            nn.Linear(sizes[-1] * rows * columns, hidden),
            nn.ReLU(),
            nn.Dropout(config.dropout),
            nn.Linear(hidden, config.outputs * config.nodes),
            nn.Unflatten(1, (config.outputs, config.rows, config.columns)),
        )

    def answer(self, x: Any) -> Any:
        return self.layers(x)


@register("pressure", GridConfig)
class Pressure(GridNetwork):
    """Convolutions at three scales, summed (Engedal 2018, after the pressure solver of Tompson et al. 2016)."""

    SCALES = 3

    def __init__(self, config: GridConfig) -> None:
        super().__init__(config)
        most, *fewer = (config.filters(n) for n in (16, 8, 4))
        self.first = conv4(config.channels, most)
        self.scales = nn.ModuleList(nn.Sequential(conv4(most, most), conv4(most, most)) for _ in range(self.SCALES))
        layers = []
        for before, after in itertools.pairwise([most, *fewer]):
            layers += [nn.Conv2d(before, after, 1), nn.ReLU()]
        self.last = nn.Sequential(*layers, nn.Conv2d(fewer[-1], config.outputs, 1))

    def answer(self, x: Any) -> Any:
        scaled = self.first(x)
        total = self.scales[0](scaled)
        for level, block in enumerate(self.scales[1:], start=1):
            scaled = halved(scaled)
            total = total + enlarged(block(scaled), 2**level, x)
        return self.last(total)


@register("peak", GridConfig)
class Peak(GridNetwork):
    """Four scales and the input, summed, then dense layers over the whole image (Engedal 2018)."""

    REDUCED = 6  # channels that each scale is reduced to, at any width

    def __init__(self, config: GridConfig) -> None:
        super().__init__(config)
        sizes = [config.channels, *(config.filters(n) for n in (8, 16, 32, 64))]
        self.convolutions = nn.ModuleList(conv4(a, b) for a, b in itertools.pairwise(sizes))
        self.reductions = nn.ModuleList(nn.Conv2d(n, self.REDUCED, 1) for n in sizes)
        hidden = config.filters(512)
        self.dense = nn.Sequential(
            nn.Flatten(),
            nn.Dropout(config.dropout),
            nn.Linear(self.REDUCED * config.nodes, hidden),
            nn.ReLU(),
            nn.Dropout(config.dropout),
            nn.Linear(hidden, config.outputs * config.nodes),
            nn.Unflatten(1, (config.outputs, config.rows, config.columns)),
        )

    def answer(self, x: Any) -> Any:
        total, scaled = self.reductions[0](x), x
        for level, (convolve, reduce) in enumerate(zip(self.convolutions, self.reductions[1:])):
            scaled = convolve(scaled if level == 0 else halved(scaled))
            total = total + enlarged(reduce(scaled), 2**level, x)
        return self.dense(total)


@register("unet", GridConfig, UNET)
class UNet(GridNetwork):
    """Encoder and decoder with skip connections, and dilated convolutions at the bottom (Tirca 2018)."""

    DILATIONS = (1, 2, 4)

    def __init__(self, config: GridConfig) -> None:
        super().__init__(config)
        sizes = [config.filters(n) for n in (16, 32, 64)]
        bottom = config.filters(128)
        inputs = [config.channels, *sizes]
        self.down = nn.ModuleList(conv3_pair(a, b) for a, b in zip(inputs, sizes))
        dilated = []
        for before, dilation in zip([sizes[-1], bottom, bottom], self.DILATIONS):
            dilated += [nn.Conv2d(before, bottom, 3, padding=dilation, dilation=dilation), nn.ReLU()]
        self.bottom = nn.Sequential(*dilated)
        below = [*sizes[1:], bottom]
        self.up = nn.ModuleList(nn.ConvTranspose2d(b, a, 2, stride=2) for a, b in zip(sizes, below))
        self.merge = nn.ModuleList(conv3_pair(2 * a, a) for a in sizes)
        self.last = nn.Conv2d(sizes[0], config.outputs, 1)

    def answer(self, x: Any) -> Any:
        skips = []
        for block in self.down:
            skips.append(block(x))
            x = functional.max_pool2d(skips[-1], 2, ceil_mode=True)
        x = self.bottom(x)
        for skip, up, merge in zip(skips[::-1], self.up[::-1], self.merge[::-1]):
            x = merge(torch.cat([skip, cut(up(x), skip)], dim=1))
        return self.last(x)


def conv3_pair(before: int, after: int) -> Any:
    """Make two 3x3 convolutions, each with its ReLU."""
    convolutions = nn.Conv2d(before, after, 3, padding=1), nn.Conv2d(after, after, 3, padding=1)
    return nn.Sequential(convolutions[0], nn.ReLU(), convolutions[1], nn.ReLU())


def conv4(before: int, after: int) -> Any:
    """Make a 4x4 convolution that keeps the size of the image, and its ReLU."""
    return nn.Sequential(nn.ZeroPad2d((1, 2, 1, 2)), nn.Conv2d(before, after, 4), nn.ReLU())


def halved(x: Any) -> Any:
    """Average 2x2 nodes; at the end of an odd side, those that there are."""
    return functional.avg_pool2d(x, 2, ceil_mode=True, count_include_pad=False)


def enlarged(x: Any, factor: int, like: Any) -> Any:
    """Enlarge bilinearly, node 0 over the first ``factor`` nodes, and cut to the size of another image."""
    if factor == 1:
        return x
    return cut(functional.interpolate(x, scale_factor=factor, mode="bilinear", align_corners=False), like)


def cut(x: Any, like: Any) -> Any:
    """Cut an image to its first rows and columns, as many as another has."""
    return x[..., : like.shape[-2], : like.shape[-1]]
