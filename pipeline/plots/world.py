"""Pictures of a world: its bodies, its walls, and the forces between them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dc_kernels.model.enums import BodyType, JointKind, ShapeType
from dc_kernels.runtime.imports import require
from pipeline.plots.style import EDGE, FILL, GREEN, INK

FORCE_MAP = "inferno_r"
FORCE_WIDTH = 5.0
"""Width of the line of the largest force [points]."""
ARC = 0.27
"""Largest angle between two points of an arc [rad]."""
FINE_SHAPES = 4000
"""Number of shapes in a world above which discs are drawn with fewer points [1]."""


@dataclass(frozen=True)
class WorldShapes:
    """Outlines of the shapes of one world, in the frames of their bodies."""

    bodies: slice
    """Place of the world's bodies among those of all worlds."""
    outlines: list[tuple[np.ndarray, np.ndarray]]
    """Outlines, put together where they have equally many points: bodies (n,), counted within the world, and points
    (n, points, 2) [m]."""
    segments: tuple[np.ndarray, np.ndarray]
    """Static segments: bodies (n,) and ends (n, 2, 2) [m]."""
    joints: list[tuple[np.ndarray, np.ndarray]]
    """The two ends of the lines of joints: bodies (n,) and points (n, 1, 2) [m]. A line goes from anchor to
    anchor; where a joint holds these together, from each to the centre of its body, if that is dynamic."""
    dynamic: np.ndarray
    """Whether each body is dynamic, bool (bodies,)."""

    @classmethod
    def of(cls, model: Mapping[str, np.ndarray], world: int) -> WorldShapes:
        """Take the shapes from the arrays of a model and its joints by name (``model.fields.MODEL``, ``JOINTS``)."""
        bodies = slice(*map(int, model["body_start"][world : world + 2]))
        shapes = np.arange(*model["shape_start"][world : world + 2])
        owner = model["shape_body"][shapes] - bodies.start
        kinds, radius, first = model["shape_type"][shapes], model["shape_radius"][shapes], model["vertex_start"]
        vertices, normals = model["vertices"].astype(np.float64), model["vertex_normals"]
        outlines: list[tuple[np.ndarray, np.ndarray]] = []
        discs = kinds == ShapeType.DISC
        if discs.any():
            turn = np.linspace(0.0, 2.0 * np.pi, 33 if len(shapes) < FINE_SHAPES else 13)[:-1]
            circle = np.stack([np.cos(turn), np.sin(turn)], axis=1)
            centres = vertices[first[shapes[discs]]]
            outlines.append((owner[discs], centres[:, None] + radius[discs, None, None] * circle))
        by_length: dict[int, tuple[list[int], list[np.ndarray]]] = {}
        for i in np.flatnonzero(kinds == ShapeType.POLYGON):
            span = slice(first[shapes[i]], first[shapes[i] + 1])
            points = _rounded(vertices[span], normals[span], float(radius[i]))
            owners, items = by_length.setdefault(len(points), ([], []))
            owners.append(int(owner[i]))
            items.append(points)
        outlines += [(np.array(owners), np.stack(items)) for owners, items in by_length.values()]
        walls = kinds == ShapeType.SEGMENT
        ends = vertices[first[shapes[walls], None] + np.arange(2)].reshape(-1, 2, 2)
        rows = slice(*map(int, model["joint_start"][world : world + 2]))
        joined = [model[f"joint_body_{end}"][rows] - bodies.start for end in "ab"]
        anchors = [model[f"joint_anchor_{end}"][rows].astype(np.float64) for end in "ab"]
        dynamic = model["body_type"][bodies] == BodyType.DYNAMIC
        joints = _lines(model["joint_kind"][rows], joined, anchors, dynamic)
        return cls(bodies, outlines, (owner[walls], ends), joints, dynamic)


