"""Methods of a simulation that add and remove bodies, shapes and joints between steps."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

import numpy as np

from dc_kernels.binding import Binding
from dc_kernels.driving import population
from dc_kernels.driving.additions import Added, Additions
from dc_kernels.driving.ids import KINDS, Ids
from dc_kernels.driving.reset import Reset
from dc_kernels.model.arrays import Model
from dc_kernels.model.config import SolverConfig
from dc_kernels.model.joints.groups import Joints
from dc_kernels.model.worlds import Segments, WorldSegments
from dc_kernels.phases import Phases
from dc_kernels.runtime.capture import refuse_recording
from dc_kernels.runtime.inputs import check_whole
from dc_kernels.runtime.shards import shards_of
from dc_kernels.runtime.threads import OneCaller
from dc_kernels.storage import Moves, Storage

PAIRS, CONTACTS = 4.0, 2.5  # reserved at first for each shape and each body


class Populated(Phases):
    """The methods of a simulation that add and remove bodies, shapes and joints (``driving/population.py``)."""

    model: Model
    joints: Joints
    backend: str
    schedule: str
    threads: int
    most_threads: int
    """Threads that were asked for; ``threads`` are those of them that pay for the worlds and bodies that there are."""
    calls: OneCaller
    variant: str
    kernels: dict[str, Any]
    _binding: Binding
    _in_turn: bool
    _segments: WorldSegments
    _reset: Reset | None
    given_ids: Ids | None = None
    """Ids of what is in the slots; None: nobody asked for them yet, and all have their indices."""

    def _choose_kernels(self, config: SolverConfig) -> None:
        """Take the kernels that the model and the settings need."""
        raise NotImplementedError

    def adapt_to_model(self, stale: bool) -> None:
        """Take the kernels and the coefficients of a model that has changed; ``stale``: graphs are to be made anew."""
        raise NotImplementedError

    def _divide(self, threads: int) -> int:
        """Divide the worlds into shards, for so many threads; how many solves may then be in flight together."""
        model, by_world = self.model, self.schedule == "world"
        tiles = by_world and self.device == "cpu"
        sizes = model.world_count, model.body_count
        self._shards = shards_of(self.backend, *sizes, threads, teams=by_world, tiles=tiles)
        self.most_threads = threads
        self.__dict__["threads"] = self._shards.over_worlds + self._shards.helpers  # which nobody else may set
        # on a CPU a shard of the host solves world after world; threads of the backend's own share one shard
        self._in_turn = tiles and self._shards.parts == len(self._shards.ranges)
        return self._shards.parts if self._in_turn else model.world_count

    def additions(self, world: int | None = None) -> Additions:
        """Collect bodies, shapes and joints for ``add``.

        Args:
            world: index of the world to add to; None: the only one, or that of ``Additions.to_world``.

        Raises:
            TypeError, ValueError: ``world`` is not the index of a world.
        """
        return Additions(self, world)  # type: ignore[arg-type]

    def add(self, additions: Additions) -> Added:
        """Add bodies, shapes and joints, which take part from the next step on.

        Each takes the first empty slot of its world. If there are not enough, the worlds get more: arrays are
        reallocated, earlier views keep the old values, and ``layout_version`` changes, as for joints.
        Existing bodies keep their contacts, impulses and ids. The length scale of a world does not change.

        Args:
            additions: the result of ``additions``; it may be added more than once.

        Returns:
            The ids of everything added, by the indices that the methods of ``additions`` returned.

        Raises:
            TypeError, ValueError: an addition is invalid (the error names body, shape or joint and limit); the call is
                between the phases of a step; another simulation shares the model or the joints. Nothing has changed.
            OverflowError: there are not enough slots and ``on_overflow`` is "raise".
            RuntimeError: it is called within ``wp.ScopedCapture``.

        Examples:
            >>> import dc_kernels as dc
            >>> builder = dc.ModelBuilder()
            >>> world = builder.add_world()
            >>> ball = builder.add_discs([(0.0, 2.0)], 0.5)
            >>> sim = dc.Simulation(*builder.finalize())
            >>> more = sim.additions()
            >>> crate = more.add_body((3.0, 2.0))
            >>> corner = more.add_box(crate, 0.5, 0.5)
            >>> added = sim.add(more)
            >>> sim.remove(bodies=ball)
            >>> sim.ids.numpy("body_id")[sim.index(bodies=added.bodies)].tolist()
            [1]
        """
        with self._populating("add"):
            return population.add(self, additions)  # type: ignore[arg-type]

    def remove(self, *, bodies: Any = (), shapes: Any = (), joints: Any = ()) -> None:
        """Remove bodies with their shapes and joints, shapes, and joints; bodies that touched them wake.

        Bodies that lose shapes keep their masses and centres of mass. The slots become empty.

        Args:
            bodies: ids, (n,), or one.
            shapes: ids, (m,), or one.
            joints: ids, (k,), or one.

        Raises:
            TypeError, ValueError, RuntimeError: see ``add``; or an id was removed before, or never existed.
        """
        with self._populating("remove"):
            population.remove(self, bodies, shapes, joints)  # type: ignore[arg-type]

    def reserve(self, *, bodies: int = 0, shapes: int = 0, vertices: int = 0) -> None:
        """Reserve empty slots in each world, so that ``add`` need not reallocate arrays.

        Args:
            bodies: smallest number of empty slots of bodies.
            shapes: smallest number of empty slots of shapes.
            vertices: number of vertices of these shapes together: 1 for a disc, 2 for a capsule, 4 for a segment; at
                least one each.

        Raises:
            TypeError, ValueError, RuntimeError: see ``add``.
            MemoryError: the slots do not fit into the free memory.
        """
        counts = [
            check_whole(name, value) for name, value in (("bodies", bodies), ("shapes", shapes), ("vertices", vertices))
        ]
        with self._populating("reserve"):
            population.reserve(self, *counts)  # type: ignore[arg-type]

    def index(self, *, bodies: Any = None, shapes: Any = None, joints: Any = None) -> np.ndarray:
        """Return the present indices in the arrays of bodies, shapes or joints, (n,) int64, by their ids.

        Those that a simulation was built with have the builder's indices as ids. A body or shape
        keeps its index until arrays are reallocated (``layout_version``), and in the first world always.

        Args:
            bodies: ids of bodies, (n,), or one; give exactly one of the three arguments.
            shapes: ids of shapes.
            joints: ids of joints.

        Raises:
            TypeError, ValueError: an id was removed, or never existed; or more than one argument is given.
        """
        given = {kind: ids for kind, ids in zip(KINDS, (bodies, shapes, joints)) if ids is not None}
        if len(given) != 1:
            raise ValueError("index() takes the ids of bodies, of shapes, or of joints")
        ((kind, ids),) = given.items()
        return self.ids.find(kind, ids)

    @property
    def ids(self) -> Ids:
        """Ids by slot of bodies and shapes, negative in empty slots, and ids of joints."""
        if self.given_ids is None:
            self.given_ids = Ids.built(self.model)
        return self.given_ids

    @contextlib.contextmanager
    def _populating(self, what: str) -> Iterator[None]:
        """What is true while bodies, shapes or joints come or go.

        Raises:
            ValueError, RuntimeError: where they cannot.
        """
        refuse_recording(what, "it allocates and writes at once")
        with self.calls:
            if self._turn.ran != "advance":
                raise ValueError(
                    f"{what}() in the middle of a step: finish it with solve() and advance(), or take a step"
                )
            if len({*self.model.users, *self.joints.users}) > 1:
                raise ValueError(
                    f"{what}() of a simulation whose model or joints another one has too; make one of them of copies: "
                    "dc.Simulation(model.copy(), state.copy(), joints.copy())"
                )
            yield

    def take_layout(self, moves: Moves) -> None:
        """Go on with groups that were laid out anew; other stages are made for them."""
        self._segments = WorldSegments(self.model.memory, self.joints.memory("joint_row_start"))
        self._choose_kernels(self._config)
        before, peak = self.storage, self._shards.peak.max(axis=0)
        at_once = self._divide(self.most_threads)  # as that of a copy: shards go by the bodies that there are
        self._shards.peak[-1] = peak
        self.storage = Storage(
            self.model,
            self.joints,
            self._config,
            variant=self.variant,
            pairs=PAIRS,
            contacts=CONTACTS,
            shards=self._shards.parts,
            at_once=at_once,
        )
        self.storage.take_over(before, moves, self._config)
        self.storage.pass_over_empty({"body": self.ids.numpy("body_id"), "shape": self.ids.numpy("shape_id")})
        self._binding = Binding(self.kernels, self.model, self._shards)
        self._bind_all()

    def take_joints(self, moves: Moves) -> None:
        """Go on with joints that were laid out anew, and solver rows for them."""
        self._segments = WorldSegments(self.model.memory, self.joints.memory("joint_row_start"))
        self._choose_kernels(self._config)
        self.storage.link(moves, self.variant, self._config)
        self._binding.kernels = self.kernels
        self._bind_all()

    def take_change(self, same: bool) -> None:
        """Go on with other bodies and shapes in the slots; ``same``: the kernels of before do for them."""
        self.storage.changes += 1  # which images look at
        self._reset = None
        if not same or self._binding.stale:
            self.adapt_to_model(stale=False)

    def take_vertices(self, start: np.ndarray) -> None:
        """Know which vertices are whose where some have moved; ``start``: first of each world, (W + 1,)."""
        self._segments["vertex"] = Segments.of(start)
