"""Images of a data set's states, equal to those of ``dc.Images`` in a simulation."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import fields
from typing import TYPE_CHECKING, Any

import numpy as np

import dc_kernels as dc
from dc_kernels.grid.area import body_centers, covered_nodes
from dc_kernels.grid.scene import Nodes, Scene, SceneSplat
from dc_kernels.grid.splat import allocate_image
from dc_kernels.model.arrays import kernel_array
from dc_kernels.model.enums import BodyType
from dc_kernels.runtime.imports import require
from dc_kernels.runtime.inputs import check_count

if TYPE_CHECKING:
    from pipeline.data.dataset import Batch

torch = require("torch", "pipeline")

REMEMBERED = 4096  # sets of wall nodes


class Splatter:
    """Makes images of batches: those of ``dc.Images`` with the same specification, for the states of a batch.

    The image of the label is that of ``Images.impulse_image``. It works on the CPU.

    Attributes:
        spec: grid, channels and stencil.
        channels: names in the order of the image.
    """

    def __init__(self, spec: dc.ImageSpec, *, threads: int = 1) -> None:
        """Check the specification.

        Args:
            spec: grid, channels and stencil.
            threads: number of threads that share the states; the bits do not depend on it.

        Raises:
            ValueError: bodies are splatted over their area: a data set has only the shapes of static bodies.
        """
        if spec.area:
            raise ValueError("spec.area is True; a data set keeps no shapes of bodies that move")
        self.spec, self.channels = spec, spec.channels
        self.threads = check_count("threads", threads)
        self._known: OrderedDict[bytes, tuple[np.ndarray, np.ndarray]] = OrderedDict()

    def __call__(self, batch: Batch) -> tuple[Any, Any]:
        """Return input (B, channels, rows, columns) and label (B, 2 bins, rows, columns) of a batch, float32."""
        arrays = {f.name: getattr(batch, f.name).numpy() for f in fields(batch)}
        image = allocate_image(len(batch), len(self.channels), self.spec.grid)
        label = allocate_image(len(batch), self.spec.impulse_channels, self.spec.grid)
        splat = SceneSplat(
            self.spec,
            _scene(arrays),
            kernel_array(image, "warp"),
            bodies=body_centers(arrays["body_type"], arrays["body_start"], np.dtype(np.float32)),
            walls=self._walls(arrays) if self.spec.wall_channel >= 0 else None,
            place=arrays["point"],  # the kernels' own would differ by the round-off of their arms
            threads=self.threads,
        )
        splat()
        impulse = kernel_array(np.ascontiguousarray(arrays["label"]), "warp")
        splat.program(splat.impulse_stages(impulse, kernel_array(label, "warp")))()
        return torch.from_numpy(image), torch.from_numpy(label)

    def _walls(self, batch: Mapping[str, np.ndarray]) -> Nodes:
        """Nodes that the static shapes of each state cover."""
        found = [self._state_walls(batch, state) for state in range(len(batch["seed"]))]
        world = np.repeat(np.arange(len(found), dtype=np.int32), [len(row) for row, _ in found])
        row, column = (np.concatenate([np.zeros(0, np.int32), *parts]) for parts in zip(*found))
        return world, row, column

    def _state_walls(self, batch: Mapping[str, np.ndarray], state: int) -> tuple[np.ndarray, np.ndarray]:
        """Rows and columns of the nodes that a state's static shapes cover; states with equal ones share them."""
        first, last = batch["shape_start"][state : state + 2]
        vertex = batch["vertex_start"][first : last + 1]
        body = batch["shape_body"][first:last]
        own = {
            "shape_type": batch["shape_type"][first:last],
            "shape_radius": batch["shape_radius"][first:last],
            "vertex_start": vertex - vertex[0],
            "vertices": batch["vertices"][vertex[0] : vertex[-1]],
            "position": batch["position"][body],
            "angle": batch["angle"][body],
        }
        key = b"".join(values.tobytes() for values in own.values())
        if key not in self._known:
            # as one world in which each shape has a body of its own
            count = len(body)
            body_type, shape_start = np.full(count, int(BodyType.STATIC)), np.array([0, count])
            given = {**own, "shape_body": np.arange(count), "body_type": body_type, "shape_start": shape_start}
            self._known[key] = covered_nodes(given, self.spec.grid)[1:]
            if len(self._known) > REMEMBERED:
                self._known.popitem(last=False)
        return self._known[key]


def _scene(batch: Mapping[str, np.ndarray]) -> Scene:
    """The states of a batch as worlds."""
    a, b = (batch[name].astype(np.int32) for name in ("body_a", "body_b"))
    start = batch["contact_start"].astype(np.int32)
    states = len(batch["seed"])
    contacts = {
        **{name: batch[name] for name in ("normal", "gap", "friction", "age")},
        "contact_start": start,
        "contact_count": np.diff(start),
        "body_a": a,
        "body_b": b,
        "arm_a": batch["point"] - batch["position"][a],
        "arm_b": batch["point"] - batch["position"][b],
        "impulse": batch["start"],
    }
    motion = {name: batch[name] for name in ("position", "angle", "velocity", "angular_velocity")}
    return Scene(
        model={name: batch[name] for name in ("mass", "inertia")},
        state={**motion, "flags": np.zeros(states, np.int32)},
        contacts=contacts,
        worlds=states,
        room=len(a),
        backend="warp",
        dtype="float32",
    )
