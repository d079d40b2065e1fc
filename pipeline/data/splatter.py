"""Images of a data set's states, the pixels that ``dc.Images`` shows of them in a simulation."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

import dc_kernels as dc
from dc_kernels.grid.area import wall_nodes
from dc_kernels.grid.channels import BODY_CHANNELS, CONTACT_CHANNELS, IMPULSES, channel_codes
from dc_kernels.grid.transfer import Splat, Stencil, allocate_image, stencil_scalars, transfer_kernels
from dc_kernels.model.arrays import kernel_array, kernel_vectors
from dc_kernels.model.enums import BodyType
from dc_kernels.runtime.backends import argument_names, bind, make_kernels
from dc_kernels.runtime.inputs import check_count
from dc_kernels.runtime.optional import require

if TYPE_CHECKING:
    from pipeline.data.dataset import Batch

torch = require("torch", "pipeline")

REMEMBERED = 4096  # sets of wall nodes
_VECTORS = ("area_point", "position", "velocity", "point", "normal", "arm_a", "arm_b", "impulse", "grid_origin")


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
        self.grid, self.bins = grid, check_count("bins", bins)
        self._scalars = stencil_scalars(grid, kernel, h, normalize, nearest)
        self.threads = check_count("threads", threads)
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
        image = allocate_image(len(batch), len(self.channels), self.grid)
        label = allocate_image(len(batch), len(IMPULSES) * self.bins, self.grid)
        if len(self._bodies):
            self._splat(image, 0, self._body_points(arrays))
        contacts = self._contact_points(arrays)
        if len(self._contacts):
            self._splat(image, len(self._bodies), contacts)
        if self.walls:
            self._add_walls(image, arrays)
        self._splat(label, 0, {**contacts, "value": np.ascontiguousarray(arrays["label"])})
        return torch.from_numpy(image), torch.from_numpy(label)

    def _splat(self, image: np.ndarray, channel_offset: int, points: Mapping[str, Any]) -> None:
        """Add points to a zeroed image, from a channel on."""
        if not len(points["point"]):
            return
        origin = np.tile(np.asarray(self.grid.origin, np.float32), (len(image), 1))
        arrays = {**points, "grid_origin": origin, "image": image}
        values = {**self._scalars, "bins": points["bins"], "channel_offset": channel_offset}
        values |= {name: _kernel_array(name, array) for name, array in arrays.items() if name != "bins"}
        Splat(transfer_kernels("warp", "float32"), values, threads=self.threads)()

    def _body_points(self, batch: Mapping[str, np.ndarray]) -> dict[str, Any]:
        """Places and values of the dynamic bodies."""
        body = np.flatnonzero(batch["body_type"] == BodyType.DYNAMIC).astype(np.int32)
        start = np.searchsorted(body, batch["body_start"]).astype(np.int32)
        points = _points(start, len(body), len(self._bodies), 1)
        centre = {"area": 0, "area_point": np.zeros((1, 2), np.float32), "area_weight": np.zeros(1, np.float32)}
        own = {**centre, "body_channel": self._bodies, "area_start": start, "area_body": body}
        self._features("body_features", {**batch, **points, **own})
        return points

    def _contact_points(self, batch: Mapping[str, np.ndarray]) -> dict[str, Any]:
        """Places, bins and values of the contacts; the kernel's places are dropped, as its arms were rounded."""
        a, b = (batch[name].astype(np.int32) for name in ("body_a", "body_b"))
        start = batch["contact_start"].astype(np.int32)
        points = _points(start, len(a), max(len(self._contacts), 1), self.bins)
        place = batch["point"]
        own = {
            "contact_channel": self._contacts,
            "contact_start": start,
            "contact_count": np.diff(start),
            "body_a": a,
            "body_b": b,
            "arm_a": place - batch["position"][a],
            "arm_b": place - batch["position"][b],
            "impulse": batch["start"],
        }
        self._features("contact_features", {**batch, **points, **own})
        return {**points, "point": place}

    def _features(self, name: str, values: Mapping[str, Any]) -> None:
        """Run the kernel that ``dc.Images`` runs."""
        states = len(values["seed"])
        if not len(values["point"]):
            return
        kernel = make_kernels("warp", "grid.images", "float32")[name]
        values = {**values, "world_offset": 0, "flags": np.zeros(states, np.int32)}
        wanted = {argument: values[argument] for argument in argument_names(kernel)}
        bind(kernel, states, {name: _kernel_array(name, value) for name, value in wanted.items()}, "cpu")()

    def _add_walls(self, image: np.ndarray, batch: Mapping[str, np.ndarray]) -> None:
        nodes = [self._wall_nodes(batch, state) for state in range(len(batch["seed"]))]
        size = self.grid.rows * self.grid.columns
        whole = np.concatenate([(s * len(self.channels) + self._mass) * size + n for s, n in enumerate(nodes)])
        image.reshape(-1)[whole] += np.float32(self.walls)

    def _wall_nodes(self, batch: Mapping[str, np.ndarray], state: int) -> np.ndarray:
        """Nodes of the grid, row by row, that a state's static shapes cover; worlds with the same share them."""
        first, last = batch["shape_start"][state : state + 2]
        vertex = batch["vertex_start"][first : last + 1]
        body = batch["shape_body"][first:last]
        own = {
            "shape_body": body - batch["body_start"][state],
            "shape_type": batch["shape_type"][first:last],
            "shape_radius": batch["shape_radius"][first:last],
            "vertex_start": vertex - vertex[0],
            "vertices": batch["vertices"][vertex[0] : vertex[-1]],
            "position": batch["position"][body],
            "angle": batch["angle"][body],
        }
        key = b"".join(values.tobytes() for values in own.values())
        if key not in self._known:
            self._known[key] = self._find_walls(own)
            if len(self._known) > REMEMBERED:
                self._known.popitem(last=False)
        return self._known[key]

    def _find_walls(self, own: dict[str, np.ndarray]) -> np.ndarray:
        """``area.wall_nodes`` of one world in which each static shape is a body."""
        count = len(own["shape_body"])
        own |= {"body_type": np.full(count, int(BodyType.STATIC)), "shape_body": np.arange(count)}
        own["shape_start"] = np.array([0, count])
        shown = _Shapes(own)
        _, row, column = wall_nodes(shown, shown, self.grid)  # type: ignore[arg-type]
        return row.astype(np.int64) * self.grid.columns + column


def _points(start: np.ndarray, count: int, channels: int, bins: int) -> dict[str, Any]:
    """What describes points to a splat, and what a kernel of features fills."""
    return {
        "bins": bins,
        "point_start": start[:-1],
        "point_count": np.diff(start),
        "point": np.zeros((count, 2), np.float32),
        "point_bin": np.zeros(count if bins > 1 else 1, np.int32),
        "value": np.zeros((count, channels), np.float32),
    }


def _kernel_array(name: str, value: Any) -> Any:
    if not isinstance(value, np.ndarray):
        return value
    return kernel_vectors(value, "warp") if name in _VECTORS else kernel_array(value, "warp")


class _Shapes:
    """The static shapes of one world, as ``wall_nodes`` asks a model and a state for them."""

    world_count = 1

    def __init__(self, arrays: Mapping[str, np.ndarray]) -> None:
        self.numpy = arrays.__getitem__
