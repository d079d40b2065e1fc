"""The arrays of a simulation: name, meaning, unit, shape and dtype of each.

Every array of deep-contact has one name, used for the attribute, the kernel argument and the HDF5
dataset alike. The tables below are the single source for allocation, validation, snapshots and the
memory report. Bodies, shapes and joints of all worlds are stored one world after
the other, and ``*_start`` arrays of length W + 1 hold the first element of each world.

Conventions (tested): SI units; a contact normal points from body A to body B, where A is the static
body or the one with the lower index; the tangent is the normal rotated by -90 degrees,
``t = (n_y, -n_x)``; impulses are in N s and act on B, the opposite ones on A.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from typing import Any

from dc_kernels.model.enums import BodyType, Flag, JointKind, JointPart, Rest, ShapeRole, ShapeType
from dc_kernels.model.rules import (
    COUNT,
    FINITE,
    INVERSE,
    NOT_NEGATIVE,
    POSITIVE,
    SHARE,
    TIME_STEP,
    Ascending,
    Code,
    Index,
    Number,
    Rule,
    Start,
    Unit,
)

KEY_SHAPE_BITS = 23  # contact key = shape A | shape B | feature, 23 + 23 + 16 bits, indices within the world
KEY_FEATURE_BITS = 16
COLORS = 64  # colours of the contact graph: bits of a mask; the last one is the serial overflow colour
COLOR = Number(-1, COLORS - 1)  # -1: none yet
AGE = Number(0, 2**31 - 2)  # a step adds one
LAST_STEP = replace(TIME_STEP, zero=True)  # 0: before the first
ALL_FLAGS = int(~Flag.NONE)
ALL_PARTS = int(~JointPart.NONE)
UNBOUNDED = 1e30
"""A limit, force or torque of a joint that stands for none; float32 holds its square root's products."""
_INTEGERS = ("int32", "int64", "uint32", "uint64", "vec3i", "iteration")


@dataclass(frozen=True)
class Field:
    """One array: ``per`` names its axis; ``dtype`` is "real", "vec2", "vec4" (of the model's scalar) or fixed.

    One number or small vector that a launch is given instead has "launch" there, and no axes. ``rule`` is what values
    from outside must satisfy (``model/validate``); where none is given numbers that are not integers must be finite.
    """

    name: str
    per: str
    dtype: str
    unit: str
    meaning: str
    rule: Rule | None = None

    def __post_init__(self) -> None:
        if self.rule is None and self.dtype not in _INTEGERS:
            object.__setattr__(self, "rule", FINITE)

    @functools.cached_property
    def points(self) -> bool:
        """Whether the values are not to be written to: kernels go by them to places in memory, or record a step."""
        if isinstance(self.rule, Start | Index) or self.rule is COLOR or self.rule == Code(ShapeType):
            return True
        return self.rule is COUNT or self.rule is LAST_STEP

    @functools.cached_property
    def axes(self) -> tuple[str, ...]:
        """The axes, one for each dimension: ``per`` names several of them with commas between."""
        return () if self.per == "launch" else tuple(self.per.split(","))


def field_table(*rows: tuple[Any, ...]) -> dict[str, Field]:
    """Make a table from rows of name, axis, dtype, unit, meaning and, where there is one, rule."""
    return {row[0]: Field(*row) for row in rows}


TRAITS = {"body trait": "body", "shape trait": "shape"}
"""Axes of optional fields, and the axes whose length they have in a scene that uses them; otherwise they are empty."""
ROLLING = "rolling contact"
"""Axis of rolling resistance: as long as that of contacts if a shape has rolling resistance, otherwise empty."""
PER_CONTACT = ("contact", ROLLING)

