"""Named scenes: what stands in each world, seeded.

A scene is a frozen dataclass; ``build(worlds, seed)`` returns a ``ModelBuilder`` with one world per
seed ``seed, seed + 1, ...``. A world depends on its own seed alone, not on how many are built with it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar, Literal, get_args

import numpy as np

import dc_kernels as dc
from dc_kernels.model.shapes import MAX_VERTICES

THESIS_SIDE = 15.0  # [m] of the thesis protocol's box, for THESIS_BODIES discs of THESIS_RADIUS
THESIS_BODIES = 100
THESIS_RADIUS = 0.5  # [m]
CLEARANCE = 1e-4  # gap between placed discs, in diameters: still positive after rounding to float32
SETTLED_GAP = 5e-4  # gap of the dense packing, in diameters: inside the speculative margin
PLACEMENT_ATTEMPTS = 200  # fresh starts of a world whose random placement jammed

# (first, count) -> the next candidates of a world, numbered from first since its last fresh start, (count, 2) [m]
Sampler = Callable[[int, int], np.ndarray]


def _neighbour_offsets(width: int) -> list[np.ndarray]:
    """Offsets to the 21 cells within reach, the likeliest hits first, in groups checked one after the other."""
    near = [(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)]
    diagonal = [(1, 1), (1, -1), (-1, 1), (-1, -1)]
    far = [(x, y) for y in range(-2, 3) for x in range(-2, 3) if max(abs(x), abs(y)) == 2 and abs(x * y) < 4]
    return [np.array([y * width + x for x, y in group]) for group in (near, diagonal, far)]


def place_discs(samplers: Sequence[Sampler], count: int, distance: float, size: tuple[float, float]) -> np.ndarray:
    """Random sequential addition: candidates in their order, each kept if it overlaps none kept before.

    Worlds and candidates are tested in parallel, but the result is that of the plain sequential loop.
    Cells of side ``distance / sqrt(2)`` hold at most one disc, so a candidate looks at 21 cells.

    Args:
        samplers: for each world, its stream of candidates; outside ``size`` they are dropped.
        count: discs in each world.
        distance: least distance of two centres [m].
        size: width and height of the region of the centres [m], which begins at (0, 0).

    Returns:
        Centres (worlds, count, 2) [m], in the order they were placed.

    Raises:
        ValueError: when the discs do not fit.
    """
    most = 2.0 / math.sqrt(3.0) * size[0] * size[1] / distance**2 + (size[0] + size[1]) / distance + 1.0  # Groemer 1960
    full = f"bodies is {count}: so many do not fit into {size[0]:.3g} x {size[1]:.3g} m of centres"
    if count > most:
        raise ValueError(f"{full}; it must be <= {int(most)}")
    cell = distance / math.sqrt(2.0)
    width, height = int(size[0] / cell) + 5, int(size[1] / cell) + 5  # two empty cells on each side
    worlds, cells = len(samplers), width * height
    groups = _neighbour_offsets(width)
    reach = np.concatenate(groups)
    grid_x, grid_y = np.full(worlds * cells, np.inf), np.full(worlds * cells, np.inf)
    none = np.iinfo(np.int64).max
    first_here = np.full(worlds * cells, none)  # first undecided candidate of a cell

    def free(index: np.ndarray, x: np.ndarray, y: np.ndarray, home: np.ndarray) -> np.ndarray:
        """Those of the candidates ``index`` that overlap no placed disc."""
        for group in groups:
            at = home[index, None] + group
            gap = (grid_x[at] - x[index, None]) ** 2 + (grid_y[at] - y[index, None]) ** 2
            index = index[~(gap < distance * distance).any(axis=1)]
        return index

    block = max(count, 32)
    limit = 64 * block  # candidates before a jammed world starts anew; at the thesis density about 8 are needed
    result = np.empty((worlds, count, 2))
    placed = np.zeros(worlds, np.int64)
    tried = 0
    active = np.arange(worlds)
    while len(active):
        if tried and tried % limit == 0:  # jammed: all still active worlds are, as they went through equally many
            if tried >= limit * PLACEMENT_ATTEMPTS:
                raise ValueError(full)
            for grid in (grid_x, grid_y):
                grid.reshape(worlds, cells)[active] = np.inf
            placed[active] = 0
        points = np.concatenate([samplers[w](tried % limit, block) for w in active.tolist()])
        tried += block
        x, y = np.ascontiguousarray(points[:, 0]), np.ascontiguousarray(points[:, 1])
        owner = np.repeat(active, block)
        inside = (x >= 0.0) & (x <= size[0]) & (y >= 0.0) & (y <= size[1])
        with np.errstate(invalid="ignore"):
            home = owner * cells + ((y / cell).astype(np.int64) + 2) * width + (x / cell).astype(np.int64) + 2
        home[~inside] = 0
        undecided = free(np.flatnonzero(inside), x, y, home)
        accepted = []
        while len(undecided):
            # a candidate is in when no undecided one in reach comes before it
            first_here[home[undecided[::-1]]] = undecided[::-1]
            ready = undecided[first_here[home[undecided, None] + reach].min(axis=1) == undecided]
            first_here[home[undecided]] = none
            grid_x[home[ready]], grid_y[home[ready]] = x[ready], y[ready]
            accepted.append(ready)
            undecided = free(undecided[~np.isin(undecided, ready, assume_unique=True)], x, y, home)
        index = np.sort(np.concatenate(accepted)) if accepted else np.empty(0, np.int64)
        world = owner[index]
        slot = placed[world] + np.arange(len(index)) - np.searchsorted(world, world)
        fits = slot < count
        result[world[fits], slot[fits]] = points[index[fits]]
        placed += np.bincount(world, minlength=worlds)
        active = active[placed[active] < count]
    return result


def _check(scene: Any, low: float, names: Sequence[str], strict: bool = True) -> None:
    """Raise ``ValueError`` unless the named parameters are finite and above ``low``."""
    for name in names:
        value = getattr(scene, name)
        if not (math.isfinite(value) and (value > low or (value == low and not strict))):
            raise ValueError(f"{scene.name}.{name} is {value!r}; it must be finite and {'>' if strict else '>='} {low}")


@dataclass(frozen=True, kw_only=True)
class Scene:
    """What every scene has."""

    name: ClassVar[str]

    friction: float = 0.5
    """Coulomb coefficient of all shapes [1]."""
    restitution: float = 0.0
    """Coefficient of restitution of all shapes, 0 to 1 [1]."""
    density: float = 1.0
    """Mass per area of all shapes [kg/m^2]."""
    gravity: float = 9.8
    """Downward acceleration [m/s^2]."""

    def check(self) -> None:
        """Raise a ``ValueError`` that names the parameter which is out of its range."""
        _check(self, 0.0, [f.name for f in fields(self) if f.name in ("bodies", "rows", "radius", "half_width")])
        _check(self, 0.0, ("density",))
        _check(self, 0.0, ("friction", "restitution"), strict=False)
        if self.restitution > 1.0:
            raise ValueError(f"{self.name}.restitution is {self.restitution!r}; it must be <= 1")

    @property
    def material(self) -> dict[str, Any]:
        """Keywords of ``ModelBuilder.add_*`` for the shapes' material."""
        return {"friction": self.friction, "restitution": self.restitution, "density": self.density}

    def build(self, worlds: int = 1, seed: int = 0) -> dc.ModelBuilder:
        """One world for each of the seeds ``seed .. seed + worlds - 1``.

        Raises:
            ValueError: for ``worlds`` < 1, ``seed`` < 0, or a parameter out of its range.
        """
        self.check()
        if worlds < 1:
            raise ValueError(f"worlds is {worlds}; it must be >= 1")
        if seed < 0:
            raise ValueError(f"seed is {seed}; it must be >= 0")
        builder = dc.ModelBuilder()
        self.add_worlds(builder, [np.random.Generator(np.random.PCG64(seed + i)) for i in range(worlds)])
        return builder

    def add_worlds(self, builder: dc.ModelBuilder, streams: Sequence[np.random.Generator]) -> None:
        """Add one world for each random stream."""
        for stream in streams:
            builder.add_world(gravity=(0.0, -self.gravity))
            self.add_bodies(builder, stream)

    def add_bodies(self, builder: dc.ModelBuilder, stream: np.random.Generator) -> None:
        """Fill the world just begun."""
        raise NotImplementedError

    def add_static_chain(self, builder: dc.ModelBuilder, vertices: Sequence[tuple[float, float]]) -> int:
        """A static body with a chain of segments."""
        body = builder.add_body(type=dc.BodyType.STATIC)
        material = self.material
        del material["density"]
        builder.add_chain(body, vertices, **material)
        return body

    def add_open_box(self, builder: dc.ModelBuilder, width: float, height: float) -> int:
        """Left wall, floor and right wall; the floor begins at (0, 0)."""
        return self.add_static_chain(builder, [(0.0, height), (0.0, 0.0), (width, 0.0), (width, height)])


