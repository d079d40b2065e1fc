"""Start strategies of the thesis protocol: what the contact solver starts from, and networks by name.

A strategy is a callable ``sim -> None`` for ``Simulation.step(dt, start=...)``: it runs between collide
and solve and writes ``sim.contacts.impulse``. Start impulses outside the friction cone are meant: the
solver clamps them. What goes further, such as a network that is called in mid-solve, is a ``Driver``: its ``solve()``
stands between collide and advance in place of the simulation's. ``maker`` knows both by name.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import numpy as np

import dc_kernels as dc
from dc_kernels.grid.grid import Grid
from dc_kernels.measure import contact_slots
from dc_kernels.model.enums import BodyType

Strategy = Callable[["dc.Simulation"], None]


class Driver(Protocol):
    """What runs the whole solve of a simulation it was made for (``learned.LearnedSolve``)."""

    stats: Any
    """What it did; ``stats.totals()`` gives numbers by name, and wall times by part as "seconds"."""

    def solve(self) -> None:
        """The solve phase, in place of ``sim.solve()``."""

    def explain(self) -> str:
        """What it did, in words."""


Maker = Callable[["dc.Simulation"], "Strategy | Driver"]

RANDOM_NORMAL = (0.0, 5.0)  # [N s], uniform
RANDOM_TANGENT = (-2.0, 2.0)  # [N s], uniform
BAD_IMPULSE = (50.0, 50.0)  # [N s], normal and tangential
GRID_SPACING, GRID_SUPPORT = 0.25, 0.5  # [m], of the theses' grids and kernel
CHECKPOINT = ".safetensors"  # ends the names of trained networks
PRETRAINED = Path(__file__).resolve().parents[1] / "contactnet" / f"contactnet{CHECKPOINT}"
"""The weights of ``cnn``, those that come with the package."""
CNN = {"cnn": True, "cnn-start": False}
"""Names of the pretrained network, and whether it is called in mid-solve too."""


def set_impulses(sim: dc.Simulation, values: np.ndarray | tuple[float, float]) -> None:
    """Write the start impulses of the present contacts, world after world [N s], (contacts, 2)."""
    impulse = sim.contacts.numpy("impulse").copy()
    impulse[contact_slots(sim.contacts)[0]] = values
    sim.contacts.assign("impulse", impulse)


def none(sim: dc.Simulation) -> None:
    """Zero, for contacts and joints."""
    set_impulses(sim, (0.0, 0.0))
    if sim.joints is not None:
        sim.joints.assign("joint_impulse", np.zeros_like(sim.joints.numpy("joint_impulse")))


def builtin(sim: dc.Simulation) -> None:
    """Each contact's own impulse of the step before, zero if it is new: what collide has left there.

    Raises:
        ValueError: when the simulation's configuration starts from zero instead.
    """
    if sim.config.start != "cache":
        raise ValueError(f"SolverConfig.start is {sim.config.start!r}; the strategy builtin needs 'cache'")


def bad(sim: dc.Simulation) -> None:
    """50 N s, normal and tangential."""
    set_impulses(sim, BAD_IMPULSE)


class Random:
    """Uniform impulses, normal in [0, 5] and tangential in [-2, 2] N s; each world has a stream of its own."""

    def __init__(self, seed: int = 0) -> None:
        """World w draws from seed ``seed + w``."""
        if seed < 0:
            raise ValueError(f"seed is {seed}; it must be >= 0")
        self.seed = seed
        self.streams: list[np.random.Generator] = []

    def __call__(self, sim: dc.Simulation) -> None:
        """Draw the start of every contact."""
        counts = sim.contacts.numpy("contact_count")
        for world in range(len(self.streams), len(counts)):
            self.streams.append(np.random.Generator(np.random.PCG64([self.seed + world, 1])))
        low, high = np.transpose([RANDOM_NORMAL, RANDOM_TANGENT])
        draws = [s.uniform(low, high, (int(n), 2)) for s, n in zip(self.streams, counts, strict=True)]
        set_impulses(sim, np.concatenate(draws))


class Copy:
    """The converged impulses of this very step: the oracle. Rounded to ``decimals`` if given."""

    def __init__(self, decimals: int | None = None) -> None:
        """``decimals`` may be negative, as for ``numpy.round``."""
        self.decimals = decimals

    def __call__(self, sim: dc.Simulation) -> None:
        """Solve; the solve that follows starts from the same predicted velocities and from this solution."""
        sim.solve()
        if self.decimals is not None:
            slots, _ = contact_slots(sim.contacts)
            set_impulses(sim, np.round(sim.contacts.numpy("impulse")[slots], self.decimals))


class Transfer:
    """Copy sent to a grid and back: what the transfer alone costs (Engedal, 2018).

    Poly6 of h = 0.5 m to nodes 0.25 m apart, weights normalised; the grid covers the static shapes, or all bodies where
    there are none, as they are at the first call.
    """

    def __init__(self, reverse: bool = True) -> None:
        """Back by the reverse SPH sum (Engedal), or bilinearly (Wu, Tirca)."""
        self.reverse = reverse
        self.images: dc.Images | None = None

    def bind(self, sim: dc.Simulation) -> dc.Images:
        """The images of a simulation."""
        if self.images is None or self.images.sim is not sim:
            self.images = dc.Images(sim, thesis_grid(sim), bodies=(), h=GRID_SUPPORT)
        return self.images

    def __call__(self, sim: dc.Simulation) -> None:
        """Solve, splat the solution, and start from what comes back."""
        images = self.bind(sim)
        sim.solve()
        images.start_from(images.impulse_image(), reverse=self.reverse)


def thesis_grid(sim: dc.Simulation) -> Grid:
    """Nodes 0.25 m apart from corner to corner of the static shapes, in the thesis scene 61 x 61; see ``Transfer``."""
    model, position, angle = sim.model, sim.state.numpy("position"), sim.state.numpy("angle")
    body = np.repeat(model.numpy("shape_body"), np.diff(model.numpy("vertex_start")))
    places = position[body].astype(np.float64)
    static = model.numpy("body_type")[body] == BodyType.STATIC
    if static.any():
        body, places = body[static], places[static]
        x, y = model.numpy("vertices")[static].T.astype(np.float64)
        cosine, sine = np.cos(angle[body]), np.sin(angle[body])
        places += np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=1)
    low, high = places.min(axis=0), places.max(axis=0)
    return Grid.from_box(low, np.maximum(high, low + GRID_SPACING), GRID_SPACING)


# name: seed -> strategy; "copyN" for any number of decimals N is understood by ``parse``
STRATEGIES: dict[str, Callable[[int], Strategy]] = {
    "none": lambda seed: none,
    "builtin": lambda seed: builtin,
    "random": Random,
    "bad": lambda seed: bad,
    "copy": lambda seed: Copy(),
    "grid": lambda seed: Transfer(),
    "grid-bilinear": lambda seed: Transfer(reverse=False),
}


def parse(name: str, seed: int = 0) -> Strategy:
    """The strategy of a name, or copyN with N decimals (copy0, copy2); any case.

    Args:
        name: of the strategy: none, builtin, random, bad, copy, copyN, grid, grid-bilinear.
        seed: of the random one.

    Raises:
        ValueError: for an unknown name.
    """
    lower = name.lower()
    if lower in STRATEGIES:
        return STRATEGIES[lower](seed)
    match = re.fullmatch(r"copy(\d{1,2})", lower)
    if match is None:
        raise ValueError(f"start is {name!r}; it must be one of {tuple(STRATEGIES)} or copyN with N decimals")
    return Copy(int(match[1]))


def maker(name: str, seed: int = 0) -> Maker:
    """What makes the strategy or driver of a name for a simulation; files are read here, before anything runs.

    Args:
        name: as for ``parse``; cnn, the pretrained network at the start and in mid-solve; cnn-start, at the start only;
            or the path of a trained network (.safetensors).
        seed: of the random strategy.

    Raises:
        OSError: a network's file cannot be read.
        ValueError: for an unknown name, or a file that holds no network.
    """
    lower = name.lower()
    if not is_network(name):
        parse(name, seed)
        return lambda sim: parse(name, seed)
    from pipeline.networks.checkpoint import load_checkpoint

    model, manifest = load_checkpoint(PRETRAINED if lower in CNN else name)
    if model.network_name == "contactnet":
        from pipeline.starts.learned import CallOptions, LearnedSolve

        options = CallOptions(middle=CNN.get(lower, True))
        return lambda sim: LearnedSolve(sim, model, options)
    from pipeline.starts.grid_start import GridStart

    return lambda sim: GridStart(model, manifest, sim)


def is_network(name: str) -> bool:
    """Whether a name for ``maker`` is that of a network."""
    return name.lower() in CNN or name.lower().endswith(CHECKPOINT)


def step(sim: dc.Simulation, dt: float, made: Strategy | Driver) -> None:
    """A time step of dt [s] with what ``maker`` made for the simulation."""
    if not hasattr(made, "solve"):
        sim.step(dt, start=made)
        return
    sim.collide(dt)
    made.solve()
    sim.advance()