# axes: world W, world+1, body, body+1 (behind the bodies: padding bodies of empty solver lanes), shape, shape+1,
# vertex, joint, joint row, contact (capacity), pair (capacity), block (capacity, of LANES solver rows), bucket
MODEL = field_table(
    ("body_start", "world+1", "int32", "1", "first body of each world", Start("body")),
    ("shape_start", "world+1", "int32", "1", "first shape of each world", Start("shape")),
    ("joint_start", "world+1", "int32", "1", "first joint of each world", Start("joint")),
    ("gravity", "world", "vec2", "m/s^2", "acceleration of every dynamic body"),
    ("origin", "world", "vec2d", "m", "origin of the world's coordinates, to which positions are relative"),
    ("length_scale", "world", "real", "m", "typical diameter of dynamic shapes; unit of margins", POSITIVE),
    ("cell_size", "world", "real", "m", "finest cell of the broadphase's cell list", POSITIVE),
    ("body_type", "body", "int32", "1", "BodyType", Code(BodyType)),
    ("mass", "body", "real", "kg", "mass; 0 where infinite", NOT_NEGATIVE),
    ("inertia", "body", "real", "kg m^2", "moment of inertia about the centre of mass; 0 where infinite", NOT_NEGATIVE),
    ("inv_mass", "body", "real", "1/kg", "0 for static and kinematic bodies", INVERSE),
    ("inv_inertia", "body", "real", "1/(kg m^2)", "0 for static, kinematic and non-rotating bodies", INVERSE),
    ("center_of_mass", "body", "vec2", "m", "in the builder's frame; vertices and joint anchors are relative to it"),
    ("shape_body", "shape", "int32", "1", "body of the shape; a builder sorts shapes by body", Index("body")),
    ("shape_type", "shape", "int32", "1", "ShapeType", Code(ShapeType)),
    ("shape_radius", "shape", "real", "m", "radius of a disc or capsule, rounding of a polygon", NOT_NEGATIVE),
    ("shape_center", "shape", "vec2", "m", "centroid in the body's frame"),
    ("shape_extent", "shape", "real", "m", "from shape_center to the farthest point, with radius", NOT_NEGATIVE),
    ("shape_friction", "shape", "real", "1", "Coulomb coefficient; a pair has sqrt(f1 f2)", NOT_NEGATIVE),
    ("shape_restitution", "shape", "real", "1", "coefficient in [0, 1]; a pair has the larger", SHARE),
    ("shape_category", "shape", "uint32", "1", "category bits of the shape"),
    ("shape_mask", "shape", "uint32", "1", "categories that it collides with; both shapes must accept each other"),
    ("vertex_start", "shape+1", "int32", "1", "first vertex of each shape", Start("vertex", spare=True)),
    ("vertices", "vertex", "vec2", "m", "in the body's frame, relative to the centre of mass"),
    ("vertex_normals", "vertex", "vec2", "1", "outward normal of the edge from this vertex to the next"),
    (
        "linear_damping",
        "body trait",
        "real",
        "1/s",
        "decay rate of the velocity, as exp(-rate t)",
        NOT_NEGATIVE,
    ),
    ("angular_damping", "body trait", "real", "1/s", "decay rate of the spin", NOT_NEGATIVE),
    ("gravity_scale", "body trait", "real", "1", "factor of the world's gravity for a body"),
    ("shape_surface_speed", "shape trait", "real", "m/s", "of the surface, clockwise: on top of a belt to the right"),
    (
        "shape_rolling_resistance",
        "shape trait",
        "real",
        "1",
        "largest torque over normal force and radius; a pair has the larger",
        NOT_NEGATIVE,
    ),
    ("shape_role", "shape trait", "int32", "1", "ShapeRole", Code(ShapeRole)),
    ("shape_one_way", "shape trait", "real", "rad", "direction of a ONE_WAY shape, in the body's frame"),
)

STATE = field_table(
    ("position", "body", "vec2", "m", "centre of mass, relative to the world's origin"),
    ("angle", "body", "real", "rad", "rotation, counter-clockwise"),
    ("velocity", "body", "vec2", "m/s", "velocity of the centre of mass"),
    ("angular_velocity", "body", "real", "rad/s", "counter-clockwise"),
    ("force", "body", "vec2", "N", "applied at the centre of mass in every step until changed"),
    ("torque", "body", "real", "N m", "applied in every step until changed"),
    ("time", "world", "float64", "s", "simulated time"),
    ("flags", "world", "int32", "1", "Flag bits; a world with any bit set does not advance", Number(0, ALL_FLAGS)),
)