@dataclass(frozen=True, kw_only=True)
class Thesis(Scene):
    """Discs at random places in an open box, the worlds of the thesis protocol; its area grows with the discs'."""

    name: ClassVar[str] = "thesis"

    bodies: int = THESIS_BODIES
    """Discs in each world [1]."""
    radius: float = THESIS_RADIUS
    """Radius of the discs [m]."""

    @property
    def side(self) -> float:
        """Width and height of the box [m]: 15 m for 100 discs of 0.5 m, equal density for any others."""
        return THESIS_SIDE * math.sqrt(self.bodies / THESIS_BODIES) * self.radius / THESIS_RADIUS

    def add_worlds(self, builder: dc.ModelBuilder, streams: Sequence[np.random.Generator]) -> None:
        """Place the discs of all worlds at once, then add them."""
        low = self.radius * (1.0 + CLEARANCE)
        free = self.side - 2.0 * low
        distance = 2.0 * self.radius * (1.0 + CLEARANCE)
        centres = place_discs([self.sampler(s, free) for s in streams], self.bodies, distance, (free, free)) + low
        for world in centres:
            builder.add_world(gravity=(0.0, -self.gravity))
            self.add_open_box(builder, self.side, self.side)
            # numbered by place, up and down strips: neighbours then are near in memory, worth a third at 1e5 discs
            strip = np.floor(world[:, 0] / (2.0 * distance))
            builder.add_discs(world[np.lexsort((world[:, 1], strip))], self.radius, **self.material)

    def sampler(self, stream: np.random.Generator, free: float) -> Sampler:
        """Candidates uniform in the square of side ``free`` [m]."""
        return lambda first, count: stream.random((count, 2)) * free


