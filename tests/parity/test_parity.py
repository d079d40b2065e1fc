"""The two backends agree: the same tables, kernel by kernel on the same arrays, and over whole runs.

The NumPy kernels are written from the formulas and without culling, lanes or cells, so agreement says that the fast
kernels compute what they should.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels.model.arrays import to_numpy
from dc_kernels.model.config import CONFIG
from dc_kernels.model.enums import CAPACITY_FLAGS, Flag
from dc_kernels.model.fields import GROUPS, LAUNCH, MOTION, STATE
from dc_kernels.runtime.backends import argument_names, bind
from dc_kernels.solve.rows import COLORS, COLUMNS, LANES, SERIAL_COLOR
from dc_kernels.stages import STEP, kernel_table

DT = 0.01
# Allowed difference, relative to the largest value of the array (1 if all are smaller): of one kernel, where a whole
# solve counts as one, and of a run.
KERNEL_BOUND = {"float64": 1e-10, "float32": 1e-4}
RUN_BOUND = 1e-9
# what a kernel leaves there is its own business
SCRATCH = {"bucket", "cell", "sorted_shape", "temp_a", "temp_b", "color_mask"}


# ---------------------------------------------------------------------- scenes


def add_ground(builder: dc.ModelBuilder, width: float = 6.0, wall: bool = True) -> None:
    """A floor at y = 0, with walls."""
    ground = builder.add_body(type=dc.BodyType.STATIC)
    builder.add_box(ground, width, 0.5, center=(0.0, -0.5), friction=0.6)
    if wall:
        builder.add_box(ground, 0.5, 3.0, center=(-width / 2 - 0.5, 3.0))
        builder.add_box(ground, 0.5, 3.0, center=(width / 2 + 0.5, 3.0))


def discs(builder: dc.ModelBuilder, columns: int = 4, rows: int = 5, friction: float = 0.4) -> None:
    """Discs of two sizes that fall into a box and pile up."""
    builder.add_world()
    add_ground(builder, width=columns * 1.02)
    draw = np.random.default_rng(7)
    for i in range(rows):
        for j in range(columns):
            at = (j - 0.5 * (columns - 1) + draw.uniform(-0.02, 0.02), 0.52 + 1.01 * i)
            body = builder.add_body(position=at, velocity=(draw.uniform(-1, 1), -1.0), angular_velocity=draw.normal())
            builder.add_disc(body, draw.choice([0.4, 0.5]), friction=friction)


def mixed(builder: dc.ModelBuilder) -> None:
    """Polygons, capsules, discs off their centre and a chain as the ground; all of them turn."""
    builder.add_world(origin=(3.0, -2.0))
    ground = builder.add_body(type=dc.BodyType.STATIC)
    builder.add_chain(ground, [(-3.1, 3.0), (-2.9, 0.1), (-1.0, 0.0), (0.3, -0.2), (1.5, 0.1), (3.2, 0.0), (3.3, 3.0)])
    draw = np.random.default_rng(3)
    for i in range(12):
        body = builder.add_body(
            position=(-2.1 + 1.4 * (i % 4), 0.75 + 1.0 * (i // 4)),
            angle=draw.uniform(-3, 3),
            velocity=(draw.uniform(-1, 1), -2.0),
            angular_velocity=draw.uniform(-2, 2),
        )
        if i % 4 == 0:
            builder.add_box(body, 0.4, 0.3, friction=0.7)
        elif i % 4 == 1:
            builder.add_capsule(body, (-0.3, 0.0), (0.3, 0.1), 0.2)
        elif i % 4 == 2:
            builder.add_polygon(body, [(-0.4, -0.3), (0.4, -0.3), (0.5, 0.1), (0.0, 0.5)], radius=0.05)
        else:
            builder.add_disc(body, 0.25, center=(-0.2, 0.0))
            builder.add_disc(body, 0.2, center=(0.25, 0.1), density=2.0)


def boxes(builder: dc.ModelBuilder) -> None:
    """A stack of boxes."""
    builder.add_world()
    add_ground(builder, wall=False)
    for i in range(5):
        body = builder.add_body(position=(0.04 * i, 0.5 + 1.001 * i), angle=0.001 * i)
        builder.add_box(body, 0.6 - 0.03 * i, 0.5)


def pendulum(builder: dc.ModelBuilder) -> None:
    """A chain of joints with a heavy end that swings against blocks."""
    builder.add_world()
    add_ground(builder)
    hook = builder.add_body(position=(0.0, 4.0), type=dc.BodyType.STATIC)
    before = hook
    for i in range(5):
        link = builder.add_body(position=(0.5 + 0.5 * i, 4.0 - 0.05 * i), angle=0.1 * i)
        builder.add_capsule(link, (-0.15, 0.0), (0.15, 0.0), 0.05)
        builder.add_distance_joint(
            before, link, (0.0, 0.0) if before == hook else (0.2, 0.0), (-0.2, 0.0), 0.3 if i % 2 else None
        )
        before = link
    weight = builder.add_body(position=(3.1, 3.4))
    builder.add_disc(weight, 0.3, density=5.0)
    builder.add_distance_joint(before, weight, (0.2, 0.0), (0.0, 0.25))
    for i in range(2):
        builder.add_box(builder.add_body(position=(2.3, 0.3 + 0.6 * i), angle=0.02), 0.3, 0.3)
    builder.add_disc(builder.add_body(position=(2.9 - 1.2, 0.2)), 0.2)


def bounce(builder: dc.ModelBuilder) -> None:
    """Bouncing discs and a bouncing box, without friction."""
    builder.add_world()
    add_ground(builder, width=4.0)
    for i in range(5):
        body = builder.add_body(position=(-1.6 + 0.8 * i, 0.46 + 0.1 * i), velocity=(2.0 - i, -5.0))
        builder.add_disc(body, 0.35, restitution=0.2 * i, friction=0.0)
    box = builder.add_body(position=(0.3, 1.6), velocity=(0.0, -6.0), angle=0.2)
    builder.add_box(box, 0.3, 0.2, restitution=0.8, friction=0.0)


def kinematic(builder: dc.ModelBuilder) -> None:
    """A kinematic paddle that turns among discs, and forces."""
    builder.add_world(gravity=(0.0, -3.0))
    add_ground(builder, width=4.0)
    paddle = builder.add_body(
        position=(0.0, 1.8), velocity=(0.3, 0.1), angular_velocity=1.5, type=dc.BodyType.KINEMATIC
    )
    builder.add_box(paddle, 1.0, 0.1)
    for i in range(8):
        builder.add_disc(builder.add_body(position=(-1.4 + 0.7 * (i % 4), 0.31 + 1.95 * (i // 4))), 0.3)


def frozen(builder: dc.ModelBuilder) -> None:
    """Three worlds; the one in the middle is made to freeze (see ``simulation``)."""
    for columns in (2, 3, 2):
        discs(builder, columns, 2)


def worlds(builder: dc.ModelBuilder) -> None:
    """Two worlds of different size, an empty one, and one of boxes."""
    discs(builder, 2, 2)
    builder.add_world()
    boxes(builder)
    discs(builder, 3, 4)


def crowd(builder: dc.ModelBuilder, seed: int = 0, count: int = 40) -> None:
    """Shapes of all kinds and of sizes 1 : 30, thrown over each other at random."""
    draw = np.random.default_rng(seed)
    builder.add_world(length_scale=0.5)
    ground = builder.add_body(type=dc.BodyType.STATIC)
    x = np.linspace(-4.0, 4.0, 9)
    builder.add_chain(ground, np.stack([x, draw.uniform(-0.6, 0.6, 9)], axis=1))
    builder.add_chain(ground, draw.normal(size=(5, 2)).cumsum(axis=0) + 2.0, closed=True)
    for i in range(count):
        kind = (dc.BodyType.DYNAMIC, dc.BodyType.DYNAMIC, dc.BodyType.DYNAMIC, dc.BodyType.KINEMATIC)[i % 4]
        body = builder.add_body(
            position=draw.uniform((-4, -1), (4, 4)),
            angle=draw.uniform(-9, 9),
            velocity=draw.normal(0, 3, 2),
            angular_velocity=draw.normal(0, 100 if i % 7 == 0 else 5),
            type=kind,
        )
        size = 0.05 * 30 ** draw.uniform()
        if i % 5 == 0:
            builder.add_disc(body, size, friction=draw.uniform(), restitution=draw.uniform())
        elif i % 5 == 1:
            builder.add_capsule(body, draw.normal(size=2), draw.normal(size=2), 0.3 * size)
        else:
            turn = np.linspace(0, 2 * np.pi, draw.integers(4, 10))[:-1]
            corners = size * np.stack([np.cos(turn), 0.6 * np.sin(turn)], axis=1) + draw.normal(0, 0.2, 2)
            builder.add_polygon(body, corners, radius=draw.choice([0.0, 0.1 * size]), friction=draw.uniform())
            if i % 5 == 3:
                builder.add_disc(body, 0.4 * size, center=draw.normal(0, 0.3, 2), mask=0xFFFFFFFF ^ draw.integers(4))


def simulation(scene: Callable[[dc.ModelBuilder], None], dtype: str, backend: str, **options: Any) -> dc.Simulation:
    builder = dc.ModelBuilder()
    scene(builder)
    model, state, joints = builder.finalize(dtype=dtype, backend=backend)
    sim = dc.Simulation(model, state, joints, **options)
    if scene is frozen:
        state.numpy("velocity")[model.numpy("body_start")[2] - 1] = np.inf
    if scene is kinematic:
        state.numpy("force")[-1] = (0.4, 1.0)
        state.numpy("torque")[-1] = 0.05
    return sim


# ---------------------------------------------------------------------- tables


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("variant", list(COLUMNS))
@pytest.mark.parametrize("only_discs", [False, True])
def test_backends_have_the_same_kernels(dtype: str, variant: str, only_discs: bool) -> None:
    warp = kernel_table("warp", dtype, variant, only_discs)
    oracle = kernel_table("numpy", dtype, variant, only_discs)
    assert list(warp) == list(oracle)
    for name in warp:
        assert argument_names(warp[name]) == argument_names(oracle[name]), name


def test_kernels_take_what_their_stages_name() -> None:
    table = kernel_table("numpy", "float32", "general", False)
    for stage in STEP:
        wanted = {*stage.reads, *stage.writes}
        assert set(argument_names(table[stage.kernel])) & set(GROUPS) == wanted, stage.kernel


# ---------------------------------------------------------------------- kernel by kernel


def assert_close(name: str, got: np.ndarray, want: np.ndarray, bound: float) -> None:
    if want.dtype.kind in "iu":
        np.testing.assert_array_equal(got, want, err_msg=name)
        return
    usual = np.abs(want[np.isfinite(want) & (np.abs(want) < 1e30)])  # not what stands for infinity
    np.testing.assert_allclose(got, want, rtol=0, atol=bound * max(1.0, usual.max(initial=0.0)), err_msg=name)


def numbers_of(struct: Any, table: Mapping[str, Any]) -> SimpleNamespace:
    """The numbers of a Warp struct by name, as the oracle takes them."""
    return SimpleNamespace(**{name: getattr(struct, name) for name in table})


class Pair:
    """A simulation on Warp and the oracle's kernels for it."""

    def __init__(self, sim: dc.Simulation) -> None:
        self.sim = sim
        self.bound = KERNEL_BOUND[sim.dtype.name]
        self.oracle = kernel_table("numpy", sim.dtype.name, sim.variant, sim.only_discs)

    def run(self, name: str, dim: int | tuple[int, int] | None = None, **more: Any) -> None:
        """Launch a kernel of both backends on equal arrays and compare all of them; Warp's results remain."""
        dim = self.sim.model.world_count if dim is None else dim
        values = {**self.sim.launch_values(0, {}), **more}
        used = [key for key in argument_names(self.oracle[name]) if key in GROUPS]
        copies = {key: self.copied(key) for key in used}
        numbers = {key: numbers_of(values[key], table) for key, table in (("config", CONFIG), ("launch", LAUNCH))}
        written = {group for stage in STEP if stage.kernel == name for group in stage.writes}
        unwritten = {key: self.copied(key) for key in used if written and key not in written}
        bind(self.oracle[name], dim, {**more, **numbers, **copies}, "cpu")()
        bind(self.sim.kernels[name], dim, values, "cpu")()
        for key, before in unwritten.items():
            for field in getattr(self.sim, key).table:
                now = getattr(self.sim, key).numpy(field)
                assert now.tobytes() == getattr(before, field).tobytes(), f"{name} writes {key}.{field}"
        for key in used:
            group = getattr(self.sim, key)
            for field in set(group.table) - SCRATCH:
                got, want = getattr(copies[key], field), group.numpy(field)
                for part in want.dtype.names or (None,):
                    assert_close(
                        f"{name}: {key}.{field} {part or ''}",
                        got if part is None else got[part],
                        want if part is None else want[part],
                        self.bound,
                    )

    def copied(self, name: str) -> SimpleNamespace:
        """A group of the simulation as the oracle may write to it."""
        group = getattr(self.sim, name)
        arrays = {field: group.numpy(field).copy() for field in group.table}
        return SimpleNamespace(**{field: a.view(np.recarray) if a.dtype.names else a for field, a in arrays.items()})

    def colors(self) -> list[tuple[int, int]]:
        """Colours with rows and their widest world's rows."""
        ends = self.sim.rows.numpy("color_block").reshape(-1, COLORS + 1)
        widest = np.diff(ends, axis=1).max(axis=0) * LANES
        return [(k, 1 if k == SERIAL_COLOR else int(widest[k])) for k in np.flatnonzero(widest)]