def _lines(
    kind: np.ndarray, joined: list[np.ndarray], anchors: list[np.ndarray], dynamic: np.ndarray
) -> list[tuple[np.ndarray, np.ndarray]]:
    """The two ends of the lines that show joints, see ``WorldShapes.joints``."""
    anchored = ~np.isin(kind, (JointKind.GEAR, JointKind.GENERAL))
    apart = anchored & np.isin(kind, (JointKind.DISTANCE, JointKind.PRISMATIC, JointKind.WHEEL, JointKind.TARGET))
    owners, points = [[body[apart]] for body in joined], [[anchor[apart]] for anchor in anchors]
    for body, anchor in zip(joined, anchors, strict=True):
        held = anchored & (kind != JointKind.DISTANCE) & dynamic[body]
        for end, at in enumerate((anchor[held], np.zeros((held.sum(), 2)))):
            owners[end].append(body[held])
            points[end].append(at)
    return [(np.concatenate(owners[end]), np.concatenate(points[end])[:, None]) for end in range(2)]


def _rounded(vertices: np.ndarray, normals: np.ndarray, radius: float) -> np.ndarray:
    """Outline a convex polygon that is grown by a radius, with an arc around each vertex, (points, 2) [m]."""
    if radius == 0.0:
        return vertices
    angle = np.arctan2(normals[:, 1], normals[:, 0])
    points = []
    for i, vertex in enumerate(vertices):
        turn = (angle[i] - angle[i - 1]) % (2.0 * np.pi)
        arc = angle[i - 1] + np.linspace(0.0, turn, max(2, int(np.ceil(turn / ARC)) + 1))
        points.append(vertex + radius * np.stack([np.cos(arc), np.sin(arc)], axis=1))
    return np.concatenate(points)