@dataclass(frozen=True, kw_only=True)
class ThesisClustered(Thesis):
    """As thesis, but the discs begin in Gaussian clusters."""

    name: ClassVar[str] = "thesis-clustered"

    clusters: int = 3
    """Clusters, with centres uniform in the middle half of the box [1]."""
    spread: float = 0.12
    """Standard deviation of a cluster, which widens as it fills [side of the box]."""

    def check(self) -> None:
        super().check()
        _check(self, 0.0, ("clusters", "spread"))

    def sampler(self, stream: np.random.Generator, free: float) -> Sampler:
        """Candidates normal around each centre in turn; the deviation grows with them, up to the box's side."""
        centres = (0.25 + 0.5 * stream.random((self.clusters, 2))) * free

        def sample(first: int, count: int) -> np.ndarray:
            number = np.arange(first, first + count)
            deviation = self.side * np.minimum(self.spread * (1.0 + number / (10.0 * self.bodies)), 1.0)
            return centres[number % self.clusters] + deviation[:, None] * stream.standard_normal((count, 2))

        return sample


@dataclass(frozen=True, kw_only=True)
class Settled(Thesis):
    """As many discs as in thesis, packed hexagonally on the floor with a small jitter: near rest from the start."""

    name: ClassVar[str] = "settled"

    def add_worlds(self, builder: dc.ModelBuilder, streams: Sequence[np.random.Generator]) -> None:
        """Rows from wall to wall and, between them, rows of one disc less in their pockets."""
        diameter = 2.0 * self.radius
        pitch = diameter * (1.0 + SETTLED_GAP)
        gap = diameter * SETTLED_GAP
        columns = max(int(self.side / diameter), 2)
        width = max(self.side, diameter + (columns - 1) * pitch + 2.0 * gap)
        step = (width - diameter - 2.0 * gap) / (columns - 1)  # stretched, so that full rows lean on both walls
        rise = math.sqrt(max(pitch**2 - (0.5 * step) ** 2, 0.25 * pitch**2))
        number = np.arange(self.bodies)
        pair, place = np.divmod(number, 2 * columns - 1)  # of a full row and a short one
        short = place >= columns
        x = self.radius + gap + step * np.where(short, place - columns + 0.5, place)
        y = self.radius + gap + rise * (2 * pair + short)
        for stream in streams:
            angle = 2.0 * math.pi * stream.random(self.bodies)
            shift = 0.45 * gap * stream.random(self.bodies)  # two of them stay below the gap
            builder.add_world(gravity=(0.0, -self.gravity))
            self.add_open_box(builder, width, max(self.side, float(y[-1]) + diameter))
            positions = np.stack([x + shift * np.cos(angle), y + shift * np.sin(angle)], axis=1)
            builder.add_discs(positions, self.radius, **self.material)