CONTACTS = field_table(
    ("contact_start", "world+1", "int32", "1", "first reserved slot of each world", Start("contact")),
    ("contact_count", "world", "int32", "1", "contacts in slots from contact_start, sorted by key", COUNT),
    ("contact_dt", "world", "real", "s", "time step of the impulses, 0 before the first", LAST_STEP),
    ("key", "contact", "int64", "1", "shape A, shape B, feature: identifies a contact from step to step", Ascending()),
    ("body_a", "contact", "int32", "1", "body A", Index("body")),
    ("body_b", "contact", "int32", "1", "body B", Index("body")),
    ("normal", "contact", "vec2", "1", "unit vector from A to B", Unit()),
    ("arm_a", "contact", "vec2", "m", "from the centre of mass of A to the contact point, world axes"),
    ("arm_b", "contact", "vec2", "m", "from the centre of mass of B to the contact point, world axes"),
    ("gap", "contact", "real", "m", "distance of the surfaces, negative where they overlap"),
    ("friction", "contact", "real", "1", "Coulomb coefficient of the pair", NOT_NEGATIVE),
    ("restitution", "contact", "real", "1", "coefficient of restitution of the pair", SHARE),
    ("impulse", "contact", "vec2", "N s", "normal and tangential impulse: before the solve its start, then its result"),
    ("color", "contact", "int32", "1", "colour in the contact graph, kept while the contact lives", COLOR),
    ("age", "contact", "int32", "1", "steps since the contact began, 0 when new", AGE),
    ("rolling_impulse", ROLLING, "real", "N s", "rolling resistance: start of the solve, then its result"),
)

JOINTS = field_table(
    ("joint_body_a", "joint", "int32", "1", "body A", Index("body")),
    ("joint_body_b", "joint", "int32", "1", "body B", Index("body")),
    ("joint_anchor_a", "joint", "vec2", "m", "in the frame of body A, relative to its centre of mass"),
    ("joint_anchor_b", "joint", "vec2", "m", "in the frame of body B, relative to its centre of mass"),
    ("joint_length", "joint", "real", "m", "distance that a distance joint keeps between its anchors", NOT_NEGATIVE),
    ("joint_kind", "joint", "int32", "1", "JointKind", Code(JointKind)),
    ("joint_parts", "joint", "int32", "1", "JointPart bits: which rows it has", Number(0, ALL_PARTS)),
    ("joint_row_start", "joint+1", "int32", "1", "first row of each joint", Start("joint row")),
    ("joint_axis", "joint", "vec2", "1", "direction of a prismatic or wheel joint, in the frame of body A", Unit()),
    ("joint_reference", "joint", "real", "rad", "angle of B minus that of A (of a gear: times its ratio) at angle 0"),
    ("joint_ratio", "joint", "real", "1", "rotations of B for each rotation of A of a gear"),
    ("joint_lower", "joint", "real", "rad, m, N", "smallest angle, length, displacement, or force of a general joint"),
    ("joint_upper", "joint", "real", "rad, m, N", "largest angle, length, displacement, or force of a general joint"),
    ("joint_speed", "joint", "real", "rad/s, m/s", "target speed of the motor, or of a general joint's row"),
    ("joint_strength", "joint", "real", "N m, N", "largest torque or force of the motor, or of a target", NOT_NEGATIVE),
    ("joint_frequency", "joint", "real", "Hz", "natural frequency of the spring; 0: rigid", NOT_NEGATIVE),
    ("joint_damping_ratio", "joint", "real", "1", "damping ratio of the spring; 1: critical", NOT_NEGATIVE),
    ("joint_jacobian_a", "joint", "vec3", "1, m", "Jacobian of a general joint for body A"),
    ("joint_jacobian_b", "joint", "vec3", "1, m", "Jacobian of a general joint for body B"),
    ("joint_break_force", "joint", "real", "N", "force at which the joint breaks; 1e30: never", NOT_NEGATIVE),
    ("joint_broken", "joint", "int32", "1", "1: it has broken, and has no effect", Number(0, 1)),
    ("joint_collides", "joint", "int32", "1", "1: its bodies collide with each other", Number(0, 1)),
    ("joint_color", "joint row", "int32", "1", "colour in the constraint graph", COLOR),
    ("joint_impulse", "joint row", "real", "N s", "impulse of each row; of a rod positive if it pushes apart"),
)


