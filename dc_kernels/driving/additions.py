"""Additions to the worlds of a simulation, built like a scene."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from dc_kernels.model.arrays import Model, State
from dc_kernels.model.assemble import World, as_scalar
from dc_kernels.model.builder import ModelBuilder
from dc_kernels.model.checks import whole
from dc_kernels.model.enums import BodyType
from dc_kernels.model.fields import MODEL, TRAITS
from dc_kernels.model.joints.groups import Joints
from dc_kernels.model.rules import INVERSE
from dc_kernels.model.settings import shown
from dc_kernels.model.validate.geometry import check_geometry

if TYPE_CHECKING:
    from dc_kernels.simulation import Simulation


WORLDS = ("gravity", "origin", "length_scale", "cell_size")


class Added(NamedTuple):
    """Ids of what was added, by the indices that the methods of ``Additions`` returned."""

    bodies: np.ndarray
    """Ids of bodies, (n,) int64; existing bodies keep theirs."""
    shapes: np.ndarray
    """Ids of shapes, (m,) int64."""
    joints: np.ndarray
    """Ids of joints, (k,) int64."""
    new_bodies: np.ndarray
    """Ids of the added bodies alone, (n - existing,) int64: give these to ``remove`` to undo the addition."""


class Fragment(NamedTuple):
    """Additions as arrays, in the simulation's scalar type."""

    fields: dict[str, np.ndarray]
    """Fields of a model, its state and joints by name, worlds one after the other; those that are zero are left out."""
    known: np.ndarray
    """Indices, among the bodies, of those that are there already, (k,)."""
    known_ids: np.ndarray
    """Their ids, (k,)."""
    world: dict[str, np.ndarray]
    """World of the simulation by axis: of each body, shape and joint, (n,)."""
    order: np.ndarray
    """Indices that the calls gave, of the shapes as they stand here, sorted by body, (m,)."""

    @property
    def traits(self) -> set[str]:
        """Axes of ``model.fields.TRAITS`` of which there are fields."""
        return {MODEL[name].per for name in self.fields if name in MODEL} & set(TRAITS)


class Additions(ModelBuilder):
    """Collects bodies, shapes and joints to be added to a simulation.

    It has all methods of a builder; the indices that they return count the additions alone. They are added to the world
    last given to ``to_world``. ``existing`` includes a body of the simulation, so that it may get
    shapes and be joined to others; it keeps its mass, inertia and centre of mass.
    """

    def __init__(self, sim: Simulation, world: int | None = None) -> None:
        """Start empty.

        Args:
            sim: the simulation to add to.
            world: index of the world to add to; None: the only one, or that of ``to_world``.
        """
        super().__init__()
        self.sim = sim
        self._targets: list[int] = []
        self._known: dict[int, int] = {}
        self._indices: dict[int, int] = {}
        if world is not None or sim.model.world_count == 1:
            self.to_world(0 if world is None else world)

    def add_world(self, *args: Any, **settings: Any) -> int:
        """Raise an error: no world can be added to a simulation.

        Raises:
            TypeError: always.
        """
        raise TypeError("a simulation keeps the worlds that it was built with; to_world(index) names one of them")

    def to_world(self, world: int) -> None:
        """Select the world of the simulation to which the following calls add.

        Raises:
            TypeError, ValueError: ``world`` is not the index of a world.
        """
        model = self.sim.model
        index = whole("world", world)
        if not 0 <= index < model.world_count:
            raise ValueError(f"world is {shown(index)}; it must lie in [0, {model.world_count - 1}]")
        if self._targets and self._targets[-1] == index:
            return
        settings = ((0.0, 0.0), tuple(model.numpy("origin")[index].tolist()), float(model.numpy("length_scale")[index]))
        self._worlds.append(World(*settings, self._bodies.count, self._joints.count))  # type: ignore[arg-type]
        self._targets.append(index)
        self._indices = {}

    def existing(self, body: int) -> int:
        """Include an existing body, and return its index among the additions.

        Args:
            body: id of a body of the selected world.

        Raises:
            TypeError, ValueError: it is not the id of a body of that world.
        """
        sim, where = self.sim, f"existing body {shown(body)}"
        self._need_world(where)
        at = int(sim.ids.find("body", whole("body", body), name="body")[0])
        first, last = sim.model.numpy("body_start")[self._targets[-1] : self._targets[-1] + 2].tolist()
        if not first <= at < last:
            raise ValueError(f"body {body} is not of world {self._targets[-1]}, to which the additions go")
        if at not in self._indices:
            model, state = sim.model, sim.state
            angle = float(state.numpy("angle")[at])
            com = model.numpy("center_of_mass")[at].astype(np.float64)
            c, s = np.cos(angle), np.sin(angle)
            place = state.numpy("position")[at].astype(np.float64) - (c * com[0] - s * com[1], s * com[0] + c * com[1])
            place += model.numpy("origin")[self._targets[-1]]
            kind = int(model.numpy("body_type")[at])
            dynamic = kind == BodyType.DYNAMIC
            mass, inertia = (float(model.numpy(name)[at]) if dynamic else np.nan for name in ("mass", "inertia"))
            index = self._bodies.append(*place.tolist(), angle, 0.0, 0.0, 0.0, kind, mass, inertia)
            self._known[index] = int(sim.ids.numpy("body_id")[at])
            self._indices[at] = index
            self._centers[index] = com
        return self._indices[at]

    def _need_world(self, where: str) -> None:
        if not self._targets:
            raise ValueError(f"{where} has no world: call to_world first, or sim.additions(world)")

    def collect(self) -> Fragment:
        """Return all additions as arrays.

        Raises:
            ValueError: see ``ModelBuilder.finalize``; or no world was selected.
        """
        self._need_world("what is added")
        exact, real = self._fields(), self.sim.dtype
        fields = as_scalar(exact, real)
        if self._is_doubtful(exact, fields):
            super().finalize(real, backend="numpy")  # which takes longer, and says what is wrong
        if fields["shape_type"].any():  # as the scalar some corners may be one
            check_geometry(fields, "model.")
        targets = np.array(self._targets, np.int64)
        world = {axis: np.repeat(targets, np.diff(fields[f"{axis}_start"])) for axis in ("body", "shape", "joint")}
        known, ids = (np.array(list(part), np.int64) for part in (self._known, self._known.values()))
        owner = self._shapes.collect()[:, 0]
        return Fragment(fields, known, ids, world, np.argsort(owner, kind="stable"))

    def _is_doubtful(self, exact: dict[str, np.ndarray], fields: dict[str, np.ndarray]) -> bool:
        """Whether a number is none, or too large or too small, as the simulation's scalar."""
        names = [name for name, value in exact.items() if value.dtype.kind == "f" and name not in WORLDS]
        one, other = (np.concatenate([arrays[name].reshape(-1) for name in names]) for arrays in (exact, fields))
        inverses = max(fields[name].max(initial=0) for name in ("inv_mass", "inv_inertia"))
        return bool(not np.isfinite(other).all() or ((other == 0) & (one != 0)).any() or inverses > INVERSE.high)

    def finalize(self, *args: Any, **settings: Any) -> tuple[Model, State, Joints]:
        """Raise an error: additions are not a scene.

        Raises:
            TypeError: always.
        """
        raise TypeError("additions are no scene of their own; sim.add(additions) adds them")