@dataclass(frozen=True, kw_only=True)
class Stack(Scene):
    """Boxes on top of each other."""

    name: ClassVar[str] = "stack"

    bodies: int = 10
    """Boxes [1]."""
    half_width: float = 0.5
    """Half of the boxes' side [m]."""
    jitter: float = 0.005
    """Largest sideways offset of a box, uniform [m]."""

    def add_bodies(self, builder: dc.ModelBuilder, stream: np.random.Generator) -> None:
        """The floor and the boxes."""
        half = self.half_width
        self.add_static_chain(builder, [(-20.0 * half, 0.0), (20.0 * half, 0.0)])
        for i, offset in enumerate(stream.uniform(-self.jitter, self.jitter, self.bodies)):
            body = builder.add_body((float(offset), (2 * i + 1) * half))
            builder.add_box(body, half, half, **self.material)


@dataclass(frozen=True, kw_only=True)
class Pyramid(Scene):
    """Rows of boxes, each with one box less than the row below."""

    name: ClassVar[str] = "pyramid"

    rows: int = 10
    """Boxes in the lowest row [1]."""
    half_width: float = 0.5
    """Half of the boxes' side [m]."""
    spacing: float = 0.1
    """Free width between two boxes of a row [half_width]."""
    jitter: float = 0.002
    """Largest sideways offset of a box, uniform [m]."""

    def add_bodies(self, builder: dc.ModelBuilder, stream: np.random.Generator) -> None:
        """The floor and the boxes."""
        half, pitch = self.half_width, self.half_width * (2.0 + self.spacing)
        extent = pitch * self.rows
        self.add_static_chain(builder, [(-extent, 0.0), (extent, 0.0)])
        for row in range(self.rows):
            count = self.rows - row
            for column, offset in enumerate(stream.uniform(-self.jitter, self.jitter, count)):
                x = (column - 0.5 * (count - 1)) * pitch + float(offset)
                body = builder.add_body((x, (2 * row + 1) * half))
                builder.add_box(body, half, half, **self.material)


@dataclass(frozen=True, kw_only=True)
class Incline(Scene):
    """One body on a slope, touching it, at rest."""

    name: ClassVar[str] = "incline"

    shape: Literal["box", "disc"] = "box"
    """What lies on the slope."""
    angle: float = 0.4
    """Angle of the slope; downhill is to the left [rad]."""
    radius: float = 0.5
    """Radius of the disc, half of the box's side [m]."""
    length: float = 200.0
    """Length of the slope, the body begins in its middle [m]."""

    def check(self) -> None:
        super().check()
        _check(self, 0.0, ("length",))
        if not 0.0 <= self.angle < 0.5 * math.pi:
            raise ValueError(f"{self.name}.angle is {self.angle!r}; it must lie in [0, pi / 2)")

    def add_bodies(self, builder: dc.ModelBuilder, stream: np.random.Generator) -> None:
        """The slope and the body."""
        cosine, sine = math.cos(self.angle), math.sin(self.angle)
        half = 0.5 * self.length
        self.add_static_chain(builder, [(-half * cosine, -half * sine), (half * cosine, half * sine)])
        body = builder.add_body((-sine * self.radius, cosine * self.radius), angle=self.angle)
        if self.shape == "disc":
            builder.add_disc(body, self.radius, **self.material)
        else:
            builder.add_box(body, self.radius, self.radius, **self.material)