CACHE = field_table(
    ("count", "world", "int32", "1", "contacts of the last finished step", COUNT),
    ("key", "contact", "int64", "1", "their keys, sorted", Ascending()),
    ("impulse", "contact", "vec2", "N s", "their solved impulses"),
    ("color", "contact", "int32", "1", "their colours", COLOR),
    ("age", "contact", "int32", "1", "their ages", AGE),
    ("rolling_impulse", ROLLING, "real", "N s", "solved impulses of their rolling resistance"),
    ("joint_impulse", "joint row", "real", "N s", "solved impulses of the joints in the last finished step"),
)

PAIRS = field_table(
    ("bucket_start", "world+1", "int32", "1", "first bucket of each world; a power of two of them and one more"),
    ("bucket", "bucket", "int32", "1", "first entry of each bucket in sorted_shape"),
    ("cell", "shape", "vec3i", "1", "cell of the shape's box: column, row, level"),
    ("sorted_shape", "shape", "int32", "1", "shapes sorted by bucket; then the last pair of each with a static hull"),
    ("sorted_box", "shape", "vec4", "m", "low x, low y, minus high x, minus high y of the boxes of sorted_shape"),
    ("box", "shape", "vec4", "m", "low x, low y, high x, high y, with margin"),
    ("swept", "shape", "vec4", "m", "low x, low y, high x, high y of what the shape covers in the step"),
    ("left", "shape", "int32", "1", "shapes of each world that were given a new box last, from its first place on"),
    ("start", "world+1", "int32", "1", "first reserved pair of each world"),
    ("count", "world", "int32", "1", "candidate pairs of each world, sorted by (A, B)"),
    ("empty_shapes", "world", "int32", "1", "slots behind the last shape that there has been, which are passed over"),
    ("attic", "world", "int32", "1", "1 more than the body that the shapes of emptied slots belong to; 0: none"),
    ("near_count", "world", "int32", "1", "pairs of each world whose boxes with margin overlap, sorted by (A, B)"),
    ("needed", "world", "int32", "1", "pairs found at the last rebuild, also those without room"),
    ("valid", "world", "int32", "1", "0: rebuild in the next step"),
    ("rebuilds", "world", "int32", "1", "how often pairs were found anew, of all shapes or of some"),
    ("shape_a", "pair", "int32", "1", "shape A"),
    ("shape_b", "pair", "int32", "1", "shape B"),
    ("near_a", "pair", "int32", "1", "shape A of the pairs whose boxes with margin overlap"),
    ("near_b", "pair", "int32", "1", "shape B of the pairs whose boxes with margin overlap"),
    ("temp_a", "pair", "int32", "1", "shape A, not sorted; then the pair before of its shape B with a static hull"),
    ("temp_b", "pair", "int32", "1", "shape B, not sorted; then which near pair a candidate is"),
    ("turn", "turned body", "vec2", "1", "cosine and sine of the angle of a body with hulls"),
    ("kept_rebuilds", "world", "int32", "1", "rebuilds when the list of what is kept of near pairs was made"),
    ("kept_side", "world", "int32", "1", "which half of a world's part of that list is in use, 0 or 1"),
    ("kept_count", "world", "int32", "1", "near pairs that it is of"),
    ("kept_a", "kept pair", "int32", "1", "shape A"),
    ("kept_b", "kept pair", "int32", "1", "shape B"),
    ("kept_edges", "kept pair", "int32", "1", "corners that a manifold goes by, eight of 3 bits; bit 24: no faces"),
    ("kept_frame", "kept pair", "vec4", "1, m", "cosine, sine, x, y of B in the frame of A when they were found"),
    ("kept_bound", "kept pair", "vec3", "m", "arm of a rotation, how far they may move, what else parts them"),
)

