"""The images of a simulation's bodies and contacts that a network reads, and its answer brought back to the contacts.

images = dc.Images(sim, Grid.thesis())
images.splat()                            # 4 channels of bodies, 2 of contacts
output = network(images.tensor())         # (W, 2, rows, columns), no copy either way
images.start_from(output)                 # impulses that the solver starts from
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from dc_kernels.grid.area import area_points, center_points, wall_nodes
from dc_kernels.grid.channels import BODY_CHANNELS, CONTACT_CHANNELS, IMPULSES, channel_codes
from dc_kernels.grid.grid import Grid
from dc_kernels.grid.layout import TILE_COLUMNS, TILE_ROWS
from dc_kernels.grid.transfer import BAND, Splat, Stencil, allocate_image, chunks_of, stencil_scalars, transfer_kernels
from dc_kernels.model.arrays import kernel_array, kernel_vectors, to_numpy, to_torch
from dc_kernels.runtime.backends import make_kernels
from dc_kernels.runtime.inputs import check_count
from dc_kernels.runtime.interop import address
from dc_kernels.runtime.program import Fed, Kernel, Program, Stage

if TYPE_CHECKING:
    from dc_kernels.simulation import Simulation, Start


class Images:
    """Persistent images of all worlds, filled from the simulation's present state and contacts.

    Channels are those of ``channels.BODY_CHANNELS`` and ``CONTACT_CHANNELS``: first the bodies', then the contacts', of
    each bin of normal directions in turn. A body is splatted at its centre of mass or over its area, a contact at
    position[body_a] + arm_a: between ``collide`` and ``advance`` that is its place, afterwards that of the step before
    carried along by body A. Velocities are those of ``state``, without what the step in flight applies. A flagged world
    has neither bodies nor contacts. Static bodies appear as walls only, kinematic ones not at all.

    Worlds are shared by threads; the bits do not depend on their number. On the CPU only.

    Attributes:
        channels: names in the order of the image; "normal_x/3" is that of bin 3 where there are several.
        image: (W, channels, rows, columns), of the simulation's dtype and backend; its memory never moves.
        missed_bodies, missed_contacts: points of each world that reached no node in the last splat, (W,).
    """

    def __init__(
        self,
        sim: Simulation,
        grid: Grid,
        *,
        bodies: Sequence[str] = ("mass", "velocity_x", "velocity_y", "omega"),
        contacts: Sequence[str] = ("normal_x", "normal_y"),
        kernel: Stencil = "poly6",
        h: float | None = None,
        normalize: Literal["particle", "sum"] = "particle",
        nearest: bool = True,
        bins: int = 1,
        walls: float | None = 100.0,
        area: bool = False,
        threads: int | None = None,
    ) -> None:
        """Allocate the image and find the walls.

        Args:
            sim: whose state and contacts are shown.
            grid: relative to each world's origin.
            bodies: channels of bodies; may be empty.
            contacts: channels of contacts; may be empty.
            kernel: name of the stencil.
            h: support radius of a radial kernel [m]; None: 2 spacings.
            normalize: see ``transfer``.
            nearest: give a point that reaches no node to its nearest one, under "particle".
            bins: parts of the half circle of normal directions (n and -n are one) that contacts are kept apart in;
                bin b is centred on the angle b pi / bins.
            walls: mass of the nodes that static shapes cover (``area.wall_nodes``), as they stand now, on top of what
                bodies add there [kg]; None or without a channel "mass": none.
            area: splat bodies over their area, in cells of a spacing (``area.area_points``).
            threads: None: as many as the simulation has.

        Raises:
            ValueError: for an unknown or repeated channel, a setting out of range, or a simulation on a GPU.
        """
        if sim.device != "cpu":
            raise ValueError(f"sim.device is {sim.device!r}; Images runs on the CPU")
        threads = sim.threads if threads is None else check_count("threads", threads)
        bins = check_count("bins", bins)
        if walls is not None and not 0.0 <= walls < float("inf"):
            raise ValueError(f"walls is {walls!r}; it must be None, or finite and not negative [kg]")
        self.sim, self.grid, self.bins, self.h, self.nearest = sim, grid, bins, h, nearest
        self.kernel: Stencil = kernel
        self.normalize: Literal["particle", "sum"] = normalize
        self._scalars = stencil_scalars(grid, kernel, h, normalize, nearest)
        self._body_codes = channel_codes("bodies", bodies, BODY_CHANNELS)
        self._contact_codes = channel_codes("contacts", contacts, CONTACT_CHANNELS)
        if not bodies and not contacts:
            raise ValueError("bodies and contacts are both empty; an image needs a channel")
        binned = [f"{name}/{b}" for b in range(bins) for name in contacts] if bins > 1 else contacts
        self.channels = (*bodies, *binned)
        self.worlds = sim.model.world_count
        self.threads = max(1, min(threads, self.worlds))
        self._table = {
            **transfer_kernels(sim.backend, sim.dtype.name),
            **make_kernels(sim.backend, "grid.images", sim.dtype.name),
        }
        self._image = allocate_image(self.worlds, len(self.channels), grid, sim.dtype)
        self._impulses: Any = None
        self._splat_impulses: Program | None = None
        self.image = kernel_array(self._image, sim.backend)
        self.missed_bodies = self.missed_contacts = np.zeros(self.worlds, np.int32)
        origin = np.tile(np.asarray(grid.origin, sim.dtype), (self.worlds, 1))
        self._origin = kernel_vectors(origin, sim.backend)
        points = area_points(sim.model, grid.spacing) if area else center_points(sim.model)
        self._body_values = {
            "area": int(area),
            "body_channel": self._array(self._body_codes),
            "area_start": self._array(points.start),
            "area_body": self._array(points.body),
            "area_point": kernel_vectors(points.point, sim.backend),
            "area_weight": self._array(points.weight),
        }
        self._wall_channel = list(bodies).index("mass") if walls and "mass" in bodies else -1
        if self._wall_channel >= 0:
            self._find_walls(float(walls or 0.0))
        self._bind()

    # ------------------------------------------------------------------ the image

    def numpy(self) -> np.ndarray:
        """The image as numpy, the same memory."""
        return self._image

    def tensor(self) -> Any:
        """The image as a torch tensor, the same memory.

        Raises:
            ImportError: naming the extra, without torch.
        """
        return to_torch(self._image)

    def splat(self) -> Any:
        """Fill the image from the present state and contacts, and return it."""
        if self._bound != (self.sim.layout_version, self.sim.config):
            self._bind()
        self._splat()
        return self.image

    def impulse_image(self) -> Any:
        """The present impulses as an image (W, 2 bins, rows, columns), what a network learns; always the same memory.

        Its channels are the normal and tangential impulse [N s] of each bin in turn, as ``start_from`` reads them.
        """
        if self._bound != (self.sim.layout_version, self.sim.config):
            self._bind()
        if self._splat_impulses is None:
            if self._impulses is None:
                values = allocate_image(self.worlds, len(IMPULSES) * self.bins, self.grid, self.sim.dtype)
                self._impulses = self._array(values)
            to_numpy(self._impulses).fill(0)
            splat = self._splat_of(self._contacts, self._impulse, 0, self.bins, self._impulses)
            self._splat_impulses = self._program([self._contact_stage(), splat])
        self._splat_impulses()
        return self._impulses

    # ------------------------------------------------------------------ back to the contacts

    def gather(
        self,
        image: Any,
        *,
        at: Literal["contacts", "bodies"] = "contacts",
        kernel: Stencil | None = None,
        h: float | None = None,
        reverse: bool = False,
    ) -> Any:
        """An image at the present contacts, or at the bodies' centres of mass.

        Args:
            image: (W, C bins, rows, columns), or (W, C, rows, columns) at bodies, which have no bins; for any C, of the
                simulation's dtype, contiguous, on the CPU: a torch tensor, numpy array or ``wp.array``, read where it
                lies. Values that are not finite are passed on.
            at: "contacts", or "bodies", static and kinematic ones too.
            kernel: stencil; None: "bilinear", or that of the splat with ``reverse``.
            h: support radius of a radial kernel [m]; None: that of the splat.
            reverse: share what a node holds among the points that reach it (reverse SPH, see ``transfer.gather``).

        Returns:
            (slots, C), a row for each slot of ``sim.contacts``: those of world w begin at contact_start[w], and
            contact_count[w] of them are in use; or (bodies, C). The same memory each time, until the simulation's
            room grows.

        Raises:
            ValueError: for an image of another type, dtype, shape, layout or device, or an unknown kernel.
        """
        if at not in ("contacts", "bodies"):
            raise ValueError(f"at is {at!r}; it must be 'contacts' or 'bodies'")
        return self._gather(image, at, None, kernel, h, reverse)

    def start_from(
        self, image: Any, *, kernel: Stencil | None = None, h: float | None = None, reverse: bool = False
    ) -> None:
        """Write an image of impulses (W, 2 bins, rows, columns) to ``sim.contacts.impulse``; arguments as ``gather``.

        Raises:
            ValueError: see ``gather``.
        """
        self._gather(image, "contacts", len(IMPULSES), kernel, h, reverse)

    def starter(self, predict: Callable[[Images], Any], **options: Any) -> Start:
        """A start strategy for ``sim.step(dt, start=...)``: splat, predict, start from the answer.

        Args:
            predict: called with these images after the splat; returns an image of impulses for ``start_from``.
            **options: kernel, h and reverse of ``start_from``.
        """

        def start(sim: Simulation) -> None:
            if sim is not self.sim:
                raise ValueError("the images are those of another simulation")
            self.splat()
            self.start_from(predict(self), **options)

        return start

    def _gather(
        self, image: Any, at: str, channels: int | None, kernel: Stencil | None, h: float | None, reverse: bool
    ) -> Any:
        if self._bound != (self.sim.layout_version, self.sim.config):
            self._bind()
        pointer, shape = address(image, "image", self.sim.dtype)
        bins = self._points[at]["bins"]
        count = channels or (shape[1] // bins if len(shape) > 1 else 0)
        if count < 1 or shape != (self.worlds, count * bins, *self.grid.shape):
            wanted = f"{channels * bins}" if channels else f"C * {bins}"
            raise ValueError(
                f"image has shape {shape}; it must be ({self.worlds}, {wanted}, {self.grid.rows}, {self.grid.columns})"
            )
        key = (at, count, channels is not None, kernel, h, reverse)
        if key not in self._gathers:
            self._gathers[key] = self._bind_gather(*key)
        run, value = self._gathers[key]
        run(image, pointer)
        return value

    def _bind_gather(
        self, at: str, channels: int, to_impulse: bool, kernel: Stencil | None, h: float | None, reverse: bool
    ) -> tuple[Callable[[Any, int], None], Any]:
        """What gathers from an image at an address, and where to."""
        if reverse and self.normalize != "particle":
            raise ValueError(f"normalize is {self.normalize!r}; reverse needs 'particle'")
        if kernel is None:
            kernel = self.kernel if reverse else "bilinear"
        scalars = stencil_scalars(self.grid, kernel, self.h if h is None else h, self.normalize, self.nearest)
        points, bins = self._points[at], self._points[at]["bins"]
        stages: list[Stage] = [self._contact_stage()] if at == "contacts" else []
        room, most = self._room, int(self.sim.storage.contact_room.max())
        if at == "bodies":
            room, most = self.sim.model.body_count, int(to_numpy(points["point_count"]).max(initial=0))
        value = self._impulse if to_impulse else self._array(np.zeros((room, channels), self.sim.dtype))
        chunks = chunks_of(most)
        values = {**points, **scalars, "value": value, "chunks": chunks, "channel_offset": 0}
        gather = Kernel(self._table["gather_points"], values, chunks)
        if reverse:
            # a copy, as what the caller's image holds is not ours to change
            share = allocate_image(self.worlds, channels * bins, self.grid, self.sim.dtype)
            weights = self._array(allocate_image(self.worlds, bins, self.grid, self.sim.dtype))
            ones, shares = self._array(np.ones((room, 1), self.sim.dtype)), self._array(share)
            shared = self._program(
                [
                    *stages,
                    self._splat_of({**points, **scalars}, ones, 0, bins, weights),
                    Kernel(self._table["divide_image"], {"weight": weights, "image": shares}),
                    gather._replace(values={**values, "image": shares}),
                ]
            )

            def run_reverse(image: Any, pointer: int) -> None:
                np.copyto(share, to_numpy(image))
                shared()

            return run_reverse, value
        locate = self._program(stages)
        any_image = self._array(np.zeros((1, 1, *self.grid.shape), self.sim.dtype))
        fed = Fed(
            gather._replace(values={**values, "image": any_image}),
            "image",
            self.worlds,
            backend=self.sim.backend,
            threads=self.threads,
        )

        def run(image: Any, pointer: int) -> None:
            locate()
            fed(image, pointer)

        return run, value

    # ------------------------------------------------------------------ set-up

    def _program(self, stages: Sequence[Stage]) -> Program:
        return Program(stages, self.worlds, backend=self.sim.backend, threads=self.threads)

    def _array(self, values: np.ndarray) -> Any:
        return kernel_array(values, self.sim.backend)

    def _find_walls(self, value: float) -> None:
        """Wall nodes, and the bands of the image that hold any."""
        grid, dtype = self.grid, np.int32
        world, row, column = wall_nodes(self.sim.model, self.sim.state, grid)
        bands = np.zeros((self.worlds, -(-grid.rows // BAND)), dtype)
        bands[world, row // BAND] = 1
        across = -(-grid.columns // TILE_COLUMNS)
        tiles = across * -(-grid.rows // TILE_ROWS)
        self._wall_tiles = np.unique(world * tiles + row // TILE_ROWS * across + column // TILE_COLUMNS)
        self._wall_values = {
            "wall_value": value,
            "wall_channel": self._wall_channel,
            "wall_start": self._array(np.searchsorted(world, np.arange(self.worlds + 1)).astype(dtype)),
            "wall_row": self._array(row),
            "wall_column": self._array(column),
            "wall_band": self._array(bands),
        }

    def _bind(self) -> None:
        """Bind everything to the simulation's present arrays and settings."""
        sim = self.sim
        self._bound = (sim.layout_version, sim.config)
        self._room = room = sim.contacts.sizes["contact"]
        groups = (sim.model, sim.state, sim.contacts, sim.motion)
        arrays = {name: group.array(name) for group in groups for name in group.table}
        common = {**arrays, **self._scalars, "grid_origin": self._origin}
        self._contacts: dict[str, Any] = {
            **common,
            "bins": self.bins,
            "point_start": sim.contacts.contact_start,
            "point_count": self._array(np.zeros(self.worlds, np.int32)),
            "point": kernel_vectors(np.zeros((room, 2), sim.dtype), sim.backend),
            "point_bin": self._array(np.zeros(room if self.bins > 1 else 1, np.int32)),
        }
        body_start = sim.model.numpy("body_start")
        self._points = {
            "contacts": self._contacts,
            "bodies": {
                **common,
                "bins": 1,
                "point_start": sim.model.body_start,
                "point_count": self._array(np.diff(body_start).astype(np.int32)),
                "point": sim.state.position,
                "point_bin": self._array(np.zeros(1, np.int32)),
            },
        }
        self._impulse = self._array(to_numpy(sim.contacts.impulse))
        self._gathers: dict[tuple[Any, ...], tuple[Callable[[Any, int], None], Any]] = {}
        self._splat_impulses = None
        self._image.fill(0)
        stages: list[Stage] = []
        if len(self._body_codes):
            count = len(to_numpy(self._body_values["area_body"]))
            values = {
                **common,
                **self._body_values,
                "point_start": self._body_values["area_start"],
                "point_count": self._array(np.zeros(self.worlds, np.int32)),
                "point": kernel_vectors(np.zeros((count, 2), sim.dtype), sim.backend),
                "point_bin": self._array(np.zeros(1, np.int32)),
            }
            value = self._array(np.zeros((count, len(self._body_codes)), sim.dtype))
            splat = self._splat_of(values, value, 0, 1, self.image)
            self.missed_bodies = splat.missed
            stages += [Kernel(self._table["body_features"], {**values, "value": value}), splat]
            if self._wall_channel >= 0:
                stages = [self._mark_walls(splat), *stages]
                stages.append(Kernel(self._table["add_walls"], {**self._wall_values, "image": self.image}))
        if len(self._contact_codes):
            value = self._array(np.zeros((room, len(self._contact_codes)), sim.dtype))
            splat = self._splat_of(self._contacts, value, len(self._body_codes), self.bins, self.image)
            self.missed_contacts = splat.missed
            stages += [self._contact_stage(self._contact_codes, value), splat]
        self._splat = self._program(stages)

    def _contact_stage(self, codes: np.ndarray | None = None, value: Any = None) -> Kernel:
        """Places and bins of the contacts, and values of the channels asked for."""
        if codes is None:
            codes, value = np.zeros(0, np.int32), self._array(np.zeros((1, 1), self.sim.dtype))
        arguments = {**self._contacts, "contact_channel": self._array(codes), "value": value}
        return Kernel(self._table["contact_features"], arguments)

    def _splat_of(self, values: Mapping[str, Any], value: Any, offset: int, bins: int, image: Any) -> Splat:
        arguments = {**values, "value": value, "channel_offset": offset, "bins": bins, "image": image}
        return Splat(self._table, arguments, backend=self.sim.backend, threads=self.threads)

    def _mark_walls(self, splat: Splat) -> Stage:
        """What makes a splat clear the walls' nodes, so that they can be added anew."""
        if splat.tiled:
            return functools.partial(to_numpy(splat.values["tile_touched"]).__setitem__, self._wall_tiles, 1)
        return Kernel(self._table["mark_walls"], {**self._wall_values, "touched": splat.values["touched"]})