KERNEL_CASES = {
    "discs aitken": (discs, 25, {"aitken_period": 3}),
    "discs jacobi": (discs, 12, {"method": "jacobi", "acceleration": "none", "history": True}),
    "mixed residual": (mixed, 20, {"acceleration": "none", "stop": "residual", "residual_every": 2}),
    "mixed sor": (mixed, 45, {"acceleration": "sor"}),
    "boxes nncg": (boxes, 10, {"acceleration": "nncg"}),
    "boxes jacobi aitken": (boxes, 30, {"method": "jacobi", "aitken_period": 3, "position_correction": "baumgarte"}),
    "pendulum aitken": (pendulum, 10, {"aitken_period": 3, "position_correction": "baumgarte"}),
    "pendulum jacobi nncg": (pendulum, 30, {"method": "jacobi", "acceleration": "nncg", "stop": "residual"}),
    "bounce": (bounce, 9, {"acceleration": "none"}),
    "kinematic zero start": (kinematic, 20, {"start": "zero", "acceleration": "none"}),
    "frozen": (frozen, 5, {}),
    "worlds": (worlds, 15, {"acceleration": "nncg"}),
    "discs adaptive": (discs, 25, {"start": "zero", "stretch": 10, "max_sweeps": 24}),
    "pendulum adaptive": (
        pendulum,
        10,
        {"stretch": 10, "max_sweeps": 24, "method": "jacobi", "acceleration": "adaptive"},
    ),
}


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("case", list(KERNEL_CASES))
def test_each_kernel_agrees(case: str, dtype: str) -> None:
    scene, steps, settings = KERNEL_CASES[case]
    # few sweeps and no early end: float32 may not decide otherwise in one backend
    config = dc.SolverConfig(**{"max_sweeps": 7, "tolerance": 0.0, **settings})
    sim = simulation(scene, dtype, "warp", config=config)
    with np.errstate(all="ignore"):
        sim.run(steps, DT)
    sim.collide(1.5 * DT)  # another time step, and room for what follows
    pair = Pair(sim)
    for name in ("predict", "update_pairs"):
        pair.run(name)
    sim.pairs.numpy("valid")[...] = 0
    for name in ("update_pairs", "narrowphase", "match_contacts", "color_constraints", "pack_rows"):
        pair.run(name)
    count = sim.contacts.numpy("contact_count")
    assert count.sum() > 3
    assert (sim.state.numpy("flags") != 0).tolist() == [w == 1 and scene is frozen for w in range(len(count))]
    pair.run("begin")
    for _ in range(3):
        pair.run("before_sweep")
        for color, width in pair.colors():
            pair.run("sweep_color", (len(count), width), color=color)
        pair.run("after_sweep")
    for name in ("finish", "solve_world", "unpack_impulses", "displace", "correct_positions", "commit"):
        pair.run(name)
    assert (sim.stats.numpy("sweeps")[count > 0] >= 0).all()


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("seed", range(6))
def test_collision_of_a_crowd_agrees(seed: int, dtype: str) -> None:
    sim = simulation(lambda builder: crowd(builder, seed), dtype, "warp")
    sim.collide(DT)
    pair = Pair(sim)
    sim.pairs.numpy("valid")[...] = 0
    for name in ("predict", "update_pairs", "narrowphase", "match_contacts", "color_constraints", "pack_rows"):
        pair.run(name)
    assert sim.contacts.numpy("contact_count").sum() > 20