@dataclass(frozen=True, kw_only=True)
class Mixed(Scene):
    """Discs, boxes, polygons of 3 to 8 vertices and capsules of random sizes, which fall into an open box."""

    name: ClassVar[str] = "mixed"

    bodies: int = 100
    """Bodies in each world [1]."""
    radius: float = 0.5
    """Radius of the largest body [m]."""
    size_ratio: float = 2.0
    """The largest radius over the smallest [1]."""

    def check(self) -> None:
        super().check()
        _check(self, 1.0, ("size_ratio",), strict=False)

    @property
    def side(self) -> float:
        """Width and height of the box [m]."""
        return THESIS_SIDE * math.sqrt(self.bodies / THESIS_BODIES) * self.radius / THESIS_RADIUS

    def add_bodies(self, builder: dc.ModelBuilder, stream: np.random.Generator) -> None:
        """The box and the bodies: kinds in turn, each inside a disc of its size."""
        self.add_open_box(builder, self.side, self.side)
        free = self.side - 2.0 * self.radius

        def sample(first: int, count: int) -> np.ndarray:
            return stream.random((count, 2)) * free

        centres = place_discs([sample], self.bodies, 2.0 * self.radius, (free, free))[0] + self.radius
        for i, centre in enumerate(centres):
            size = self.radius * float(stream.uniform(1.0 / self.size_ratio, 1.0)) * (1.0 - CLEARANCE)
            angle = float(stream.uniform(-math.pi, math.pi))
            body = builder.add_body((float(centre[0]), float(centre[1])), angle=angle)
            kind = i % 4
            if kind == 0:
                builder.add_disc(body, size, **self.material)
            elif kind == 1:
                slant = float(stream.uniform(0.2, 0.3)) * math.pi
                builder.add_box(body, size * math.cos(slant), size * math.sin(slant), **self.material)
            elif kind == 2:
                count = int(stream.integers(3, MAX_VERTICES + 1))
                turn = (np.arange(count) + stream.uniform(-0.3, 0.3, count)) * (2.0 * math.pi / count)
                builder.add_polygon(body, size * np.stack([np.cos(turn), np.sin(turn)], axis=1), **self.material)
            else:
                thickness = size * float(stream.uniform(0.3, 0.6))
                reach = size - thickness
                builder.add_capsule(body, (-reach, 0.0), (reach, 0.0), thickness, **self.material)


@dataclass(frozen=True, kw_only=True)
class Chain(Scene):
    """A pendulum: discs hung one after the other on distance joints, let go from a horizontal line."""

    name: ClassVar[str] = "chain"

    bodies: int = 10
    """Discs [1]."""
    radius: float = 0.2
    """Radius of the discs [m]."""
    length: float = 1.0
    """Length of a joint [m]."""
    jitter: float = 0.01
    """Largest vertical offset of a disc, uniform [m]."""

    def check(self) -> None:
        super().check()
        _check(self, 2.0 * self.radius, ("length",))

    def add_bodies(self, builder: dc.ModelBuilder, stream: np.random.Generator) -> None:
        """The fixed point, the discs and the joints."""
        previous = builder.add_body(type=dc.BodyType.STATIC)
        for i, offset in enumerate(stream.uniform(-self.jitter, self.jitter, self.bodies)):
            body = builder.add_body(((i + 1) * self.length, float(offset)))
            builder.add_disc(body, self.radius, **self.material)
            builder.add_distance_joint(previous, body)
            previous = body


AnyScene = Thesis | ThesisClustered | Settled | Stack | Pyramid | Incline | Mixed | Chain
SCENES: dict[str, type[Scene]] = {scene.name: scene for scene in get_args(AnyScene)}


def scene(name: str, **parameters: Any) -> Scene:
    """The scene of a name, with the given parameters.

    Raises:
        ValueError: for an unknown name or parameter.
    """
    if name not in SCENES:
        raise ValueError(f"scene is {name!r}; it must be one of {tuple(SCENES)}")
    known = [f.name for f in fields(SCENES[name])]
    for parameter in parameters:
        if parameter not in known:
            raise ValueError(f"{name} has no parameter {parameter!r}; it has {tuple(known)}")
    return SCENES[name](**parameters)