ROWS = field_table(
    ("contact_needed", "world", "int32", "1", "contacts found, also those without room"),
    ("slot", "contact", "int32", "1", "where the contact's normal impulse lies in rows.impulse"),
    ("square", "contact", "real", "(N s)^2", "squared impulse that would stop the contact alone; 0 if it never acts"),
    (
        "surface_speed",
        "switched contact",
        "real",
        "m/s",
        "of both surfaces along the contact's tangent, that of B first",
    ),
    ("joint_slot", "joint", "int32", "1", "where the joint's impulse lies in rows.impulse"),
    ("line_start", "world+1", "int32", "1", "first of each world's distance joints that are packed as such"),
    ("row_start", "world+1", "int32", "1", "first of each world's own rows, of joints or of a contact solver's caller"),
    ("row_body_a", "own row", "int32", "1", "body A", Index("body")),
    ("row_body_b", "own row", "int32", "1", "body B", Index("body")),
    ("row_jacobian_a", "own row", "vec3", "1, m", "Jacobian for the velocity (x, y, spin) of A"),
    ("row_jacobian_b", "own row", "vec3", "1, m", "Jacobian for the velocity (x, y, spin) of B"),
    ("row_bias", "own row", "real", "m/s", "added to the velocity that the impulse makes zero; see solve/soft.py"),
    ("row_lower", "own row", "real", "N s", "smallest impulse; may be minus infinity"),
    ("row_upper", "own row", "real", "N s", "largest impulse; may be infinity"),
    ("row_softness", "own row", "real", "1/kg", "velocity by which the row yields for each impulse", NOT_NEGATIVE),
    ("row_gap", "own row", "real", "m", "what position correction makes zero"),
    ("row_held", "own row", "real", "1", "1: position correction moves it, 0: it does not, -1: of a sleeper", SHARE),
    (
        "stiff_inertia",
        "stiff body",
        "real",
        "kg m^2",
        "added to a body's own where joints pull (solve/joints.py)",
    ),
    ("row_color", "own row", "int32", "1", "colour in the constraint graph", COLOR),
    ("row_slot", "own row", "int32", "1", "where the row's impulse lies in rows.impulse, -1 if it can only be 0"),
    ("row_impulse", "own row", "real", "N s", "along the row's Jacobians"),
    ("tree_start", "world+1", "int32", "1", "first tree of joints of each world, which are solved directly"),
    ("tree_first", "tree+1", "int32", "1", "first joint of each tree"),
    ("tree_used", "tree", "int32", "1", "after how many sweeps of this step it was solved last, 0: not at all"),
    ("tree_row", "tree joint", "int32", "1", "first row of the joint, of those that the trees hold"),
    ("tree_size", "tree joint", "int32", "1", "rows of it that they hold, 3 at most"),
    ("tree_parent", "tree joint", "int32", "1", "its body that is nearer to the root of the tree"),
    ("tree_child", "tree joint", "int32", "1", "its other body, -1 where that is not dynamic"),
    ("tree_factor", "tree factor", "float64", "1/kg, kg", "44 a joint: inverse, gain, Jacobians; see tree.h"),
    ("tree_wanted", "tree wanted", "float64", "N s", "3 a joint: impulses without what follows nearer to the root"),
    ("tree_moves", "tree move", "float64", "1/kg, m/s, N s", "12 a body: mobility, what it moves by, impulse on it"),
    ("apart_start", "apart body+1", "int32", "1", "first of the bodies that joints keep from colliding with each body"),
    ("apart_body", "apart", "int32", "1", "such a body"),
    ("apart_joint", "apart", "int32", "1", "the joint that does so"),
    ("color_mask", "body", "uint64", "1", "colours taken at the body"),
    ("body_rows", "body+1", "int32", "1", "rows that act on the body"),
    ("block_start", "world+1", "int32", "1", "first reserved block of each world"),
    ("block_needed", "world", "int32", "1", "blocks of the present step, also those without room"),
    ("color_block", "world color+1", "int32", "1", "first block of each colour, COLORS + 1 a world"),
    ("color_fill", "world color", "int32", "1", "rows of each colour"),
    ("column", "row column", "real", "1", "columns of the rows, see rows.py"),
    ("body", "row pair", "int32", "1", "bodies of the rows"),
    ("impulse", "row pair", "real", "N s", "normal and tangential impulses"),
    ("limit_slot", "row lane", "int32", "1", "slot of the contact that bounds a row of rolling resistance; -1: none"),
    ("roll_slot", ROLLING, "int32", "1", "where a contact's rolling impulse lies in rows.impulse; -1: it has no row"),
    ("change", "row pair", "real", "N s", "what the last sweep, or its acceleration, changed the impulses by"),
    ("before", "row pair", "real", "N s", "step of the sweep before the last, at a pause; see also solve/soft.py"),
    ("direction", "row direction", "real", "N s", "search direction of nonlinear CG"),
    ("past", "row past", "real", "N s, m/s", "of an accelerated solve: iterates and steps, velocities"),
    ("scale", "world", "real", "N s", "norm that the residual is relative to"),
    ("deepest", "world", "real", "m", "least gap, 0 where nothing overlaps"),
)

