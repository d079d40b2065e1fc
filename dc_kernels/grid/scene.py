"""The images of scenes as a row of stages: of a simulation, and of a data set's states."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from dc_kernels.grid.area import AreaPoints
from dc_kernels.grid.fields import AREA, WALLS
from dc_kernels.grid.image_spec import ImageSpec
from dc_kernels.grid.splat import Splat, points_group
from dc_kernels.model.arrays import kernel_array
from dc_kernels.model.dtypes import FLOATS
from dc_kernels.model.fields import CONTACTS, MODEL, STATE
from dc_kernels.runtime.backends import kernel_file, make_kernels
from dc_kernels.runtime.program import Kernel, Program, Stage

Nodes = tuple[np.ndarray, np.ndarray, np.ndarray]
"""World, row and column of nodes, (n,) int32 each, sorted by world."""


@dataclass(frozen=True)
class Scene:
    """Arrays of W worlds by name, as in ``model.fields``; of each group those that images show."""

    model: Mapping[str, Any]
    """mass and inertia of the bodies."""
    state: Mapping[str, Any]
    """position, angle, velocity, angular_velocity, flags."""
    contacts: Mapping[str, Any]
    """All but key, restitution, color and contact_dt."""
    worlds: int
    """W."""
    room: int
    """Slots of contacts."""
    backend: str
    """Of the arrays; numpy arrays will do for either."""
    dtype: str
    """Their scalar type."""


class SceneSplat:
    """Splats the bodies and the contacts of a scene onto an image, whatever its arrays hold at the time of the call.

    Attributes:
        missed_bodies, missed_contacts: points of each world that reached no node in the last call, (W,).
        contact_points: where the contacts are, as ``gather`` takes points; filled by ``contact_stage``.
    """

    def __init__(
        self,
        spec: ImageSpec,
        scene: Scene,
        image: Any,
        *,
        bodies: AreaPoints,
        walls: Nodes | None = None,
        place: np.ndarray | None = None,
        threads: int = 1,
    ) -> None:
        """Bind all stages.

        Args:
            spec: of the image.
            scene: what is shown.
            image: (W, channels, rows, columns), zeroed, as the kernels take it.
            bodies: points that the bodies are splatted at, of ``area.area_points`` or ``area.center_points``.
            walls: nodes that ``spec.walls`` is added to.
            place: the contacts' places, (room, 2) [m]; None: position[body_a] + arm_a.
            threads: that worlds are shared by.
        """
        self.spec, self.scene, self.image, self.threads = spec, scene, image, threads
        self._kernels = make_kernels(scene.backend, "grid.images", scene.dtype)
        self._state = self._group("state", STATE, scene.state)
        self._contacts = self._group("contacts", CONTACTS, scene.contacts)
        self.missed_bodies = self.missed_contacts = np.zeros(scene.worlds, np.int32)
        self._place_contacts(place)
        stages: list[Stage] = []
        if spec.body_channels:
            stages += self._body_stages(bodies, walls)
        if spec.contact_channels:
            value = self._zeros((scene.room, len(spec.contact_channels)))
            splat = self._splat(self.contact_points, value, image, spec.bins, len(spec.body_channels))
            self.missed_contacts = splat.missed
            stages += [self.contact_stage(spec.contact_codes, value), splat]
        self._program = self.program(stages)

    def __call__(self) -> None:
        """Fill the image."""
        self._program()

    def program(self, stages: list[Stage]) -> Program:
        """Return a call that runs stages over the worlds of the scene."""
        return Program(stages, self.scene.worlds, backend=self.scene.backend, threads=self.threads)

    def contact_stage(self, codes: np.ndarray | None = None, value: Any = None) -> Kernel:
        """Return what finds places and bins of the contacts, and values of channels.

        Args:
            codes: of the channels; None: none.
            value: (room, channels), as the kernels take it.
        """
        arguments = {
            "bins": self.spec.bins,
            "channel": self._array(np.zeros(0, np.int32) if codes is None else codes),
            "state": self._state,
            "contacts": self._contacts,
            "points": self._found,
            "value": self._zeros((1, 1)) if value is None else value,
        }
        return Kernel(self._kernels["contact_features"], arguments)

    def impulse_stages(self, impulse: Any, image: Any) -> list[Stage]:
        """Return what splats impulses of the contacts onto an image.

        Args:
            impulse: (room, 2), as the kernels take it [N s].
            image: (W, spec.impulse_channels, rows, columns), zeroed, as the kernels take it.
        """
        return [self.contact_stage(), self._splat(self.contact_points, impulse, image, self.spec.bins)]

    def _place_contacts(self, place: np.ndarray | None) -> None:
        room, bins = self.scene.room, self.spec.bins
        arrays = {
            "start": self.scene.contacts["contact_start"],
            "count": np.zeros(self.scene.worlds, np.int32),
            "place": np.zeros((room, 2), FLOATS[self.scene.dtype]),
            "bin": np.zeros(room if bins > 1 else 1, np.int32),
        }
        self._found = self._points(arrays)
        self.contact_points = self._found if place is None else self._points({**arrays, "place": place})

    def _body_stages(self, bodies: AreaPoints, walls: Nodes | None) -> list[Stage]:
        spec, worlds, dtype = self.spec, self.scene.worlds, FLOATS[self.scene.dtype]
        count = len(bodies.body)
        points = self._points(
            {
                "start": bodies.start,
                "count": np.zeros(worlds, np.int32),
                "place": np.zeros((count, 2), dtype),
            }
        )
        value = self._zeros((count, len(spec.body_channels)))
        area = {
            "spread": int(spec.area),
            "start": bodies.start,
            "body": bodies.body,
            "place": bodies.point,
            "weight": bodies.weight,
        }
        arguments = {
            "channel": self._array(spec.body_codes),
            "area": self._group("area", AREA, area),
            "model": self._group("model", MODEL, self.scene.model),
            "state": self._state,
            "points": points,
            "value": value,
        }
        splat = self._splat(points, value, self.image, 1)
        self.missed_bodies = splat.missed
        stages: list[Stage] = [Kernel(self._kernels["body_features"], arguments), splat]
        if walls is not None and spec.wall_channel >= 0:
            world, row, column = walls
            nodes = {
                "value": float(spec.walls or 0.0),
                "channel": spec.wall_channel,
                "start": np.searchsorted(world, np.arange(worlds + 1)).astype(np.int32),
                "row": row,
                "column": column,
            }
            group = self._group("walls", WALLS, nodes)
            # each splat clears the walls' nodes, so that they can be added anew
            stages = [splat.clear_also(world, row, column), *stages]
            stages.append(Kernel(self._kernels["add_walls"], {"walls": group, "image": self.image}))
        return stages

    def _splat(self, points: Any, value: Any, image: Any, bins: int, offset: int = 0) -> Splat:
        return Splat(
            self.spec.stencil,
            self.spec.grid,
            points,
            value,
            image,
            bins=bins,
            channel_offset=offset,
            backend=self.scene.backend,
            threads=self.threads,
        )

    def _group(self, name: str, table: Mapping[str, Any], values: Mapping[str, Any]) -> Any:
        return kernel_file(self.scene.backend, "groups").group(name, self.scene.dtype, table, values)

    def _points(self, arrays: Mapping[str, Any]) -> Any:
        return points_group(self.spec.grid, self.scene.worlds, self.scene.backend, self.scene.dtype, **arrays)

    def _zeros(self, shape: tuple[int, ...]) -> Any:
        return self._array(np.zeros(shape, FLOATS[self.scene.dtype]))

    def _array(self, values: np.ndarray) -> Any:
        return kernel_array(values, self.scene.backend)
