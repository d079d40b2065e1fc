"""How far bodies of any engine overlap and joints come apart: one ruler for all, on the places it left, in float64."""

from __future__ import annotations

import numpy as np

import dc_kernels as dc
from dc_kernels.measure import contact_slots
from dc_kernels.model.enums import JointKind, JointPart

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

    def separations(self, position: np.ndarray, angle: np.ndarray) -> np.ndarray:
        """Return how far apart each joint that holds points rigidly has come, from the places alone.

        Of hinges and welds it is the distance of the anchors, of sliders and wheels how far anchor B is off
        the line, of rods and ropes how much longer or shorter they are than they may be; springs have none.

        Args:
            position: see ``overlaps``.
            angle: of these (n,) [rad].

        Returns:
            Of the joints of these worlds, (joints,) [m].
        """
        j = {name: self.joints.numpy(name) for name in self.joints.table}
        ends = j["joint_body_a"], j["joint_body_b"]
        parts, kind = j["joint_parts"], j["joint_kind"]
        held = parts & int(JointPart.HOLD) != 0
        keeps = (np.maximum(*ends) < len(position)) & (j["joint_broken"] == 0)
        keeps &= ~np.isin(kind, (JointKind.GEAR, JointKind.GENERAL, JointKind.TARGET))
        keeps &= ~((kind == JointKind.DISTANCE) & held & (j["joint_frequency"] > 0))
        chosen = np.flatnonzero(keeps)
        points = []
        for body, anchor in zip(ends, (j["joint_anchor_a"], j["joint_anchor_b"]), strict=True):
            points.append(position[body[chosen]] + _turned(anchor[chosen], angle[body[chosen]]))
        way = points[1] - points[0]
        apart = np.linalg.norm(way, axis=1)
        line = _turned(j["joint_axis"][chosen], angle[ends[0][chosen]])
        across = np.abs(line[:, 0] * way[:, 1] - line[:, 1] * way[:, 0])
        low, high = (
            np.where(held[chosen], j["joint_length"][chosen], j[f"joint_{end}"][chosen]) for end in ("lower", "upper")
        )
        stretch = np.maximum(np.maximum(apart - high, low - apart), 0.0)
        of = kind[chosen]
        on_a_line = (of == JointKind.PRISMATIC) | (of == JointKind.WHEEL)
        return np.asarray(np.where(of == JointKind.DISTANCE, stretch, np.where(on_a_line, across, apart)))


def _turned(vectors: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Vectors (n, 2) turned by angles (n,) [rad]."""
    c, s = np.cos(angle), np.sin(angle)
    x, y = vectors.astype(np.float64).T
    return np.stack([c * x - s * y, s * x + c * y], axis=1)
