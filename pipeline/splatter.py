"""Images of a data set's states, the pixels that ``dc.Images`` shows of them in a simulation."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

import dc_kernels as dc
from dc_kernels.area import wall_nodes
from dc_kernels.arrays import kernel_array, kernel_vectors, require
from dc_kernels.backend import argument_names, bind
from dc_kernels.channels import BODY_CHANNELS, CONTACT_CHANNELS
from dc_kernels.images import _codes as channel_codes
from dc_kernels.inputs import check_count
from dc_kernels.transfer import Stencil, stencil_scalars
from dc_kernels.types import BodyType

if TYPE_CHECKING:
    from .dataset import Batch

torch = require("torch", "pipeline")

REMEMBERED = 4096  # sets of wall nodes
_VECTORS = ("area_point", "position", "velocity", "point", "normal", "arm_a", "arm_b", "impulse")


class Splatter:
    """Images of batches: the pixels that ``dc.Images`` with the same arguments shows of the same states.

    The label's image is what ``Images.impulse_image`` would show of it. On the CPU.

    Attributes:
        channels: names in the order of the image, as those of ``dc.Images``.
    """

    def __init__(
        self,
        grid: dc.Grid,
        bodies: Sequence[str] = ("mass", "velocity_x", "velocity_y", "omega"),
        contacts: Sequence[str] = ("normal_x", "normal_y"),
        h: float | None = None,
        walls: float | None = 100.0,
        bins: int = 1,
        kernel: Stencil = "poly6",
        normalize: Literal["particle", "sum"] = "particle",
        nearest: bool = True,
        threads: int = 1,
    ) -> None:
        """Arguments as of ``dc.Images``.

        Raises:
            ValueError: for an unknown or repeated channel, or a setting out of range.
        """
        if not bodies and not contacts:
            raise ValueError("bodies and contacts are both empty; an image needs a channel")
        if walls is not None and not 0.0 <= walls < float("inf"):
            raise ValueError(f"walls is {walls!r}; it must be None, or finite and not negative [kg]")
        stencil_scalars(grid, kernel, h, normalize, nearest)
        self.grid, self.bins = grid, check_count("bins", bins)
        self.settings: dict[str, Any] = {"h": h, "kernel": kernel, "normalize": normalize, "nearest": nearest}
        self.settings["threads"] = check_count("threads", threads)
        self._bodies = channel_codes("bodies", bodies, BODY_CHANNELS)
        self._contacts = channel_codes("contacts", contacts, CONTACT_CHANNELS)
        binned = [f"{name}/{b}" for b in range(bins) for name in contacts] if bins > 1 else contacts
        self.channels = (*bodies, *binned)
        self.walls = walls if walls and "mass" in bodies else None
        self._mass = list(bodies).index("mass") if self.walls else -1
        self._known: OrderedDict[bytes, np.ndarray] = OrderedDict()

    def __call__(self, batch: Batch) -> tuple[Any, Any]:
        """Input (B, channels, rows, columns) and label (B, 2 bins, rows, columns) of a batch, float32."""
        arrays = {f.name: getattr(batch, f.name).numpy() for f in fields(batch)}
        images = []
        if len(self._bodies):
            images.append(self._splat(*self._body_values(arrays)))
        point_bin, values = self._contact_values(arrays)
        settings = {"start": batch.contact_start, "bins": self.bins, "point_bin": point_bin}
        if len(self._contacts):
            images.append(self._splat(batch.point, values, **settings))
        image = images[0] if len(images) == 1 else torch.cat(images, dim=1)
        if self.walls:
            self._add_walls(image, arrays)
        return image, self._splat(batch.point, batch.label, **settings)

    def _splat(self, points: Any, values: Any, start: Any, **settings: Any) -> Any:
        from dc_kernels.operators import splat_torch

        return splat_torch(points, values, self.grid, start=start, **settings, **self.settings)

    def _body_values(self, batch: Mapping[str, np.ndarray]) -> tuple[Any, Any, Any]:
        """Places and values of the dynamic bodies, and the first of each state."""
        body = np.flatnonzero(batch["body_type"] == BodyType.DYNAMIC).astype(np.int32)
        start = np.searchsorted(body, batch["body_start"]).astype(np.int32)
        point, value = np.zeros((len(body), 2), np.float32), np.zeros((len(body), len(self._bodies)), np.float32)
        none = np.zeros((1, 2), np.float32)
        self._features(
            "body_features",
            batch,
            {"area": 0, "body_channel": self._bodies, "area_start": start, "area_body": body},
            {"area_point": none, "area_weight": none[0], "point": point, "value": value},
        )
        return torch.from_numpy(point), torch.from_numpy(value), torch.from_numpy(start)

    def _contact_values(self, batch: Mapping[str, np.ndarray]) -> tuple[Any, Any]:
        """Bins and values of the contacts."""
        a, b = (batch[name].astype(np.int32) for name in ("body_a", "body_b"))
        point, start = batch["point"], batch["contact_start"].astype(np.int32)
        value = np.zeros((len(point), max(len(self._contacts), 1)), np.float32)
        point_bin = np.zeros(len(point) if self.bins > 1 else 1, np.int32)
        if len(point):
            self._features(
                "contact_features",
                batch,
                {
                    "bins": self.bins,
                    "contact_channel": self._contacts,
                    "contact_start": start,
                    "contact_count": np.diff(start),
                    "body_a": a,
                    "body_b": b,
                    "point_bin": point_bin,
                },
                {
                    "arm_a": point - batch["position"][a],
                    "arm_b": point - batch["position"][b],
                    "impulse": batch["start"],
                    "point": np.zeros_like(point),
                    "value": value,
                },
            )
        return torch.from_numpy(point_bin) if self.bins > 1 else None, torch.from_numpy(value)

    def _features(
        self, name: str, batch: Mapping[str, np.ndarray], whole: Mapping[str, Any], real: Mapping[str, np.ndarray]
    ) -> None:
        """Run the kernel that ``dc.Images`` runs, with numbers of the batch where nothing else is given."""
        from dc_kernels._warp import features

        states = len(batch["seed"])
        kernel = features.kernels("float32")[name]
        values: dict[str, Any] = {"world_offset": 0, **{n: v for n, v in whole.items() if isinstance(v, int)}}
        arrays = {**batch, **real, **{n: v for n, v in whole.items() if not isinstance(v, int)}}
        arrays |= {"flags": np.zeros(states, np.int32), "point_count": np.zeros(states, np.int32)}
        for argument in argument_names(kernel):
            if argument not in values:
                array = arrays[argument]
                vector = argument in _VECTORS
                values[argument] = (kernel_vectors if vector else kernel_array)(array, "warp")
        bind(kernel, states, values, "cpu")()

    def _add_walls(self, image: Any, batch: Mapping[str, np.ndarray]) -> None:
        nodes = [self._wall_nodes(batch, state) for state in range(len(batch["seed"]))]
        size = self.grid.rows * self.grid.columns
        whole = np.concatenate([(s * len(self.channels) + self._mass) * size + n for s, n in enumerate(nodes)])
        image.view(-1)[torch.from_numpy(whole)] += self.walls

    def _wall_nodes(self, batch: Mapping[str, np.ndarray], state: int) -> np.ndarray:
        """Nodes of the grid, row by row, that a state's static shapes cover; worlds with the same share them."""
        shapes = slice(*batch["shape_start"][state : state + 2])
        vertex = batch["vertex_start"][shapes.start : shapes.stop + 1]
        body, inverse = np.unique(batch["shape_body"][shapes], return_inverse=True)
        own = {
            "body_type": np.full(len(body), int(BodyType.STATIC)),
            "shape_body": inverse,
            "shape_start": np.array([0, len(inverse)]),
            "shape_type": batch["shape_type"][shapes],
            "shape_radius": batch["shape_radius"][shapes],
            "vertex_start": vertex - vertex[0],
            "vertices": batch["vertices"][vertex[0] : vertex[-1]],
            "position": batch["position"][body],
            "angle": batch["angle"][body],
        }
        key = b"".join(values.tobytes() for values in own.values())
        if key not in self._known:
            shown = _Shapes(own)
            _, row, column = wall_nodes(shown, shown, self.grid)  # type: ignore[arg-type]
            self._known[key] = row.astype(np.int64) * self.grid.columns + column
            if len(self._known) > REMEMBERED:
                self._known.popitem(last=False)
        return self._known[key]


class _Shapes:
    """The static shapes of one world, as ``wall_nodes`` asks a model and a state for them."""

    world_count = 1

    def __init__(self, arrays: Mapping[str, np.ndarray]) -> None:
        self.numpy = arrays.__getitem__
