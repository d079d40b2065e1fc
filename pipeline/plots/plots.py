"""Pictures: a world with its contact forces, a run over time, animations.

Figures are made without pyplot, so nothing global changes and no display is needed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dc_kernels.model.enums import BodyType, ShapeType
from dc_kernels.runtime.optional import require

INK = "#1f2933"
MUTED = "#66788a"
FILL = "#dce4ec"
EDGE = "#9fb0c0"
CYCLE = ("#c2410c", "#1d4ed8", "#0f766e", "#7c3aed", "#b45309", "#475569", "#be185d", "#4d7c0f")
LINES = ("-", "--", ":", "-.")
FORCE_MAP = "inferno_r"
STYLE = {
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "font.size": 9.5,
    "text.color": INK,
    "axes.edgecolor": MUTED,
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "axes.titlesize": 10.5,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e6ebf0",
    "grid.linewidth": 0.8,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "legend.frameon": False,
    "lines.linewidth": 1.8,
}
FORCE_WIDTH = 5.0  # [points] of the line of the largest force
ARC = 0.27  # largest angle between two points of an arc [rad]
FINE_SHAPES = 4000  # above this many shapes in a world discs are drawn with fewer points


@contextmanager
def figure(width: float, height: float) -> Iterator[Any]:
    """A figure of that size [inch] in the project's style, which holds inside the block."""
    matplotlib = require("matplotlib", "pipeline")
    with matplotlib.rc_context(STYLE):
        yield require("matplotlib.figure", "pipeline").Figure(figsize=(width, height), layout="constrained")


def save(fig: Any, path: Path, dpi: int = 130) -> None:
    """Write a figure; the suffix of the path says as what."""
    matplotlib = require("matplotlib", "pipeline")
    with matplotlib.rc_context(STYLE):
        fig.savefig(path, dpi=dpi)


@dataclass(frozen=True)
class WorldShapes:
    """Outlines of one world's shapes in their bodies' frames."""

    bodies: slice
    """The world's bodies among those of all worlds."""
    outlines: list[tuple[np.ndarray, np.ndarray]]
    """Of equally many points each: bodies (n,), within the world, and points (n, points, 2) [m]."""
    segments: tuple[np.ndarray, np.ndarray]
    """Static segments: bodies (n,) and ends (n, 2, 2) [m]."""
    joints: list[tuple[np.ndarray, np.ndarray]]
    """The two ends of distance joints: bodies (n,) and anchors (n, 1, 2) [m]."""
    dynamic: np.ndarray
    """Which bodies are dynamic (bodies,)."""

    @classmethod
    def of(cls, model: Mapping[str, np.ndarray], world: int) -> WorldShapes:
        """From the arrays of a model and its joints by name (``model.fields.MODEL``, ``model.fields.JOINTS``)."""
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
        joints = [
            (
                model[f"joint_body_{end}"][rows] - bodies.start,
                model[f"joint_anchor_{end}"][rows, None].astype(np.float64),
            )
            for end in "ab"
        ]
        return cls(bodies, outlines, (owner[walls], ends), joints, model["body_type"][bodies] == BodyType.DYNAMIC)


def _rounded(vertices: np.ndarray, normals: np.ndarray, radius: float) -> np.ndarray:
    """Outline of a convex polygon grown by a radius: an arc around each vertex (points, 2) [m]."""
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
    """Points of bodies (n, points, 2) in world coordinates."""
    cosine, sine = np.cos(angle[owner])[:, None], np.sin(angle[owner])[:, None]
    x, y = points[..., 0], points[..., 1]
    turned = np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=-1)
    return turned + position[owner][:, None]


class WorldDrawing:
    """The shapes of one world in an axes; ``update`` moves them."""

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
        self.joints = axes.add_collection(collections.LineCollection([], colors=CYCLE[2], linewidths=1.5, zorder=4))
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
    """From a dynamic body's centre to the contact (n, 2, 2) [m]; two for a contact of two dynamic bodies."""
    points: np.ndarray
    """Contact points (contacts, 2) [m]."""
    normal: np.ndarray
    """Normal force of each contact (contacts,) [N]."""
    contact: np.ndarray
    """The contact of each line (n,)."""

    @classmethod
    def of(cls, sim: Any, world: int) -> Forces:
        """The contacts of the latest step of a simulation."""
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
    """Lines along which the bodies press on each other, wider and darker the larger the normal force."""
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
    """What a simulation's shapes are drawn from, by name."""
    return {name: group.numpy(name) for group in (sim.model, sim.joints) for name in group.table}


def draw_world(axes: Any, sim: Any, world: int = 0, colorbar: bool = True) -> None:
    """The present state of one world of a simulation, with its contact forces."""
    shapes = WorldShapes.of(arrays(sim), world)
    position, angle = sim.state.numpy("position")[shapes.bodies], sim.state.numpy("angle")[shapes.bodies]
    WorldDrawing(axes, shapes, position, angle).fit([(position, angle)])
    draw_forces(axes, Forces.of(sim, world), colorbar)