MOTION = field_table(
    ("step_dt", "world", "real", "s", "time step"),
    ("weight", "world", "real", "N", "gravity times the geometric mean of the dynamic bodies' masses"),
    ("reach", "world", "real", "m", "speculative distance of the step"),
    ("empty_bodies", "world", "int32", "1", "slots behind the last body that there has been, which are passed over"),
    ("predicted", "body+1", "vec4", "m/s", "velocity with forces applied, spin [rad/s], inverse mass [1/kg]"),
    ("solved", "body+1", "vec4", "m/s", "velocity with impulses applied"),
    ("summed", "body sum", "vec4", "m/s", "velocity that Jacobi adds up"),
    ("displacement", "body+1", "vec4", "m", "of the step: by velocity and position correction, turn [rad]"),
)

STATS = field_table(
    ("sweeps", "world", "int32", "1", "sweeps of the last solve"),
    ("change", "world", "real", "N s", "largest impulse change of its last sweep"),
    ("residual", "world", "real", "1", "relative natural map at its end"),
    ("colors", "world", "int32", "1", "highest colour of the step's constraints, plus one"),
    ("iteration", "world", "iteration", "1", "the iteration in flight: a struct of the fields of ITERATION"),
    ("history", "world,sweep", "real", "N s", "largest impulse change of each sweep, if asked for"),
    ("replaced", "world", "int32", "1", "1: a resumed solve reads contacts.impulse again"),
)