def _placed(points: np.ndarray, owner: np.ndarray, position: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Place points of bodies (n, points, 2) in world coordinates."""
    cosine, sine = np.cos(angle[owner])[:, None], np.sin(angle[owner])[:, None]
    x, y = points[..., 0], points[..., 1]
    turned = np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=-1)
    return turned + position[owner][:, None]


class WorldDrawing:
    """Draws the shapes of one world in an axes; ``update`` moves them."""

    def __init__(self, axes: Any, shapes: WorldShapes, position: np.ndarray, angle: np.ndarray) -> None:
        """Draw the shapes; position (bodies, 2) [m] and angle (bodies,) [rad] are those of the world's bodies."""
        collections = require("matplotlib.collections", "pipeline")
        self.shapes = shapes
        self.axes = axes
        self.fills = []
        width = float(np.clip(12.0 / np.sqrt(max(len(position), 1)), 0.1, 1.0))
        for owner, _ in shapes.outlines:
            color = np.where(shapes.dynamic[owner], FILL, "#b8c2cc")
            fill = collections.PolyCollection([], facecolors=color, edgecolors=EDGE, linewidths=width, zorder=1)
            self.fills.append(axes.add_collection(fill))
        self.marks = axes.add_collection(collections.LineCollection([], colors=EDGE, linewidths=width, zorder=1.5))
        self.joints = axes.add_collection(collections.LineCollection([], colors=GREEN, linewidths=1.5, zorder=4))
        self.walls = axes.add_collection(collections.LineCollection([], colors=INK, linewidths=2.5, zorder=5))
        axes.set_aspect("equal", anchor="N")
        axes.grid(False)
        axes.set(xlabel="x [m]", ylabel="y [m]")
        self.update(position, angle)

    def update(self, position: np.ndarray, angle: np.ndarray) -> None:
        """Move the shapes."""
        position, angle = position.astype(np.float64), angle.astype(np.float64)
        radii = []
        for fill, (owner, points) in zip(self.fills, self.shapes.outlines, strict=True):
            placed = _placed(points, owner, position, angle)
            fill.set_verts(placed)
            radii.append(np.stack([placed.mean(axis=1), placed[:, 0]], axis=1))
        self.marks.set_segments(np.concatenate(radii) if radii else [])
        joints = [_placed(anchor, owner, position, angle) for owner, anchor in self.shapes.joints]
        self.joints.set_segments(np.concatenate(joints, axis=1))
        owner, ends = self.shapes.segments
        self.walls.set_segments(_placed(ends, owner, position, angle))

    def fit(self, states: Sequence[tuple[np.ndarray, np.ndarray]]) -> None:
        """Show all bodies and joints in all states (position, angle); static chains only where they pass near."""
        drawn = [*self.shapes.outlines, *self.shapes.joints]
        parts = [_placed(points, owner, *state) for state in states for owner, points in drawn if len(owner)]
        owner, ends = self.shapes.segments
        parts = parts or [_placed(ends, owner, *states[0])]
        shown = np.concatenate([part.reshape(-1, 2) for part in parts])
        if not len(shown):
            return
        low, high = shown.min(axis=0), shown.max(axis=0)
        pad = 0.06 * float(max(*(high - low), 1e-9))
        self.axes.set_xlim(low[0] - pad, high[0] + pad)
        self.axes.set_ylim(low[1] - pad, high[1] + pad)


@dataclass(frozen=True)
class Forces:
    """The contact forces of one world."""

    lines: np.ndarray
    """Lines from a dynamic body's centre to the contact (n, 2, 2) [m]; two for a contact of two dynamic bodies."""
    points: np.ndarray
    """Contact points (contacts, 2) [m]."""
    normal: np.ndarray
    """Normal force of each contact (contacts,) [N]."""
    contact: np.ndarray
    """Index of the contact of each line (n,)."""

    @classmethod
    def of(cls, sim: Any, world: int) -> Forces:
        """Take the forces from the contacts of the latest step of a simulation."""
        contacts = sim.contacts
        first, count = int(contacts.numpy("contact_start")[world]), int(contacts.numpy("contact_count")[world])
        slots = slice(first, first + count)
        position, inverse = sim.state.numpy("position"), sim.model.numpy("inv_mass")
        bodies = [contacts.numpy(name)[slots] for name in ("body_a", "body_b")]
        arms = [contacts.numpy(name)[slots] for name in ("arm_a", "arm_b")]
        dt = float(contacts.numpy("contact_dt")[world])
        lines, index = [], []
        for body, arm in zip(bodies, arms, strict=True):
            moves = np.flatnonzero(inverse[body] > 0.0)
            centre = position[body[moves]].astype(np.float64)
            lines.append(np.stack([centre, centre + arm[moves]], axis=1))
            index.append(moves)
        normal = contacts.numpy("impulse")[slots, 0] / dt if dt > 0.0 else np.zeros(count)
        points = position[bodies[1]] + arms[1]
        return cls(np.concatenate(lines), points, normal, np.concatenate(index))


def draw_forces(axes: Any, forces: Forces, colorbar: bool = True) -> None:
    """Draw lines along which bodies press on each other, wider and darker the larger the normal force."""
    collections, colors = (require(f"matplotlib.{name}", "pipeline") for name in ("collections", "colors"))
    if not len(forces.normal):
        return
    top = max(float(forces.normal.max()), 1e-12)
    order = np.argsort(forces.normal[forces.contact], kind="stable")  # the largest on top
    value = forces.normal[forces.contact][order]
    scale = float(np.clip(18.0 / np.sqrt(len(forces.normal)), 0.1, 1.0))
    norm = colors.PowerNorm(0.6, -0.15 * top, top)  # begins below zero: the palest tones do not show on white
    lines = collections.LineCollection(
        forces.lines[order],
        linewidths=scale * (0.4 + FORCE_WIDTH * np.clip(value / top, 0.0, 1.0)),
        cmap=FORCE_MAP,
        norm=norm,
        capstyle="round",
        zorder=3,
    )
    lines.set_array(value)
    axes.add_collection(lines)
    axes.scatter(*forces.points.T, s=5.0 * scale**2, c=INK, linewidths=0, zorder=4)
    if colorbar:
        bar = axes.figure.colorbar(lines, ax=axes, shrink=0.6, pad=0.01, aspect=30)
        bar.ax.set_ylim(0.0, top)
        bar.set_label("normal force [N]")
        bar.outline.set_visible(False)


def arrays(sim: Any) -> dict[str, np.ndarray]:
    """Return the arrays from which a simulation's shapes are drawn, by name."""
    return {name: group.numpy(name) for group in (sim.model, sim.joints) for name in group.table}


def draw_world(axes: Any, sim: Any, world: int = 0, colorbar: bool = True) -> None:
    """Draw the present state of one world of a simulation, with its contact forces."""
    shapes = WorldShapes.of(arrays(sim), world)
    position, angle = sim.state.numpy("position")[shapes.bodies], sim.state.numpy("angle")[shapes.bodies]
    WorldDrawing(axes, shapes, position, angle).fit([(position, angle)])
    draw_forces(axes, Forces.of(sim, world), colorbar)