def _over_worlds(axes: Any, time: np.ndarray, values: np.ndarray, color: str, label: str | None = None) -> None:
    """Median over the worlds of (steps, worlds), with the band that holds 80 % of them."""
    if values.shape[1] > 2:
        axes.fill_between(time, *np.percentile(values, (10, 90), axis=1), color=color, alpha=0.15, linewidth=0)
    axes.plot(time, np.median(values, axis=1), color=color, label=label, linewidth=1.4)


def summary_figure(sim: Any, series: Mapping[str, np.ndarray], dt: float, title: str) -> Any:
    """The final state of world 0 beside sweeps, contacts, energy and overlap over time.

    Args:
        sim: the simulation at its end.
        series: the per-step arrays of ``simulate.STEP_FIELDS``, (steps, worlds).
        dt: time step [s].
        title: of the figure.
    """
    worlds = series["sweeps"].shape[1]
    time = dt * np.arange(1, len(series["sweeps"]) + 1)
    with figure(14.0, 8.6) as fig:
        fig.suptitle(title, x=0.01, ha="left", fontsize=12, fontweight="bold")
        grid = fig.add_gridspec(3, 2, width_ratios=(1.25, 1.0))
        axes = fig.add_subplot(grid[:2, 0])
        draw_world(axes, sim)
        axes.set_title(f"world 0 after {len(time)} steps, {time[-1] if len(time) else 0.0:.2f} s")
        if not len(time):
            return fig
        sweeps, contacts, energy, overlap = (fig.add_subplot(grid[place]) for place in ((2, 0), (0, 1), (1, 1), (2, 1)))
        _over_worlds(sweeps, time, series["sweeps"], CYCLE[0])
        _over_worlds(contacts, time, series["contact_count"], MUTED, "within reach")
        _over_worlds(contacts, time, series["pressing_count"], CYCLE[1], "that press or overlap")
        kinetic, potential = series["kinetic_energy"], series["potential_energy"]
        _over_worlds(energy, time, kinetic + potential, INK, "total")
        _over_worlds(energy, time, potential, CYCLE[2], "potential")
        _over_worlds(energy, time, kinetic, CYCLE[0], "kinetic")
        _over_worlds(overlap, time, 1e3 * series["penetration_max"], CYCLE[3], "largest")
        _over_worlds(overlap, time, 1e3 * series["penetration_mean"], CYCLE[5], "mean of the contacts that press")
        panels = {"sweeps of the solver": sweeps, "contacts": contacts, "energy [J]": energy, "overlap [mm]": overlap}
        for name, panel in panels.items():
            panel.set_title(name + (f" (median and 10-90 % of {worlds} worlds)" if worlds > 2 else ""))
            panel.set_xlim(0.0, time[-1])
            if panel is not sweeps:
                panel.legend(fontsize=8, loc="best")
        for panel in (sweeps, overlap):
            panel.set_xlabel("time [s]")
        for panel in (sweeps, contacts, overlap):
            panel.set_ylim(bottom=0.0)
    return fig


def animate(trajectory: Path, target: Path, world: int = 0, rate: float = 25.0, progress: Any = None) -> None:
    """Draw one world of a trajectory, in real time as far as its records allow.

    Args:
        trajectory: file written by ``simulate``.
        target: .gif or .mp4.
        world: index of the world.
        rate: most pictures per second [1/s].
        progress: wraps the list of pictures, as tqdm does.

    Raises:
        ImportError: naming the extra, without ffmpeg for .mp4.
    """
    h5py, animation = require("h5py", "pipeline"), require("matplotlib.animation", "pipeline")
    with h5py.File(trajectory, "r") as file, figure(7.0, 7.0) as fig:
        shapes = WorldShapes.of({name: data[...] for name, data in file["model"].items()}, world)
        time = file["record/time"][...]
        every = max(1, round(1.0 / (rate * float(np.diff(time[:2])[0])))) if len(time) > 1 else 1
        frames = np.arange(0, len(time), every)
        spacing = float(time[every] - time[0]) if len(time) > every else 1.0 / rate
        axes = fig.add_subplot()

        def state(record: int) -> tuple[np.ndarray, np.ndarray]:
            return file["record/position"][record, shapes.bodies], file["record/angle"][record, shapes.bodies]

        drawing = WorldDrawing(axes, shapes, *state(0))
        drawing.fit([state(0), state(len(time) // 2), state(-1)])
        axes.set_title("0.00 s")
        fig.canvas.draw()
        fig.set_layout_engine("none")  # once is enough
        if target.suffix == ".mp4":
            ffmpeg = require("imageio_ffmpeg", "pipeline").get_ffmpeg_exe()
            require("matplotlib", "pipeline").rcParams["animation.ffmpeg_path"] = (
                ffmpeg  # until the figure's block ends
            )
            writer = animation.FFMpegWriter(fps=min(rate, 1.0 / spacing))
        else:
            writer = animation.PillowWriter(fps=min(rate, 1.0 / spacing))
        with writer.saving(fig, str(target), dpi=90):
            for record in progress(frames) if progress else frames:
                drawing.update(*state(int(record)))
                axes.set_title(f"{time[record]:.2f} s")
                writer.grab_frame()