# A world's iteration in flight; "squared step" is the sum of squares of what a sweep changed the impulses by.
ITERATION = field_table(
    ("sweeps", "world", "int32", "1", "sweeps done"),
    ("finished", "world", "int32", "1", "1 where the solve has ended"),
    ("change", "world", "real", "N s", "largest impulse change of the last sweep"),
    ("least_change", "world", "real", "N s", "least change of those whose impulses were kept to go back to"),
    ("change_bound", "world", "real", "N s", "change beyond which the adaptive acceleration was led astray"),
    # Aitken's extrapolation:
    ("period", "world", "int32", "1", "sweeps of the present period"),
    ("inside", "world", "int32", "1", "sweeps done in it; negative: plain sweeps before the next"),
    ("stalled", "world", "int32", "1", "periods since the squared step was least"),
    ("plain_sweeps", "world", "int32", "1", "plain sweeps that follow when extrapolation cycles"),
    ("before_end", "world", "real", "(N s)^2", "squared step of the sweep before the period's last"),
    ("at_end", "world", "real", "(N s)^2", "squared step at the end of the period, or of the sweep, before"),
    ("least_step", "world", "real", "(N s)^2", "least squared step at the end of a period"),
    # a pause:
    ("postponed", "world", "int32", "1", "1 where a period's end waits for the solve to go on"),
    ("measured", "world", "int32", "1", "sweep whose squared step was taken last"),
    ("step_before", "world", "real", "(N s)^2", "squared step of the last sweep but one before a pause"),
    ("step_last", "world", "real", "(N s)^2", "squared step of the last sweep before a pause"),
    # the adaptive acceleration:
    ("stretch_sweeps", "world", "int32", "1", "sweeps of the present stretch"),
    ("stretch_method", "world", "int32", "1", "its method, a Stretch"),
    ("stretch_length", "world", "int32", "1", "sweeps of the stretch before"),
    ("rate", "world", "vec3", "1", "rate of each method: half the logarithm of the squared step, a sweep"),
    ("stretch_step", "world", "real", "(N s)^2", "squared step of the first sweep of the stretch"),
    ("momentum", "world", "real", "1", "Nesterov's t"),
    # Anderson's update:
    ("rest", "world", "int32", "1", "periods without an update to come"),
    ("next_rest", "world", "int32", "1", "periods to rest when an update next does harm"),
    ("remembered", "world", "int32", "1", "iterates remembered"),
    ("updated", "world", "int32", "1", "1 where the period began with an update"),
    ("before_update", "world", "real", "(N s)^2", "squared step before the last update"),
    ("products", "world", "vec8", "(N s)^2", "scalar products of the least squares of an update"),
)

# Bodies that sleep, and the contacts between them; all axes are empty where nothing may sleep (collide/sleep.py).
SLEEPERS = field_table(
    ("asleep", "body", "int32", "1", "Rest", Code(Rest)),
    ("rest_time", "body", "real", "s", "for how long it has been slow enough to sleep", NOT_NEGATIVE),
    ("position", "body", "vec2", "m", "of a body that sleeps or is not dynamic, as last seen"),
    ("angle", "body", "real", "rad", "of a body that sleeps or is not dynamic, as last seen"),
    ("force", "body", "vec2", "N", "of a body that sleeps, as last seen"),
    ("torque", "body", "real", "N m", "of a body that sleeps, as last seen"),
    ("parent", "body", "int32", "1", "a body of its island; itself at the root"),
    ("island_time", "body", "real", "s", "at the root: least of the island's rest times, negative if it may not sleep"),
    ("anchor_a", "joint", "vec2", "m", "anchor at A, as last seen where a body sleeps"),
    ("anchor_b", "joint", "vec2", "m", "anchor at B, as last seen where a body sleeps"),
    ("length", "joint", "real", "m", "length, as last seen where a body sleeps", NOT_NEGATIVE),
    ("gravity", "world", "vec2", "m/s^2", "as last seen where a body sleeps"),
    ("sleeping", "world", "int32", "1", "bodies that sleep", COUNT),
    ("dormant", "world", "int32", "1", "1: nothing in the world moves, and its stages are passed over", Number(0, 1)),
    ("waited", "world", "int32", "1", "steps since islands were last looked for", COUNT),
    ("count", "world", "int32", "1", "contacts of bodies that sleep, from contact_start of the contacts on", COUNT),
) | {field.name: field for field in CONTACTS.values() if field.per in PER_CONTACT}

