"""The arrays of a simulation: what each is called, what it means, its unit, shape and dtype.

Every array of deep-contact has one name, used for the attribute, the kernel argument and the HDF5
dataset alike. The tables below are the single source for allocation, validation, snapshots and the
memory report. Worlds are an axis: bodies, shapes and joints of all worlds lie flat, one world after
the other, and ``*_start`` arrays of length W + 1 hold the first element of each world.

Conventions (tested): SI units; a contact normal points from body A to body B, where A is the static
body or the one with the lower index; the tangent is the normal turned by -90 degrees,
``t = (n_y, -n_x)``; impulses are in N s and act on B, the opposite ones on A.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import IntEnum, IntFlag
from typing import Literal


class BodyType(IntEnum):
    """How a body moves."""

    STATIC = 0  # never moves, infinite mass
    KINEMATIC = 1  # moves with the velocity it is given, infinite mass
    DYNAMIC = 2  # moves by forces and contacts


class ShapeType(IntEnum):
    """What a shape's vertices mean; every shape is the sum of its vertices' hull and a disc of ``shape_radius``."""

    DISC = 0  # one vertex, radius > 0
    POLYGON = 1  # 2 vertices (capsule, radius > 0) or 3-8 vertices counter-clockwise, radius >= 0
    SEGMENT = 2  # vertices v1, v2 and the chain's neighbours: one before v1, one after v2 (v1, v2 again if none)


class Flag(IntFlag):
    """Why a world does not advance; bits of ``State.flags``."""

    NONE = 0
    PAIR_OVERFLOW = 1  # more candidate pairs than reserved
    CONTACT_OVERFLOW = 2  # more contact points than reserved
    ROW_OVERFLOW = 4  # more blocks of solver rows than reserved
    NONFINITE = 8  # a velocity or position became NaN or inf: the world keeps its last finite state


CAPACITY_FLAGS = Flag.PAIR_OVERFLOW | Flag.CONTACT_OVERFLOW | Flag.ROW_OVERFLOW

MAX_VERTICES = 8  # of a polygon: a feature id of 4 bits an edge or vertex fits the key with room to spare
# contacts solved, nodes or neighbours weighed, side by side; 16 contacts gained under 5 % and pad small worlds far more
LANES = 8
COLORS = 64  # colours of the contact graph: bits of a mask; the last one is the serial overflow colour
SERIAL_COLOR = COLORS - 1
METHODS = {"pgs": 0, "jacobi": 1}  # how kernels know a choice of SolverConfig
ACCELERATIONS = {"none": 0, "sor": 1, "aitken": 2, "nncg": 3, "adaptive": 4}
STOPS = {"change": 0, "residual": 1}
# a world's iteration in flight: sweeps done, sweeps into the Aitken period, its length, finished, periods without
# progress, plain sweeps to follow them, a period's end put off by a pause, sweep whose step was measured for a pause;
# of "adaptive": sweeps into the stretch, its method, length of the stretch before, periods without Anderson's update to
# come, how many when it next does harm, iterates remembered, whether the period began with an update
COUNTERS = 16
# change of this sweep, |step|^2 of the sweep before the period's last, of the period or sweep before, least so far, of
# the last two sweeps before a pause; of "adaptive": rate of each method, |step|^2 of the stretch's first sweep,
# Nesterov's t, |step|^2 before Anderson's update, its eight sums of products; least change of a stretch's first sweep,
# or of any since half the cap
NORMS = 21
ADAPT_AITKEN, ADAPT_MOMENTUM, ADAPT_ANDERSON = 0, 1, 2  # methods of "adaptive"
# arrays of row impulses that an accelerated solve looks back on: two iterates and their steps, the iterate of the least
# change
HISTORY = 5
BEST = 4
RETREAT = 4.0  # times the least change: a solve that hits its cap beyond goes back to where that was
ANDERSON_PERIOD = 3  # sweeps between two updates
ANDERSON_REST, ANDERSON_REST_MAX = 4, 64  # periods without it after one that did harm
NEVER = 2**30  # sweeps until a pause, where there is none
BAND = 8  # rows of an image that are cleared and marked together
CHUNK = 4096  # points that one thread index gathers
TILE_ROWS, TILE_COLUMNS = 64, 64  # nodes of a tile that a large image is splatted by: 80 KB for 4 channels
KEY_SHAPE_BITS = 23  # contact key = shape A | shape B | feature, 23 + 23 + 16 bits, indices within the world
KEY_FEATURE_BITS = 16


@dataclass(frozen=True)
class Field:
    """One array: ``per`` names its axis; ``dtype`` is "real", "vec2", "vec4" (of the model's scalar) or fixed."""

    name: str
    per: str
    dtype: str
    unit: str
    meaning: str


def _table(*rows: tuple[str, str, str, str, str]) -> dict[str, Field]:
    return {row[0]: Field(*row) for row in rows}


# axes: world W, world+1, body, body+1 (behind the bodies: padding bodies of empty solver lanes), shape, shape+1,
# vertex, joint, contact (capacity), pair (capacity), block (capacity, of LANES solver rows), bucket
MODEL = _table(
    ("body_start", "world+1", "int32", "1", "first body of each world"),
    ("shape_start", "world+1", "int32", "1", "first shape of each world"),
    ("joint_start", "world+1", "int32", "1", "first joint of each world"),
    ("gravity", "world", "vec2", "m/s^2", "acceleration of every dynamic body"),
    ("origin", "world", "vec2d", "m", "where the world's coordinates begin: positions are relative to it"),
    ("length_scale", "world", "real", "m", "typical diameter of its dynamic shapes; margins are multiples of it"),
    ("cell_size", "world", "real", "m", "finest cell of the broadphase's cell list"),
    ("body_type", "body", "int32", "1", "BodyType"),
    ("mass", "body", "real", "kg", "mass; 0 where infinite"),
    ("inertia", "body", "real", "kg m^2", "moment of inertia about the centre of mass; 0 where infinite"),
    ("inv_mass", "body", "real", "1/kg", "0 for static and kinematic bodies"),
    ("inv_inertia", "body", "real", "1/(kg m^2)", "0 for static, kinematic and non-rotating bodies"),
    ("center_of_mass", "body", "vec2", "m", "in the frame the shapes were given in; vertices are relative to it"),
    ("body_shape_start", "body+1", "int32", "1", "first shape of each body; shapes are sorted by body"),
    ("shape_body", "shape", "int32", "1", "body of the shape"),
    ("shape_type", "shape", "int32", "1", "ShapeType"),
    ("shape_radius", "shape", "real", "m", "radius of a disc or capsule, rounding of a polygon"),
    ("shape_center", "shape", "vec2", "m", "centroid in the body's frame"),
    ("shape_extent", "shape", "real", "m", "distance from shape_center to the farthest point, radius included"),
    ("shape_friction", "shape", "real", "1", "Coulomb coefficient; a pair has sqrt(f1 f2)"),
    ("shape_restitution", "shape", "real", "1", "coefficient in [0, 1]; a pair has the larger"),
    ("shape_category", "shape", "uint32", "1", "bits of what the shape is"),
    ("shape_mask", "shape", "uint32", "1", "bits of what it collides with; both shapes must accept each other"),
    ("vertex_start", "shape+1", "int32", "1", "first vertex of each shape"),
    ("vertices", "vertex", "vec2", "m", "in the body's frame, relative to the centre of mass"),
    ("vertex_normals", "vertex", "vec2", "1", "outward normal of the edge from this vertex to the next"),
)

STATE = _table(
    ("position", "body", "vec2", "m", "centre of mass, relative to the world's origin"),
    ("angle", "body", "real", "rad", "rotation, counter-clockwise"),
    ("velocity", "body", "vec2", "m/s", "of the centre of mass"),
    ("angular_velocity", "body", "real", "rad/s", "counter-clockwise"),
    ("force", "body", "vec2", "N", "applied at the centre of mass in every step until changed"),
    ("torque", "body", "real", "N m", "applied in every step until changed"),
    ("time", "world", "float64", "s", "simulated time"),
    ("flags", "world", "int32", "1", "Flag bits; a world with any bit set does not advance"),
)

CONTACTS = _table(
    ("contact_start", "world+1", "int32", "1", "first reserved slot of each world"),
    ("contact_count", "world", "int32", "1", "contacts of each world, in slots from contact_start, sorted by key"),
    ("contact_dt", "world", "real", "s", "time step of the impulses, 0 before the first"),
    ("key", "contact", "int64", "1", "shape A, shape B, feature: the same contact has the same key in each step"),
    ("body_a", "contact", "int32", "1", "body A"),
    ("body_b", "contact", "int32", "1", "body B"),
    ("normal", "contact", "vec2", "1", "unit vector from A to B"),
    ("arm_a", "contact", "vec2", "m", "from the centre of mass of A to the contact point, world axes"),
    ("arm_b", "contact", "vec2", "m", "from the centre of mass of B to the contact point, world axes"),
    ("gap", "contact", "real", "m", "distance of the surfaces, negative where they overlap"),
    ("friction", "contact", "real", "1", "Coulomb coefficient of the pair"),
    ("restitution", "contact", "real", "1", "coefficient of restitution of the pair"),
    ("impulse", "contact", "vec2", "N s", "normal and tangential impulse: before the solve its start, then its result"),
    ("color", "contact", "int32", "1", "colour in the contact graph, kept while the contact lives"),
    ("age", "contact", "int32", "1", "steps since the contact began, 0 when new"),
)

JOINTS = _table(
    ("joint_body_a", "joint", "int32", "1", "body A"),
    ("joint_body_b", "joint", "int32", "1", "body B"),
    ("joint_anchor_a", "joint", "vec2", "m", "in the frame of body A, relative to its centre of mass"),
    ("joint_anchor_b", "joint", "vec2", "m", "in the frame of body B, relative to its centre of mass"),
    ("joint_length", "joint", "real", "m", "distance that the joint keeps between its anchors"),
    ("joint_color", "joint", "int32", "1", "colour in the constraint graph"),
    ("joint_impulse", "joint", "real", "N s", "along the line from anchor A to anchor B, positive pushes apart"),
)


CACHE = _table(
    ("cache_count", "world", "int32", "1", "contacts of the last finished step"),
    ("cache_key", "contact", "int64", "1", "their keys, sorted"),
    ("cache_impulse", "contact", "vec2", "N s", "their solved impulses"),
    ("cache_color", "contact", "int32", "1", "their colours"),
    ("cache_age", "contact", "int32", "1", "their ages"),
    ("joint_cache", "joint", "real", "N s", "solved impulses of the joints in the last finished step"),
)

PAIRS = _table(
    ("bucket_start", "world+1", "int32", "1", "first bucket of each world; a power of two of them and one more"),
    ("bucket", "bucket", "int32", "1", "first entry of each bucket in sorted_shape"),
    ("cell", "shape", "vec3i", "1", "cell of the shape's box: column, row, level"),
    ("sorted_shape", "shape", "int32", "1", "shapes sorted by bucket"),
    ("box", "shape", "vec4", "m", "low x, low y, high x, high y, with margin"),
    ("pair_start", "world+1", "int32", "1", "first reserved pair of each world"),
    ("pair_count", "world", "int32", "1", "candidate pairs of each world, sorted by (A, B)"),
    ("pair_needed", "world", "int32", "1", "pairs found at the last rebuild, also those without room"),
    ("pair_valid", "world", "int32", "1", "0: rebuild in the next step"),
    ("rebuilds", "world", "int32", "1", "rebuilds so far"),
    ("pair_a", "pair", "int32", "1", "shape A"),
    ("pair_b", "pair", "int32", "1", "shape B"),
    ("temp_a", "pair", "int32", "1", "shape A, half sorted"),
    ("temp_b", "pair", "int32", "1", "shape B, half sorted"),
)

ROWS = _table(
    ("contact_needed", "world", "int32", "1", "contacts found, also those without room"),
    ("slot", "contact", "int32", "1", "where the contact's normal impulse lies in row_impulse"),
    ("joint_slot", "joint", "int32", "1", "the same of a joint"),
    ("color_mask", "body", "uint64", "1", "colours taken at the body"),
    ("body_rows", "body+1", "int32", "1", "rows that act on the body"),
    ("block_start", "world+1", "int32", "1", "first reserved block of each world"),
    ("block_needed", "world", "int32", "1", "blocks of the present step, also those without room"),
    ("color_block", "world color+1", "int32", "1", "first block of each colour, COLORS + 1 a world"),
    ("color_fill", "world color", "int32", "1", "rows of each colour"),
    ("rows", "row column", "real", "1", "columns of the rows, see rows.py"),
    ("row_body", "row pair", "int32", "1", "bodies of the rows"),
    ("row_impulse", "row pair", "real", "N s", "normal and tangential impulses"),
    ("row_change", "row pair", "real", "N s", "what the last sweep, or its acceleration, changed the impulses by"),
    ("row_before", "row pair", "real", "N s", "step of the sweep before the last, where a solve pauses"),
    ("row_direction", "row direction", "real", "N s", "search direction of nonlinear CG"),
    ("row_history", "row history", "real", "N s, m/s", "of an accelerated solve: iterates and steps, velocities"),
    ("row_scale", "world", "real", "N s", "norm that the residual is relative to"),
    ("deepest", "world", "real", "m", "least gap, 0 where nothing overlaps"),
)

MOTION = _table(
    ("step_dt", "world", "real", "s", "time step"),
    ("weight", "world", "real", "N", "gravity times the geometric mean of the dynamic bodies' masses"),
    ("reach", "world", "real", "m", "speculative distance of the step"),
    ("predicted", "body+1", "vec4", "m/s", "velocity with forces applied, spin [rad/s], inverse mass [1/kg]"),
    ("solved", "body+1", "vec4", "m/s", "velocity with impulses applied"),
    ("summed", "body sum", "vec4", "m/s", "velocity that Jacobi adds up"),
    ("displacement", "body+1", "vec4", "m", "of the step: by velocity and position correction, turn [rad]"),
)

STATS = _table(
    ("sweeps", "world", "int32", "1", "sweeps of the last solve"),
    ("change", "world", "real", "N s", "largest impulse change of its last sweep"),
    ("residual", "world", "real", "1", "relative natural map at its end"),
    ("colors", "world", "int32", "1", "highest colour of the step's constraints, plus one"),
    ("counters", "world counter", "int32", "1", "iteration in flight: sweeps, sweeps into the period, period, done"),
    ("norms", "world norm", "real", "N s", "iteration in flight: change, squared steps"),
    ("replaced", "world", "int32", "1", "1: a resumed solve takes contacts.impulse anew"),
)


@dataclass(frozen=True, kw_only=True)
class SolverConfig:
    """Settings of the contact solver and of the stages around it.

    Lengths are multiples of each world's ``length_scale``, so that a scene of millimetres behaves like
    one of kilometres.
    """

    method: Literal["pgs", "jacobi"] = "pgs"
    """Projected Gauss-Seidel in colour order, or Jacobi with mass splitting (Tonge et al. 2012)."""
    acceleration: Literal["none", "sor", "aitken", "nncg", "adaptive"] = "adaptive"
    """Over-relaxation, Aitken extrapolation with back-off, nonsmooth nonlinear CG (Silcowitz et al. 2010), or Aitken,
    momentum and Anderson's update in turns, chosen by what they gained."""
    max_sweeps: int = 1000
    """Sweeps after which a solve ends unconverged [1]."""
    min_sweeps: int = 10
    """Sweeps of a solve at least, if max_sweeps allows: what a step at rest leaves is met by the next, so that piles
    lie still (up to 1e3 times less creep than at 1) and need fewer long solves [1]."""
    tolerance: float = 1e-4
    """Largest impulse change of a sweep [N s], or residual [1], at which a solve ends."""
    relative_tolerance: float = 1.3e-3
    """The same relative to the impulse that a typical body's weight gives in a step: the smaller bound on the impulse
    change counts, so that light bodies and short steps are solved too; inf: none. The default leaves the theses' discs
    at 1e-4 N s [1]."""
    stop: Literal["change", "residual"] = "change"
    """What the tolerance is compared with: the largest impulse change, or the relative natural map."""
    residual_every: int = 5
    """Sweeps between two evaluations of the residual when it decides the stop [1]."""
    start: Literal["cache", "zero"] = "cache"
    """Start impulses of a step: those of the step before, or zero."""
    omega: float = 1.4
    """Relaxation factor of acceleration "sor" [1]."""
    aitken_period: int = 3
    """Shortest period of the Aitken extrapolation, in sweeps: 3 needs a tenth fewer sweeps than 5 at 100 discs [1]."""
    aitken_period_max: int = 40
    """Longest period after back-off, in sweeps [1]."""
    aitken_cap: float = 200.0
    """Largest multiple of the last step to move on by [1]."""
    aitken_threshold: float = 0.95
    """Back off when the step shrank by less than this factor over a period [1]."""
    aitken_patience: int = 20
    """Periods without a smaller step after which plain sweeps follow, 2 aitken_period_max and twice as many each
    time: extrapolation alone can cycle for good where plain Gauss-Seidel converges [1]."""
    stretch: int = 120
    """Sweeps after which "adaptive" compares its methods: 80 to 240 are within 5 % of each other [1]."""
    position_correction: Literal["ngs", "baumgarte", "none"] = "ngs"
    """A phase of its own after the velocities (Box2D 2.3), a velocity bias, or nothing."""
    position_iterations: int = 3
    """Sweeps of the "ngs" phase; it is skipped where nothing overlaps by more than the slop [1]."""
    position_factor: float = 0.2
    """Share of an overlap that one "ngs" sweep, or one "baumgarte" step, removes [1]."""
    slop: float = 5e-4
    """Overlap that is left alone, and gap that counts as closed [length_scale]."""
    max_correction: float = 0.2
    """Largest overlap corrected at once [length_scale]."""
    speculative: float = 0.02
    """A gap below this is a contact, as is one that closes within the step [length_scale]."""
    speculative_max: float = 0.1
    """The same where bodies are fast: what the fastest moves in a step, up to this [length_scale]."""
    margin: float = 0.1
    """Broadphase boxes are this much larger on each side, so that pairs last several steps [length_scale]."""
    restitution_threshold: float = 1.0
    """Approach speed below which a contact does not bounce [m/s]."""
    history: bool = False
    """Keep the largest impulse change of every sweep (``SolveStats.history``)."""

    def __post_init__(self) -> None:
        choices = {
            "method": tuple(METHODS),
            "acceleration": tuple(ACCELERATIONS),
            "stop": tuple(STOPS),
            "start": ("cache", "zero"),
            "position_correction": ("ngs", "baumgarte", "none"),
        }
        for name, allowed in choices.items():
            if getattr(self, name) not in allowed:
                raise ValueError(f"SolverConfig.{name} is {getattr(self, name)!r}; it must be one of {allowed}")
        # name: (low, high, low itself allowed)
        ranges = {
            "max_sweeps": (0, 2**31 - 1, True),
            "min_sweeps": (0, 2**31 - 1, True),
            "tolerance": (0.0, float("inf"), True),
            "relative_tolerance": (0.0, float("inf"), True),
            "residual_every": (1, 2**31 - 1, True),
            "omega": (0.0, 2.0, False),
            "aitken_period": (3, 2**29, True),
            "aitken_period_max": (3, 2**29, True),
            "aitken_patience": (1, 2**31 - 1, True),
            "stretch": (10, 2**30, True),
            "aitken_cap": (0.0, float("inf"), True),
            "aitken_threshold": (0.0, 1.0, False),
            "position_iterations": (0, 2**31 - 1, True),
            "position_factor": (0.0, 1.0, False),
            "slop": (0.0, float("inf"), True),
            "max_correction": (0.0, float("inf"), False),
            "speculative": (0.0, float("inf"), True),
            "speculative_max": (0.0, float("inf"), True),
            "margin": (0.0, float("inf"), True),
            "restitution_threshold": (0.0, float("inf"), True),
        }
        for name, (low, high, closed) in ranges.items():
            value = getattr(self, name)
            if not (low <= value <= high) or (value == low and not closed):
                bracket = "[" if closed else "("
                raise ValueError(f"SolverConfig.{name} is {value!r}; it must lie in {bracket}{low}, {high}]")
        if self.aitken_period_max < self.aitken_period:
            raise ValueError(
                f"SolverConfig.aitken_period_max is {self.aitken_period_max}; "
                f"it must not be below aitken_period = {self.aitken_period}"
            )
        if self.method == "jacobi" and self.acceleration == "sor" and self.omega > 1.0:
            raise ValueError(f"SolverConfig.omega is {self.omega}; Jacobi with mass splitting is proven only up to 1")

    def to_dict(self) -> dict[str, object]:
        """The settings by name, as stored in snapshots and summaries."""
        return {f.name: getattr(self, f.name) for f in fields(self)}
