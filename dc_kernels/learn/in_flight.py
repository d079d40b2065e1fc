"""Features of a paused solve for a network, and corrections of its impulses by the network's output, without copies.

reader = SolveReader(sim, grid)
sim.solve(pause=0)                             # reads contacts.impulse, makes no sweep
reader.read(np.flatnonzero(sim.running), begin=True)
trunk = convolutions(reader.images())          # of the running worlds
near = reader.gather(trunk)                    # at the contacts and at both bodies
reader.correct(head(reader.features(), near))
sim.resume(pause=20)
"""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

import numpy as np

from dc_kernels.grid.gather import gather_kernel
from dc_kernels.grid.grid import Grid
from dc_kernels.grid.splat import Splat, allocate_image, points_group
from dc_kernels.grid.stencil import BILINEAR, Stencil
from dc_kernels.learn.channels import IMAGE, LOCAL, OUTPUT, SHARE, Answer
from dc_kernels.learn.groups import SETTINGS, Reading
from dc_kernels.model.arrays import kernel_array, to_torch
from dc_kernels.model.settings import Limits, check_choice, checker
from dc_kernels.runtime.backends import kernel_file, make_kernels
from dc_kernels.runtime.capture import refuse_recording
from dc_kernels.runtime.inputs import check_count, check_simulation
from dc_kernels.runtime.interop import NotCopied, address
from dc_kernels.runtime.program import Fed, Kernel, Program

if TYPE_CHECKING:
    from dc_kernels.simulation import Simulation

What = Literal["steps", "features", "images"]
READS = get_args(What)
GATHERS = 8  # numbers of channels whose gathers are kept
RATE_NODES = 3  # spacings between the nodes that rates are taken at: 6 diameters at a spacing of 2
PLACES = ("place", "place_a", "place_b")


def in_flight_kernels(backend: str, dtype: str, variant: str) -> dict[str, Any]:
    """Look up the kernels: solve_features, correct_impulses."""
    return make_kernels(backend, "learn.in_flight", dtype, variant)


_grid, _ratio = checker(Grid), checker(Annotated[float, Limits(above=0.0, size=math.inf)])


