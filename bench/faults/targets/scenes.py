"""Joints of all kinds, what comes and goes, events, sleep and queries, and what each argument may be: for ``calls``."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator
from typing import Any, Literal

import numpy as np

from bench.faults.targets.simulations import Backend, Target, always, builder, simulation
from bench.faults.targets.stages import SCALE, WORLDS
from bench.faults.values import HUGE, Array, Given, Numbers, Vector
from dc_kernels.model.checks import FIELDS, Finite, NotNegative, Positive
from dc_kernels.model.config import PRESETS
from dc_kernels.model.settings import Count, Whole

INT = np.int32
NO_DIRECTION: tuple[Any, ...] = ((0.0, 0.0), (1.0,), (math.nan, 1.0), (0.0, math.inf), np.zeros((2, 2)), "12", 1.0)
DIRECTION = Given(*NO_DIRECTION, None)
"""Two numbers that are not both 0."""
THREE = Given((0.0, 1.0), (0.0, 0.0, math.nan), np.zeros((2, 3)), "123", 1.0, None, True)
"""Three numbers."""
FLAGS = Given("2", 2.5, None, [True], [0, 1], np.zeros((1, 1), bool))
"""A truth value, or as many as there are discs."""
IDS = Given("0", 0.5, None, True, [0.0], [-1], [2**40], [True, False], np.zeros((1, 1), INT), lambda: 1, *HUGE)
"""Ids of what is there, or one."""
MASK = Given("1", 2.5, math.nan, -1, 2**32, [1, 1, 1], lambda: 1, *HUGE)
"""32 bits, or as many for each of two queries."""
SKIP = Given("0", 0.5, math.nan, -2, 9, [0, 0, 0], lambda: 1, *HUGE)
"""The index of one of two bodies, or -1, or as many for each of two queries."""
SWITCH = Given("1", 2, -1, math.nan, [True, False], np.zeros((1, 1)), lambda: 1)
"""A truth value, or one for each of the contacts, of which there is one."""


def joint_targets() -> Iterator[Target]:
    """Joints of all kinds, and what few bodies and shapes have."""
    options: dict[str, Any] = {"collide_connected": bool, "break_force": FIELDS["break_force"] | None}
    ends: dict[str, Any] = {"body_a": Whole, "body_b": Whole, **options}
    anchors: dict[str, Any] = {"anchor_a": Vector, "anchor_b": Vector}
    anchored = {**ends, "anchor_a": Vector, "anchor_b": Array(2, strict=False, optional=True)}
    limits: dict[str, Any] = {"lower": FIELDS["lower"] | None, "upper": FIELDS["upper"] | None}
    spring: dict[str, Any] = {"frequency": NotNegative, "damping_ratio": NotNegative}
    motor: dict[str, Any] = {**limits, "motor_speed": Finite}
    turned: dict[str, Any] = {"reference_angle": FIELDS["reference_angle"] | None}
    strong: dict[str, Any] = {"max_motor_torque": FIELDS["max_motor_torque"] | None}
    pushed: dict[str, Any] = {"max_motor_force": FIELDS["max_motor_force"] | None}
    dragged: dict[str, Any] = {"max_force": NotNegative, "frequency": Positive, "damping_ratio": NotNegative}
    lengths: dict[str, Any] = {"max_length": FIELDS["max_length"] | None, "min_length": NotNegative}
    jacobians: dict[str, Any] = {"jacobian_a": THREE, "jacobian_b": THREE, "speed": Finite}
    along: dict[str, Any] = {"axis": DIRECTION}
    kinds: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
        "distance": ({"frequency": 2.0}, {**ends, **anchors, **spring, **limits}),
        "rope": ({}, {**ends, **anchors, **lengths}),
        "revolute": ({"max_motor_torque": 1.0}, {**anchored, **motor, **strong, **turned}),
        "prismatic": (
            {"axis": (1.0, 0.0), "max_motor_force": 1.0},
            {**anchored, **motor, **pushed, **turned, **along},
        ),
        "weld": ({}, {**anchored, **spring, **turned}),
        "wheel": ({"max_motor_torque": 1.0}, {**anchored, **motor, **strong, **spring, **along}),
        "target": ({"body_a": 1, "body_b": 0, "max_force": 1.0}, {**ends, **anchors, **dragged}),
        "gear": ({"ratio": 2.0}, {**ends, "ratio": Finite, "phase": FIELDS["phase"] | None}),
        "general": ({"jacobian_a": (0, 1, 0), "jacobian_b": (0, 0, 1)}, {**ends, **jacobians, **limits}),
    }
    for kind, (more, hints) in kinds.items():
        good = {"body_a": 0, "body_b": 1, **more}
        yield Target(f"add_{kind}_joint", method(f"add_{kind}_joint"), functools.partial(dict, **good), hints)
    traits: dict[str, Any] = dict.fromkeys(("linear_damping", "angular_damping"), NotNegative)
    traits["gravity_scale"] = Finite
    yield Target("add_body", method("add_body"), dict, {**traits, "fixed_rotation": bool})
    roles: dict[str, Any] = {"sensor": bool, "one_way": Given(*NO_DIRECTION)}
    yield Target("add_disc", method("add_disc"), functools.partial(dict, body=0, radius=0.5), roles)
    chain = {"body": 1, "vertices": [(0.0, 0.0), (1.0, 0.0), (2.0, 0.0)]}
    yield Target("add_chain", method("add_chain"), functools.partial(dict, **chain), {"one_sided": bool})
    discs = {"positions": [(5.0, 5.0), (7.0, 5.0)], "radius": 0.5}
    many: dict[str, Any] = {name: Numbers() for name in (*traits, "surface_speed", "rolling_resistance")}
    many |= {"fixed_rotation": FLAGS, "sensor": FLAGS}
    yield Target("add_discs", method("add_discs"), functools.partial(dict, **discs), many)


def method(name: str) -> Callable[[], Callable[..., Any]]:
    """What gives a method of a new builder."""
    return lambda: getattr(builder(), name)


def populated(**settings: Any) -> Any:
    """A simulation of two bodies, two shapes and a joint, after a step, with settings of its solver."""
    import dc_kernels as dc

    made = builder()
    made.add_distance_joint(0, 1)
    sim = dc.Simulation(*made.finalize(backend="numpy"), config=dc.SolverConfig(**settings))
    sim.step(0.01)
    return sim


def population_targets() -> Iterator[Target]:
    """What comes and goes between steps, what sleeps, and changes of a model with all that one may have."""
    import dc_kernels as dc

    sim = populated
    yield Target(
        "additions", lambda: sim().additions, dict, {"world": Given(*(v for v in IDS.values if v is not None))}
    )
    yield Target("to_world", lambda: sim().additions().to_world, lambda: {"world": 0}, {"world": Whole})
    yield Target("existing", lambda: sim().additions().existing, lambda: {"body": 0}, {"body": Whole})

    def adding() -> Callable[..., Any]:
        made, other = sim(), sim()

        def add(additions: Any) -> Any:
            given = {"mine": made, "another's": other}.get(additions) if isinstance(additions, str) else None
            return made.add(additions if given is None else given.additions())

        return add

    wrong = Given("another's", "12", None, 2.5, True, [], dc.ModelBuilder())
    yield Target("add", adding, lambda: {"additions": "mine"}, {"additions": wrong})
    for kind in ("bodies", "shapes", "joints"):
        good: Callable[[], dict[str, Any]] = functools.partial(dict, **{kind: 0})
        yield Target("remove", lambda: sim().remove, good, {kind: Given([0, 0], *IDS.values)})
        hint = Given(*(value for value in IDS.values if value is not None))
        yield Target("index", lambda: sim().index, good, {kind: hint})
    yield Target("reserve", lambda: sim().reserve, dict, dict.fromkeys(("bodies", "shapes", "vertices"), Whole))
    chosen = Given("0", 0.5, math.nan, [0.0], [2], [-3], [True], np.zeros((1, 1), INT), lambda: 1, *HUGE)
    for name in ("sleep", "wake"):

        def let(name: str = name) -> Callable[..., Any]:
            return getattr(sim(sleep=True), name)  # type: ignore[no-any-return]

        yield Target(name, let, dict, {"bodies": chosen})
    yield from changed_targets()


def changed_targets() -> Iterator[Target]:
    """``change_model`` of every field that may be changed, ``assign`` of those, and of the state."""
    full = whole_scene()
    groups = {"model": full.model, "joints": full.joints, "state": full.state}
    for part, group in groups.items():
        for name in ("flags", *group.changeable) if part != "state" else group.table:
            if name == "flags":
                continue
            values = group.numpy(name).copy()
            if not values.size:
                raise RuntimeError(f"{part}.{name} has no elements in the bench's scene")
            good: Callable[[], dict[str, Any]] = functools.partial(dict, **{name: values})
            hints = {name: Given(*bad_arrays(group, name, values))}
            if part != "state":
                yield Target("change_model", lambda: whole_scene().change_model, good, hints, related(name))
            if part == "state" or (group.live and name in group.live):

                def writer(part: str = part, name: str = name) -> Callable[..., Any]:
                    made = getattr(whole_scene(), part)
                    return lambda **given: made.assign(name, given[name])

                yield Target(f"{part}.assign", writer, good, hints, related(name))


def bad_arrays(group: Any, name: str, values: np.ndarray) -> list[Any]:
    """What may not be written to a field of a group that holds some values."""
    from dc_kernels.model.rules import Number, Unit

    whole, rule = values.dtype.kind in "iu", group.table[name].rule
    found = Array(*values.shape, whole=whole, strict=False, ranged=False).bad()
    found = [one for one in found if isinstance(one, str | np.ndarray | type(None)) and not same(one, values)]
    found += [numbers_of(values, number) for number in beyond(rule)] if isinstance(rule, Number) else []
    found += [2.0 * values] if isinstance(rule, Unit) else []
    return [*found, lambda: 1]


def same(one: Any, values: np.ndarray) -> bool:
    """Whether an array could stand for others of its shape: whole numbers of a floating type are taken as such."""
    alike = isinstance(one, np.ndarray) and one.shape == values.shape and one.dtype.kind == "f"
    return alike and values.dtype.kind in "iu" and bool((one == np.round(one)).all())


def related(name: str) -> dict[str, tuple[str, ...]]:
    """What an error may name instead of a field: what belongs together with it."""
    together = {
        "mass": ("inv_mass",),
        "inertia": ("inv_inertia",),
        "inv_mass": ("mass",),
        "inv_inertia": ("inertia",),
        "body_type": ("mass", "inv_mass", "inertia", "joint_body_b"),
        "joint_body_a": ("joint_body_b",),
        "joint_lower": ("joint_upper",),
        "joint_upper": ("joint_lower",),
    }
    return {name: together.get(name, ())}


def beyond(rule: Any) -> list[float]:
    """Numbers outside the range of a rule."""
    found = [math.nan, math.inf]
    found += [rule.low - abs(rule.low) - 1.0] if rule.low > -math.inf else []
    return found


def numbers_of(values: np.ndarray, number: float) -> np.ndarray:
    """An array whose first element is a number."""
    made = values.astype(np.float64)
    made.flat[0] = number
    return made


def whole_scene() -> Any:
    """A simulation with joints of several kinds, traits of bodies, surfaces, roles of shapes, and a body at rest."""
    import dc_kernels as dc

    made = builder()
    body = made.add_body((3.0, 1.0), linear_damping=0.1, angular_damping=0.1, gravity_scale=0.5)
    made.add_box(body, 0.4, 0.4, surface_speed=1.0, rolling_resistance=0.1)
    made.add_polygon(body, [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)], one_way=(0.0, 1.0))
    made.add_disc(1, 0.1, center=(3.0, 3.0), sensor=True)
    made.add_distance_joint(0, 2, frequency=2.0, lower=0.1, upper=9.0)
    made.add_revolute_joint(1, 2, (2.0, 1.0), lower=-1.0, upper=1.0, max_motor_torque=1.0)
    made.add_wheel_joint(0, 1, max_motor_torque=1.0)
    made.add_gear_joint(0, 2, 2.0)
    made.add_general_joint(0, 2, (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    return dc.Simulation(*made.finalize(backend="numpy"))


def event_targets() -> Iterator[Target]:
    """What begins, ends and hits, forces of joints, contacts switched within a step, and presets."""
    import dc_kernels as dc

    def listing() -> Any:
        return populated(contact_events=True)

    whole: dict[str, Any] = {"sim": dc.Simulation}
    which = Literal["all", "begun", "ended", "hit"]
    for function, lists in ((dc.contact_events, which), (dc.sensor_events, Literal["all", "begun", "ended"])):
        good = {"contact_events": listing, "sensor_events": populated}[function.__name__]
        yield Target(
            function.__name__,
            always(function),
            lambda good=good: {"sim": good()},  # type: ignore[misc]
            {**whole, "which": lists},
        )
    yield Target("joint_reactions", lambda: dc.joint_reactions, lambda: {"sim": populated()}, whole)
    contacts = lambda: {"contacts": simulation().contacts}  # noqa: E731
    yield Target("contact_slots", lambda: dc.contact_slots, contacts, {"contacts": dc.Contacts})

    def switched() -> Callable[..., Any]:
        sim = populated(contact_switches=True)
        sim.collide(0.01)
        return sim.change_contacts  # type: ignore[no-any-return]

    several = Given(*(value for value in SCALE.values if not callable(value)), True, [0.5, 0.5], lambda: 1)
    values = {"enabled": SWITCH, "friction": several, "restitution": Given(1.5, *several.values)}
    yield Target("change_contacts", switched, dict, values)
    names = Literal[tuple(PRESETS)]  # type: ignore[valid-type]
    yield Target(
        "preset", lambda: dc.SolverConfig.preset, lambda: {"name": "strict"}, {"name": names}, {"name": ("preset",)}
    )
    between: dict[str, Any] = {"stepper": Given("12", 2.5, True, [], len, lambda: 1)}
    yield Target("step", lambda: populated().step, lambda: {"dt": 0.01}, between)
    yield Target("run", lambda: populated().run, lambda: {"steps": 0, "dt": 0.01}, between)
    for part in ("model", "state", "joints"):
        named = {"name": Given("speed", "", 3, None, (1, 2))}
        for call in ("worlds", "numpy", "assign"):
            right: dict[str, Any] = {"name": {"model": "origin", "joints": "joint_ratio"}.get(part, "time")}
            if call == "assign":
                right["values"] = getattr(populated(), part).numpy(right["name"]).copy()

            def group(part: str = part, call: str = call) -> Callable[..., Any]:
                return getattr(getattr(populated(), part), call)  # type: ignore[no-any-return]

            yield Target(call, group, functools.partial(dict, **right), named)
    yield Target("func.shapes", lambda: dc.func.shapes, dict, {"dtype": Literal["float32", "float64"]})


def query_targets() -> Iterator[Target]:
    """Rays, shapes, overlaps and closest points."""
    import dc_kernels as dc

    def queries() -> Any:
        return dc.Queries(simulation())

    yield Target(
        "Queries",
        lambda: dc.Queries,
        lambda: {"shapes": simulation()},
        {"shapes": dc.Simulation, "threads": Count, "backend": Backend | None},
    )
    places = {"position": np.zeros((2, 2), np.float32), "angle": np.zeros(2, np.float32)}
    yield Target(
        "Queries",
        lambda: dc.Queries,
        lambda: {"shapes": simulation().model, **places},
        {"position": Array(2, 2), "angle": Array(2)},
    )
    two = np.array([(0.0, 3.0), (1.0, 3.0)])
    way = Given("12", None, 1.0, (math.nan, 0.0), (1e30, 0.0), np.ones(3))
    bad = Array(2, 2, strict=False, fixed=False).bad()
    place = Given(*bad, np.full((2, 2), 1e30), np.zeros((2, 3)), np.zeros(2))
    world = Given(*(value for value in WORLDS.values if value is not None), [0, 0, 0], 1, -1)
    which: dict[str, Any] = {"world": world, "mask": MASK, "skip_body": SKIP}
    corners = Given(
        "12", 1.0, np.zeros((9, 2)), np.zeros((3, 2)), np.zeros((0, 2)), [(math.nan, 0.0)], [(0.0, 0.0, 1.0)]
    )
    shape: dict[str, Any] = {"angle": Given("12", math.nan, [0.0] * 3), "vertices": corners, "radius": NotNegative}
    most = Given("12", -1.0, math.nan, 1e30, [1.0] * 3)
    calls: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
        "cast_rays": ({"origin": two, "translation": (0.0, -9.0)}, {"origin": place, "translation": way}),
        "cast_shape": (
            {"position": two, "translation": (0.0, -9.0)},
            {"position": place, "translation": way, **shape},
        ),
        "overlap_points": ({"points": two}, {"points": place}),
        "overlap_boxes": (
            {"lower": two, "upper": two + 1.0},
            {"lower": place, "upper": Given(two - 1.0, *place.values)},
        ),
        "overlap_shape": ({"position": two}, {"position": place, **shape}),
        "closest_points": ({"points": two}, {"points": place, "max_distance": most}),
    }
    for name, (good, hints) in calls.items():

        def call(name: str = name) -> Callable[..., Any]:
            return getattr(queries(), name)  # type: ignore[no-any-return]

        yield Target(name, call, functools.partial(dict, **good), {**hints, **which})