@pytest.mark.parametrize(
    ("kernel", "start", "flag"),
    [
        ("update_pairs", ("pairs", "start"), Flag.PAIR_OVERFLOW),
        ("narrowphase", ("contacts", "contact_start"), Flag.CONTACT_OVERFLOW),
        ("pack_rows", ("rows", "block_start"), Flag.ROW_OVERFLOW),
    ],
)
def test_overflow_is_flagged_alike(kernel: str, start: tuple[str, str], flag: Flag) -> None:
    sim = simulation(worlds, "float64", "warp")
    sim.run(12, DT)
    sim.collide(DT)
    sim.pairs.numpy("valid")[...] = 0
    to_numpy(getattr(sim, start[0]).array(start[1]))[...] = 0  # no room at all
    Pair(sim).run(kernel)
    assert sim.state.numpy("flags").tolist() == [flag, 0, flag, flag]  # the second world is empty
    assert flag in CAPACITY_FLAGS


# ---------------------------------------------------------------------- whole runs

RUN_CASES = {
    "discs": (discs, "world", {}),
    "discs by colour": (discs, "color", {"acceleration": "nncg"}),
    "mixed": (mixed, "world", {"history": True}),
    "mixed jacobi": (mixed, "world", {"method": "jacobi", "acceleration": "none", "max_sweeps": 12}),
    "boxes": (boxes, "world", {"stop": "residual", "position_correction": "baumgarte"}),
    "boxes by colour": (boxes, "color", {"method": "jacobi"}),
    "pendulum": (pendulum, "world", {"acceleration": "sor"}),
    "pendulum by colour": (pendulum, "color", {}),
    "bounce": (bounce, "world", {"start": "zero", "position_correction": "none"}),
    "kinematic": (kinematic, "color", {}),
    "frozen": (frozen, "world", {}),
    "worlds": (worlds, "world", {"acceleration": "none"}),
    "mixed adaptive": (mixed, "world", {"stretch": 10, "max_sweeps": 60}),
    "boxes adaptive by colour": (boxes, "color", {"stretch": 10, "max_sweeps": 60}),
    "worlds adaptive": (worlds, "world", {"stretch": 10, "max_sweeps": 60, "tolerance": 1e-9}),
    "impatient": (mixed, "world", {"aitken_patience": 1, "aitken_period_max": 4, "max_sweeps": 60}),
    "impatient by colour": (boxes, "color", {"aitken_patience": 1, "aitken_period_max": 4, "max_sweeps": 60}),
}