# What one launch over worlds is given beside the groups.
LAUNCH = field_table(
    ("world_offset", "launch", "int32", "1", "first world of the launch"),
    ("padding_body", "launch", "int32", "1", "body behind the others that empty solver lanes point at"),
    ("past_offset", "launch", "int32", "1", "where the first world's part of rows.past begins"),
    ("past_step", "launch", "int32", "1", "from a world's part to the next; 0: worlds take turns"),
    ("resume", "launch", "int32", "1", "1: go on with a solve that paused; of one by substeps: parts done"),
    ("pause", "launch", "int32", "1", "sweeps until a pause; parts of a solve by substeps"),
    ("cut", "launch", "uint64", "1", "address of an int32: not 0 ends all sweeping; 0 for none"),
    ("team", "launch", "uint64", "1", "address of the threads that share a world's loops; 0 for none"),
    ("scratch", "launch", "uint64", "1", "address of SCRATCH bytes of its shard, for manifolds; 0: none are recycled"),
)
SCRATCH = 8448  # bytes: manifolds of 72 pairs in float64, and where each pair has its own

# Where a world's part of the rows lies, and when its solve stops; made once in a solve.
SPAN = field_table(
    ("world", "span", "int32", "1", "index of the world"),
    ("first", "span", "int32", "1", "first block of its rows"),
    ("serial", "span", "int32", "1", "first block of the serial colour"),
    ("last", "span", "int32", "1", "behind its last block"),
    ("low", "span", "int32", "1", "first of its impulses in rows.impulse"),
    ("high", "span", "int32", "1", "behind its last"),
    ("first_body", "span", "int32", "1", "first of its bodies"),
    ("last_body", "span", "int32", "1", "behind its last body"),
    ("past_at", "span", "int32", "1", "where its part of rows.past begins"),
    ("pause_at", "span", "int32", "1", "sweeps from which a pause is due"),
    ("bound", "span", "real", "N s", "what the stop is compared with"),
    ("still", "span", "real", "m/s", "change of a contact's speed in a sweep that counts as none"),
    ("fall", "span", "real", "m/s", "change of a velocity in the step that counts as none"),
    ("team", "span", "uint64", "1", "address of the threads that share its loops; 0 for none"),
)

# One row of the solver before it is packed: a contact with its friction, or a joint (solve/rows.py).
ROW = field_table(
    ("body_a", "row", "int32", "1", "body A"),
    ("body_b", "row", "int32", "1", "body B"),
    ("normal", "row", "vec2", "1", "unit vector from A to B"),
    ("normal_arm_a", "row", "real", "m", "arm at A crossed with the normal"),
    ("normal_arm_b", "row", "real", "m", "arm at B crossed with the normal"),
    ("tangent_arm_a", "row", "real", "m", "arm at A crossed with the tangent"),
    ("tangent_arm_b", "row", "real", "m", "arm at B crossed with the tangent"),
    ("inv_inertia_a", "row", "real", "1/(kg m^2)", "inverse inertia of A"),
    ("inv_inertia_b", "row", "real", "1/(kg m^2)", "inverse inertia of B"),
    ("normal_mass", "row", "real", "kg", "effective mass along the normal"),
    ("tangent_mass", "row", "real", "kg", "effective mass along the tangent"),
    ("bias", "row", "real", "m/s", "added to the normal speed that the row makes zero"),
    ("friction", "row", "real", "1", "Coulomb coefficient"),
    ("gap", "row", "real", "m", "what position correction makes zero: gap plus slop, or error in length"),
    ("least", "row", "real", "N s", "least normal impulse: 0 of a contact, minus infinity of a joint"),
    ("most", "row", "real", "N s", "largest normal impulse, of the variant rows"),
    ("direction_a", "row", "vec2", "1", "what the normal is at body A, of the variant rows"),
    ("softness", "row", "real", "1/kg", "velocity for each normal impulse, of the variant rows"),
    ("held", "row", "real", "1", "1: position correction moves the row, 0: it does not, of the variant rows"),
    ("square", "row", "real", "(N s)^2", "squared impulse that would stop the row alone; 0 where it never acts"),
    ("roll", "row", "real", "1", "share of a contact's normal impulse that bounds it, of the variant surfaces"),
)