class SolveReader(NotCopied):
    """Computes features and images of a paused solve, for any of its worlds, packed one world after the other.

    Attributes:
        local: (room, len(LOCAL)); the first ``count`` rows are the contacts of the last ``read``.
        image_value: splatted values, (room, len(IMAGE)).
        image: (W, len(IMAGE), rows, columns); plane k is that of the k-th requested world.
        place, place_a, place_b: contact points and centres of their bodies [m], (room, 2).
        step: step of the last sweep [N s], (room, 2); before the first, that of each contact by itself.
        rate: A near each contact, (room,).
        scale: scales of each world, its columns those of ``channels.Scale``, (W, 4).
        before, known: impulses before and after the last correction, (slots of ``sim.contacts``, 2) [N s].
        active, packed_start: the requested worlds, and the first row of each.
        asked, count: numbers of worlds and contacts of the last ``read``.
        answer: kind of correction of each (``channels.Answer``); even for worlds read as "steps", (W,).
        version: number that grows when these arrays are reallocated.
    """

    def __init__(
        self, sim: Simulation, grid: Grid, *, cap: float = 200.0, limit: float = 100.0, threads: int | None = None
    ) -> None:
        """Allocate all memory.

        Args:
            sim: the simulation; with schedule "world", on the CPU, and not with acceleration "nncg", whose restarts
                set the stored step to 0.
            grid: grid of the images, relative to each world's origin.
            cap: largest extrapolation A [1].
            limit: largest RMS of an accepted correction, relative to the expected one [1].
            threads: number of threads; None: that of the simulation.

        Raises:
            ValueError: the simulation's solves cannot pause, or a setting is out of range.
        """
        check_simulation("sim", sim)
        _grid("grid", grid)
        cap, limit = _ratio("cap", cap), _ratio("limit", limit)
        if sim.device != "cpu" or sim.schedule != "world":
            raise ValueError(
                f"the simulation runs on {sim.device!r} with schedule {sim.schedule!r}; it must be 'cpu' and 'world'"
            )
        self.sim, self.grid, self.cap, self.limit = sim, grid, cap, limit
        self.worlds = worlds = sim.model.world_count
        self.threads = max(1, min(sim.threads if threads is None else check_count("threads", threads), worlds))
        self.image = allocate_image(worlds, len(IMAGE), grid, sim.dtype)
        self._point_count = np.zeros(worlds, np.int32)
        self.asked = self.count = self.version = 0
        with sim.calls:
            self._bind()

    def begin(self) -> None:
        """Record the start impulses of the solves, relative to which ``since`` is computed."""
        refuse_recording("a solve that is read", "the host reads what the kernels leave")
        with self.sim.calls:
            self._keep_bound()
            np.copyto(self.known, self.sim.contacts.numpy("impulse"))
            self._least.fill(np.inf)

    def read(self, worlds: np.ndarray, *, begin: bool, what: What = "images") -> int:
        """Compute features and images of worlds whose solve is paused.

        Args:
            worlds: indices, ascending.
            begin: whether no sweep has been made.
            what: "steps": only steps, rates and scales; "features": also the features and positions of the contacts;
                "images": also the images.

        Returns:
            The number of their contacts.

        Raises:
            ValueError: a world does not exist, is out of order or not paused, the acceleration is "nncg", or ``what``
                is unknown.
        """
        check_choice("what", what, READS)
        refuse_recording("a solve that is read", "the host reads what the kernels leave")
        with self.sim.calls:
            self._check(worlds)
            self._keep_bound()
            self.asked = asked = len(worlds)
            counts = self.sim.contacts.numpy("contact_count")[worlds]
            self.active[:asked] = worlds
            np.cumsum(counts, out=self.packed_start[1 : asked + 1])
            self.count = int(self.packed_start[asked])
            self.packed_start[asked + 1 :] = self.count
            self._point_count[:asked] = counts
            self._point_count[asked:] = 0
            self.answer[:asked] = Answer.EVEN if what == "steps" else Answer.NETWORK
            self.answer[asked:] = Answer.NOTHING
            self._read[what == "images", bool(begin)]()
            return self.count

    def features(self) -> Any:
        """Return ``local`` of the contacts read as a torch tensor (count, len(LOCAL)) on its memory."""
        return to_torch(self.local)[: self.count]

    def images(self) -> Any:
        """Return the images of the worlds read as a torch tensor (asked, len(IMAGE), rows, columns) on their memory."""
        return to_torch(self.image)[: self.asked]

    def gather(self, image: Any) -> tuple[Any, Any, Any]:
        """Interpolate an image of the worlds read bilinearly at the contacts, at their bodies A and at their bodies B.

        Args:
            image: (asked, C, rows, columns), contiguous, of the simulation's dtype, on the CPU, read in place.

        Returns:
            Three torch tensors (count, C); the next call with so many channels overwrites them.

        Raises:
            ValueError: for an image of another dtype, shape, layout or device.
        """
        refuse_recording("a solve that is read", "the host reads what the kernels leave")
        pointer, shape = address(image, "image", self.sim.dtype)
        if len(shape) != 4 or (shape[0], *shape[2:]) != (self.asked, *self.grid.shape):
            raise ValueError(
                f"image has shape {shape}; it must be ({self.asked}, C, {self.grid.rows}, {self.grid.columns})"
            )
        channels = shape[1]
        if channels not in self._gathers:
            if len(self._gathers) >= GATHERS:
                self._gathers.clear()
            self._gathers[channels] = self._bind_gather(channels)
        values, launches = self._gathers[channels]
        for launch in launches:
            launch(image, pointer)
        return tuple(to_torch(value)[: self.count] for value in values)  # type: ignore[return-value]

    def correct(self, output: Any) -> np.ndarray:
        """Correct ``contacts.impulse`` of the worlds read, from which ``resume`` then continues.

        Args:
            output: (count, len(OUTPUT)), contiguous, of the simulation's dtype, on the CPU, read in place.

        Returns:
            Whether each world accepted its correction, bool (asked,): not with NaN or inf, or beyond ``limit``, nor if
            it is so large relative to the impulses and steps read since ``begin`` that velocities would lose all
            their digits.

        Raises:
            ValueError: for an output of another dtype, shape, layout or device.
        """
        refuse_recording("a solve that is read", "the host reads what the kernels leave")
        pointer, shape = address(output, "output", self.sim.dtype)
        if shape != (self.count, len(OUTPUT)):
            raise ValueError(f"output has shape {shape}; it must be ({self.count}, {len(OUTPUT)})")
        with self.sim.calls:
            self._correct(output, pointer)
            return self.taken()

    def taken(self) -> np.ndarray:
        """Return whether each world read accepted the last correction, bool (asked,)."""
        return np.asarray(self.sim.stats.numpy("replaced")[self.active[: self.asked]] != 0)

    def correction_kernel(self, output: Any, begin: bool) -> Kernel:
        """Return what corrects the impulses of the worlds read by an output (room, len(OUTPUT)), as kernels take it."""
        return Kernel(self._table["correct_impulses"], {**self._values[begin], "output": output})

    def features_kernel(self, begin: bool) -> Kernel:
        """Return what reads the worlds that are asked for, each as ``answer`` says."""
        return Kernel(self._table["solve_features"], self._values[begin])

    def take_all(self) -> None:
        """Take all worlds as asked for, by their own numbers; kernels then read and answer as ``answer`` says."""
        with self.sim.calls:
            self._keep_bound()
            counts = self.sim.contacts.numpy("contact_count")
            self.asked = self.worlds
            self.active[:] = np.arange(self.worlds)
            np.cumsum(counts, out=self.packed_start[1:])
            self.count = int(self.packed_start[-1])
            self._point_count[:] = counts

    # ------------------------------------------------------------------ set-up

    def _check(self, worlds: np.ndarray) -> None:
        if worlds.ndim != 1 or worlds.dtype.kind not in "iu":
            raise ValueError(f"worlds has dtype {worlds.dtype}, shape {worlds.shape}; it must be (n,) integers")
        if not len(worlds):
            return
        if worlds[0] < 0 or worlds[-1] >= self.worlds or not (worlds[1:] > worlds[:-1]).all():
            off = (worlds >= self.worlds) | (np.diff(worlds, prepend=-1) <= 0)
            i = int(np.argmax(off))
            raise ValueError(f"worlds[{i}] is {worlds[i]}; it must lie in [0, {self.worlds - 1}], above those before")
        paused = self.sim.running[worlds]
        if not paused.all():
            i = int(np.argmin(paused))
            raise ValueError(f"worlds[{i}] is {worlds[i]}, whose solve is not paused")

    def _array(self, values: np.ndarray) -> Any:
        return kernel_array(values, self.sim.backend)

    def _bind_gather(self, channels: int) -> tuple[np.ndarray, list[Fed]]:
        """Bind what gathers an image of so many channels at the three places; where to, and the launches."""
        values = np.zeros((len(PLACES), self._room, channels), self.sim.dtype)
        image = self._array(np.zeros((1, channels, *self.grid.shape), self.sim.dtype))
        backend, most = self.sim.backend, int(self.sim.storage.contact_room.max(initial=0))
        stages = [
            gather_kernel(
                BILINEAR, self.grid, self._points(name), image, self._array(value), most=most, backend=backend
            )
            for name, value in zip(PLACES, values)
        ]
        return values, [self._fed(stage, "image") for stage in stages]

    def _fed(self, stage: Kernel, name: str) -> Fed:
        return Fed(stage, name, self.worlds, backend=self.sim.backend, threads=self.threads)

    def _points(self, place: str) -> Any:
        """The contacts read, at one of their places, as splat and gather take points."""
        return points_group(
            self.grid,
            self.worlds,
            self.sim.backend,
            self.sim.dtype.name,
            start=self.packed_start,
            count=self._point_count,
            place=getattr(self, place),
        )

    def _keep_bound(self) -> None:
        """Bind everything anew where the simulation has other arrays or settings than at the last time."""
        if self._bound != (self.sim.layout_version, self.sim.config):
            self._bind()

    def _bind(self) -> None:
        """Bind everything to the simulation's present arrays and settings."""
        sim, dtype, backend = self.sim, self.sim.dtype, self.sim.backend
        if sim.config.acceleration == "nncg":
            raise ValueError("config.acceleration is 'nncg'; a solve that is read keeps the step of each sweep")
        self._bound = (sim.layout_version, sim.config)
        self.version += 1
        self._table = in_flight_kernels(sim.backend, sim.dtype.name, sim.variant)
        self._room = room = sim.contacts.sizes["contact"]
        groups = kernel_file(backend, "groups")
        rows, columns = (max(2, -(-(n - 1) // RATE_NODES) + 1) for n in self.grid.shape)
        sizes = {"world": self.worlds, "world+1": self.worlds + 1, "body": sim.model.body_count}
        sizes |= {"contact": room, "row": room, "feature": len(LOCAL), "channel": len(IMAGE)}
        self.reading = reading = Reading(
            {**sizes, "sweep": 2, "grid row": rows, "grid column": columns}, dtype, backend=backend
        )
        self.active, self.packed_start, self.scale = map(reading.numpy, ("active", "packed_start", "scale"))
        self.answer, self._least = map(reading.numpy, ("answer", "least"))
        self._least.fill(np.inf)
        self.local, self.image_value = map(reading.numpy, ("local", "image_value"))
        self.place, self.place_a, self.place_b = map(reading.numpy, PLACES)
        self.step, self.rate, self.before, self.known = map(reading.numpy, ("step", "rate", "before", "known"))
        reading.numpy("grid_origin")[:] = self.grid.origin
        self._gathers: dict[int, tuple[np.ndarray, list[Fed]]] = {}
        given = {
            "accelerated": int(sim.config.acceleration != "none"),
            "tolerance": sim.config.ends_at[1],
            "cap": self.cap,
            "rate_spacing": RATE_NODES * self.grid.spacing,
            "limit": self.limit,
        }

        def settings(begin: bool) -> Any:
            numbers = {**given, "begin": int(begin), "share": 0.0 if begin else SHARE}
            return groups.group("reading_settings", dtype.name, SETTINGS, numbers)

        values = {**sim.values, "reading": groups.array_group(reading, "reading")}
        self.image.fill(0)
        splat = Splat(
            Stencil("bspline"),
            self.grid,
            self._points("place"),
            reading.array("image_value"),
            self._array(self.image),
            backend=backend,
            threads=self.threads,
        )
        self._values = [{**values, "settings": settings(begin)} for begin in (False, True)]
        output = self._array(np.zeros((1, len(OUTPUT)), dtype))
        self._correct = self._fed(self.correction_kernel(output, begin=False), "output")
        self._read = {
            (images, begin): Program(
                [self.features_kernel(begin), *([splat] if images else [])],
                worlds=self.worlds,
                backend=backend,
                threads=self.threads,
            )
            for images, begin in itertools.product((False, True), repeat=2)
        }
