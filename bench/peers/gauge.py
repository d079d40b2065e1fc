"""How far the bodies of any engine overlap: one ruler for all, our narrowphase in float64 on the places it left."""

from __future__ import annotations

import numpy as np

import dc_kernels as dc
from dc_kernels.measure import contact_slots

TOUCHING = 1e-3  # gap below which surfaces touch [diameters]


class Gauge:
    """Overlaps of the touching pairs of bodies wherever an engine has put them, in float64."""

    def __init__(self, model: dc.Model, state: dc.State, joints: dc.Joints) -> None:
        """Take the bodies of a scene, in float64; the state gives what places do not say."""
        self.model, self.initial, self.joints = model, state, joints

    def overlaps(self, position: np.ndarray, angle: np.ndarray) -> np.ndarray:
        """Return the overlap of each contact point whose gap is below ``TOUCHING``; 0 where a gap is left.

        Args:
            position: of the bodies of the first worlds, or of all, static ones too, in our order (n, 2) [m].
            angle: of these (n,) [rad].

        Returns:
            Of these worlds, (points,) [m].
        """
        state = self.initial.copy()
        count = len(position)
        for name, values in (("position", position), ("angle", angle)):
            filled = state.numpy(name).astype(np.float64)
            filled[:count] = values
            state.assign(name, filled)
        state.assign("velocity", np.zeros_like(state.numpy("velocity")))
        state.assign("angular_velocity", np.zeros_like(state.numpy("angular_velocity")))
        sim = dc.Simulation(self.model, state, self.joints.copy())
        sim.collide(1e-6)
        slots, world = contact_slots(sim.contacts)
        worlds = int(np.searchsorted(self.model.numpy("body_start"), count, side="right")) - 1
        scale = self.model.numpy("length_scale")
        gap = sim.contacts.numpy("gap")[slots]
        return np.maximum(-gap[(gap < TOUCHING * scale[world]) & (world < worlds)], 0.0)
