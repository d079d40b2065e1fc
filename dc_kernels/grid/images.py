"""Images of a simulation's bodies and contacts for networks, and the gather of a network's output at the contacts.

images = dc.Images(sim, dc.ImageSpec(dc.Grid.thesis()))
images.splat()                            # 4 channels of bodies, 2 of contacts
output = network(images.tensor())         # (W, 2, rows, columns), no copy either way
images.start_from(output)                 # impulses that the solver starts from
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from dc_kernels.grid.area import area_points, center_points, wall_nodes
from dc_kernels.grid.channels import IMPULSES
from dc_kernels.grid.gather import gather_kernel, weight_stages
from dc_kernels.grid.image_spec import ImageSpec
from dc_kernels.grid.scene import Scene, SceneSplat
from dc_kernels.grid.splat import allocate_image, points_group
from dc_kernels.grid.stencil import BILINEAR, Stencil, check_stencil
from dc_kernels.model.arrays import kernel_array, to_numpy, to_torch
from dc_kernels.model.settings import check_choice, checker, counted
from dc_kernels.runtime.capture import HOST, refuse_recording
from dc_kernels.runtime.inputs import check_callable, check_count, check_simulation, check_truth
from dc_kernels.runtime.interop import NotCopied, address
from dc_kernels.runtime.program import Fed, Program, Stage

if TYPE_CHECKING:
    from dc_kernels.simulation import Simulation, Start


_spec = checker(ImageSpec)
GATHERS = 64  # kinds of gathers whose launches are kept


class Images(NotCopied):
    """Persistent images of all worlds, filled from the simulation's present state and contacts.

    The channels of the bodies come first, then those of the contacts, for each bin of normal directions. A body is
    splatted at its centre of mass or over its area, a contact at position[body_a] + arm_a: between ``collide`` and
    ``advance`` that is its point, afterwards the point of the previous step, moved with body A. Velocities are those
    of ``state``, without the changes of an unfinished step. A flagged world shows neither bodies nor contacts. Static
    bodies appear only as walls, at their positions when the images are made; kinematic bodies do not appear.

    Threads share the worlds; the bits do not depend on their number. Images work on the CPU only. Every call counts as
    a call of the simulation: it raises RuntimeError during a call of another thread.

    Attributes:
        spec: grid, channels and stencil.
        channels: names in the order of the image; "normal_x/3" is the channel of bin 3 of several.
        image: (W, channels, rows, columns), of the simulation's dtype and backend; its memory never moves.
        missed_bodies, missed_contacts: number of points of each world that reached no node in the last splat, (W,).
    """

    def __init__(self, sim: Simulation, spec: ImageSpec, *, threads: int | None = None) -> None:
        """Allocate the image and find the walls.

        Args:
            sim: the simulation whose state and contacts are shown.
            spec: grid, channels and stencil.
            threads: number of threads; None: that of the simulation.

        Raises:
            ValueError: a setting is out of range, or the simulation is on a GPU.
        """
        check_simulation("sim", sim)
        if sim.device != "cpu":
            raise ValueError(f"sim.device is {sim.device!r}; Images runs on the CPU")
        _spec("spec", spec)
        threads = sim.threads if threads is None else check_count("threads", threads)
        self.sim, self.spec, self.channels = sim, spec, spec.channels
        self.worlds = sim.model.world_count
        self.threads = max(1, min(threads, self.worlds))
        self._image = allocate_image(self.worlds, len(self.channels), spec.grid, sim.dtype)
        self._impulses: Any = None
        self._splat_impulses: Program | None = None
        self.image = self._array(self._image)
        with sim.calls:
            self._allocate()

    def __repr__(self) -> str:
        """Worlds, channels, nodes, scalar and backend."""
        worlds, channels, rows, columns = self._image.shape
        counts = f"{counted(worlds, 'world')}, {counted(channels, 'channel')} of {rows} x {columns} nodes"
        return f"<{type(self).__name__}: {counts}; {self._image.dtype}, {self.sim.backend} on cpu>"

    def _allocate(self) -> None:
        sim, spec = self.sim, self.spec
        self._bodies = area_points(sim.model, spec.grid.spacing) if spec.area else center_points(sim.model)
        self._walls = wall_nodes(sim.model, sim.state, spec.grid) if spec.wall_channel >= 0 else None
        self._changes = sim.storage.changes
        self._bind()

    # ------------------------------------------------------------------ the image

    def numpy(self) -> np.ndarray:
        """Return the image as a numpy array of the same memory."""
        return self._image

    def tensor(self) -> Any:
        """Return the image as a torch tensor of the same memory.

        Raises:
            ImportError: torch is not installed; the error names the extra.
        """
        return to_torch(self._image)

    def splat(self) -> Any:
        """Fill the image from the present state and contacts, and return it."""
        with self.sim.calls:
            self._keep_bound()
            self._scene()
        return self.image

    def impulse_image(self) -> Any:
        """Return the present impulses as an image (W, 2 bins, rows, columns), the target of networks, in fixed memory.

        Its channels are the normal and tangential impulse [N s] of each bin, as ``start_from`` reads them.
        """
        with self.sim.calls:
            self._keep_bound()
            if self._splat_impulses is None:
                if self._impulses is None:
                    values = allocate_image(self.worlds, self.spec.impulse_channels, self.spec.grid, self.sim.dtype)
                    self._impulses = self._array(values)
                to_numpy(self._impulses).fill(0)
                self._splat_impulses = self._scene.program(self._scene.impulse_stages(self._impulse, self._impulses))
            self._splat_impulses()
            return self._impulses

    # ------------------------------------------------------------------ back to the contacts

    def gather(
        self,
        image: Any,
        *,
        at: Literal["contacts", "bodies"] = "contacts",
        stencil: Stencil | None = None,
        reverse: bool = False,
    ) -> Any:
        """Return the values of an image at the present contacts, or at the bodies' centres of mass.

        Args:
            image: (W, C bins, rows, columns), or (W, C, rows, columns) at bodies, which have no bins; for any C, of the
                simulation's dtype, contiguous, on the CPU: a torch tensor, numpy array or ``wp.array``, read in
                place. Values that are not finite are passed on.
            at: "contacts", or "bodies" (also static and kinematic ones).
            stencil: weights of the nodes; None: bilinear, or those of the splat with ``reverse``.
            reverse: whether to divide the value of a node among the points that reach it (reverse SPH, see
                ``transfer.gather``).

        Returns:
            (slots, C), one row for each slot of ``sim.contacts``: those of world w begin at contact_start[w], and
            contact_count[w] of them are in use; or (bodies, C). The memory is reused until the simulation's
            arrays grow.

        Raises:
            ValueError: the image has another type, dtype, shape, layout or device, or a gather cannot use the stencil.
        """
        check_choice("at", at, ("contacts", "bodies"))
        return self._gather(image, at, None, stencil, reverse)

    def start_from(self, image: Any, *, stencil: Stencil | None = None, reverse: bool = False) -> None:
        """Write an image of impulses (W, 2 bins, rows, columns) to ``sim.contacts.impulse``; arguments as ``gather``.

        Raises:
            ValueError: see ``gather``.
        """
        self._gather(image, "contacts", len(IMPULSES), stencil, reverse)

    def starter(self, predict: Callable[[Images], Any], **options: Any) -> Start:
        """Return a start for ``sim.step(dt, start=...)``: splat, predict, start from the predicted impulses.

        Args:
            predict: function of these images, called after the splat; returns an image of impulses for ``start_from``.
            **options: stencil and reverse of ``start_from``.

        Raises:
            TypeError: ``predict`` cannot be called, or an option is unknown.
        """
        check_callable("predict", predict)
        if unknown := set(options) - {"stencil", "reverse"}:
            raise TypeError(f"{min(unknown)} is no option of start_from; there are stencil and reverse")

        def start(sim: Simulation) -> None:
            if sim is not self.sim:
                raise ValueError("the images are those of another simulation")
            self.splat()
            self.start_from(predict(self), **options)

        return start

    def _gather(self, image: Any, at: str, channels: int | None, stencil: Stencil | None, reverse: bool) -> Any:
        stencil, reverse = check_stencil("stencil", stencil), check_truth("reverse", reverse)
        pointer, shape = address(image, "image", self.sim.dtype)
        bins = self.spec.bins if at == "contacts" else 1
        count = channels or (shape[1] // bins if len(shape) > 1 else 0)
        if count < 1 or shape != (self.worlds, count * bins, *self.spec.grid.shape):
            wanted, (rows, columns) = f"{channels * bins}" if channels else f"C * {bins}", self.spec.grid.shape
            raise ValueError(f"image has shape {shape}; it must be ({self.worlds}, {wanted}, {rows}, {columns})")
        key = (at, count, channels is not None, stencil, reverse)
        with self.sim.calls:
            self._keep_bound()
            if key not in self._gathers:
                if len(self._gathers) >= GATHERS:
                    self._gathers.clear()
                self._gathers[key] = self._bind_gather(*key)
            run, value = self._gathers[key]
            run(image, pointer)
        return value

    def _bind_gather(
        self, at: str, channels: int, to_impulse: bool, stencil: Stencil | None, reverse: bool
    ) -> tuple[Callable[[Any, int], None], Any]:
        """What gathers from an image at an address, and where to."""
        if stencil is None:
            stencil = self.spec.stencil if reverse else BILINEAR
        stencil.check_gather(reverse)
        backend, grid, dtype = self.sim.backend, self.spec.grid, self.sim.dtype
        if at == "contacts":
            stages: list[Stage] = [self._scene.contact_stage()]
            points, bins = self._scene.contact_points, self.spec.bins
            room, most = self._room, int(self.sim.storage.contact_room.max())
        else:
            points, bins, stages = self._body_points(), 1, []
            room, most = self.sim.model.body_count, int(np.diff(self.sim.model.numpy("body_start")).max(initial=0))
        value = self._impulse if to_impulse else self._array(np.zeros((room, channels), dtype))
        # for reverse a copy, as what the caller's image holds is not ours to change
        share = allocate_image(self.worlds if reverse else 1, channels * bins, grid, dtype)
        source = self._array(share)
        gather = gather_kernel(stencil, grid, points, source, value, bins=bins, most=most, backend=backend)
        if reverse:
            weigh = weight_stages(
                stencil, grid, points, source, count=room, bins=bins, backend=backend, threads=self.threads
            )
            program = self._scene.program([*stages, *weigh, gather])

            def run_reverse(image: Any, pointer: int) -> None:
                refuse_recording("a reverse gather", HOST)
                np.copyto(share, to_numpy(image))
                program()

            return run_reverse, value
        locate = self._scene.program(stages)
        fed = Fed(gather, "image", self.worlds, backend=backend, threads=self.threads)

        def run(image: Any, pointer: int) -> None:
            locate()
            fed(image, pointer)

        return run, value

    # ------------------------------------------------------------------ set-up

    def _array(self, values: np.ndarray) -> Any:
        return kernel_array(values, self.sim.backend)

    def _body_points(self) -> Any:
        model, start = self.sim.model, self.sim.model.numpy("body_start")
        return points_group(
            self.spec.grid,
            self.worlds,
            self.sim.backend,
            self.sim.dtype.name,
            start=model.body_start,
            count=np.diff(start).astype(np.int32),
            place=self.sim.state.position,
        )

    def _keep_bound(self) -> None:
        """Bind everything anew where the simulation has other arrays or settings than at the last time."""
        if self._bound != (self.sim.layout_version, self.sim.config):
            if self._changes != self.sim.storage.changes:
                self._allocate()
            else:
                self._bind()

    def _bind(self) -> None:
        """Bind everything to the simulation's present arrays and settings."""
        sim = self.sim
        self._bound = (sim.layout_version, sim.config)
        self._room = sim.contacts.sizes["contact"]
        scene = Scene(
            **{
                name: {field: group.array(field) for field in group.table}
                for name, group in (("model", sim.model), ("state", sim.state), ("contacts", sim.contacts))
            },
            worlds=self.worlds,
            room=self._room,
            backend=sim.backend,
            dtype=sim.dtype.name,
        )
        self._image.fill(0)
        self._scene = SceneSplat(
            self.spec, scene, self.image, bodies=self._bodies, walls=self._walls, threads=self.threads
        )
        self.missed_bodies, self.missed_contacts = self._scene.missed_bodies, self._scene.missed_contacts
        self._impulse = self._array(to_numpy(sim.contacts.impulse))
        self._gathers: dict[tuple[Any, ...], tuple[Callable[[Any, int], None], Any]] = {}
        self._splat_impulses = None
