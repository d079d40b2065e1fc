"""Starts from the solution of the step itself: what an oracle saves, and what a grid loses of it."""

from __future__ import annotations

import numpy as np

import dc_kernels as dc
from dc_kernels.measure import contact_slots
from dc_kernels.model.enums import BodyType
from pipeline.starts.impulses import ImpulseStart, set_impulses

GRID_SPACING = 0.25
"""Distance of the nodes of the theses' grids [m]."""
GRID_SUPPORT = 0.5
"""Support radius h of the theses' kernel [m]."""


class Copy(ImpulseStart):
    """Starts from the converged impulses of this very step, as an oracle would; rounded to ``decimals`` if given."""

    def __init__(self, sim: dc.Simulation, decimals: int | None = None) -> None:
        """Start the solves of a simulation; ``decimals`` may be negative, as for ``numpy.round``."""
        super().__init__(sim)
        self.decimals = decimals

    def write(self) -> None:
        """Solve; the solve that follows starts from the same predicted velocities and from this solution."""
        self.sim.solve()
        if self.decimals is not None:
            slots, _ = contact_slots(self.sim.contacts)
            set_impulses(self.sim, np.round(self.sim.contacts.numpy("impulse")[slots], self.decimals))


class Transfer(ImpulseStart):
    """Starts from the solution sent to a grid and back: what the transfer alone costs (Engedal, 2018).

    Impulses reach nodes 0.25 m apart by poly6 of h = 0.5 m with normalized weights. The grid covers the static shapes,
    or all bodies where there are none, as they are when the start is made.

    Attributes:
        images: what the impulses are sent to.
    """

    def __init__(self, sim: dc.Simulation, reverse: bool = True) -> None:
        """Go back by the reverse SPH sum (Engedal), or bilinearly (Wu, Tirca) if not ``reverse``."""
        super().__init__(sim)
        self.reverse = reverse
        self.images = dc.Images(
            sim, dc.ImageSpec(thesis_grid(sim), body_channels=(), stencil=dc.Stencil(h=GRID_SUPPORT))
        )

    def write(self) -> None:
        """Solve, splat the solution, and write what comes back."""
        self.sim.solve()
        with self.clock.part("splat"):
            image = self.images.impulse_image()
        with self.clock.part("gather"):
            self.images.start_from(image, reverse=self.reverse)


def thesis_grid(sim: dc.Simulation) -> dc.Grid:
    """Make a grid of nodes 0.25 m apart from corner to corner of the static shapes: in the thesis scene 61 x 61.

    Where there are no static shapes it covers the centres of all bodies.
    """
    model, position, angle = sim.model, sim.state.numpy("position"), sim.state.numpy("angle")
    vertices = np.diff(model.numpy("vertex_start"))
    stands = np.repeat(model.numpy("shape_category") != 0, vertices)  # not the shapes of empty slots, far from all else
    body = np.repeat(model.numpy("shape_body"), vertices)[stands]
    places = position[body].astype(np.float64)
    static = model.numpy("body_type")[body] == BodyType.STATIC
    if static.any():
        body, places = body[static], places[static]
        x, y = model.numpy("vertices")[: len(stands)][stands][static].T.astype(np.float64)
        cosine, sine = np.cos(angle[body]), np.sin(angle[body])
        places += np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=1)
    low, high = places.min(axis=0), places.max(axis=0)
    return dc.Grid.from_box(low, np.maximum(high, low + GRID_SPACING), GRID_SPACING)