@pytest.mark.parametrize("case", list(RUN_CASES))
def test_runs_agree(case: str) -> None:
    scene, schedule, settings = RUN_CASES[case]
    config = dc.SolverConfig(**{"max_sweeps": 25, **settings})
    # too little room at first: it has to grow alike
    options = {"config": config, "schedule": schedule, "pairs_per_shape": 0.5, "contacts_per_body": 0.2}
    one, two = (simulation(scene, "float64", backend, **options) for backend in ("warp", "numpy"))
    seen = 0
    for steps in (10, 10):
        with np.errstate(all="ignore"):
            one.run(steps, DT)
            two.run(steps, DT)
        for group, names in (("state", STATE), ("motion", MOTION)):
            for name in set(names) - {"summed"}:
                got, want = getattr(two, group).numpy(name), getattr(one, group).numpy(name)
                assert_close(name, got, want, RUN_BOUND)
        for w, count in enumerate(one.contacts.numpy("contact_count")):
            seen += int(count)
            assert count == two.contacts.numpy("contact_count")[w]
            first = one.contacts.numpy("contact_start")[w]
            for name, field in one.contacts.table.items():
                if field.per == "contact":
                    used = (sim.contacts.numpy(name)[first : first + count] for sim in (two, one))
                    assert_close(name, *used, RUN_BOUND)
        for name in ("sweeps", "change", "residual"):
            assert_close(name, two.stats.numpy(name), one.stats.numpy(name), RUN_BOUND)
        assert_close("joint_impulse", two.joints.numpy("joint_impulse"), one.joints.numpy("joint_impulse"), RUN_BOUND)
        assert_close("history", to_numpy(two.stats.history), to_numpy(one.stats.history), RUN_BOUND)
        assert one.capacity() == two.capacity()
    assert seen > 3
