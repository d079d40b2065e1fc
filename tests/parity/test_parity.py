"""Warp and the oracle agree: the same tables, kernel by kernel on the same arrays, and over whole runs.

The NumPy kernels are written from the formulas and without culling, lanes or cells, so agreement says that the fast
kernels compute what they should.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels.model.arrays import to_numpy
from dc_kernels.model.config import CONFIG
from dc_kernels.model.enums import CAPACITY_FLAGS, Flag
from dc_kernels.model.fields import LAUNCH, MOTION, PER_CONTACT, STATE
from dc_kernels.model.groups import GROUPS
from dc_kernels.runtime.backends import argument_names, bind
from dc_kernels.solve.rows import COLORS, COLUMNS, LANES, SERIAL_COLOR, has_traits
from dc_kernels.stages import ADDED, PHASES, SLEEP, SOFT, STEP, kernel_table, of_phase
from tests.parity.scenes import (
    SCRATCH,
    bounce,
    boxes,
    crowd,
    discs,
    frozen,
    in_use,
    kinematic,
    mixed,
    pendulum,
    simulation,
    surfaces,
    worlds,
)
from tests.solve.test_joints import gallery, rope_of_rods

DT = 0.01
# Allowed difference, relative to the largest value of the array (1 if all are smaller): of one kernel, where a whole
# solve counts as one, and of a run.
KERNEL_BOUND = {"float64": 1e-10, "float32": 1e-4}
RUN_BOUND = 1e-9
ADDITIONS = tuple(stage.kernel for stage in ADDED)


# ---------------------------------------------------------------------- tables


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("variant", list(COLUMNS))
@pytest.mark.parametrize("only_discs", [False, True])
def test_backends_have_the_same_kernels(dtype: str, variant: str, only_discs: bool) -> None:
    warp = kernel_table("warp", dtype, variant, only_discs, sleep=True, added=ADDITIONS)
    oracle = kernel_table("numpy", dtype, variant, only_discs, sleep=True, added=ADDITIONS)
    assert list(warp) == list(oracle)
    for name in warp:
        assert argument_names(warp[name]) == argument_names(oracle[name]), name


def test_kernels_take_what_their_stages_name() -> None:
    table = kernel_table("numpy", "float32", "general", False, sleep=True, soft=True, added=ADDITIONS)
    for stage in (*STEP, *SLEEP, *SOFT, *ADDED):
        wanted = {*stage.reads, *stage.writes}
        assert set(argument_names(table[stage.kernel])) & set(GROUPS) == wanted, stage.kernel


# ---------------------------------------------------------------------- kernel by kernel


def assert_close(name: str, got: np.ndarray, want: np.ndarray, bound: float) -> None:
    if got.dtype == want.dtype and got.shape == want.shape and got.tobytes() == want.tobytes():
        return  # most are
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

    def __init__(self, sim: dc.Simulation, added: tuple[str, ...] = ()) -> None:
        self.sim = sim
        self.bound = KERNEL_BOUND[sim.dtype.name]
        options = {"sleep": sim.config.sleep, "traits": has_traits(sim.model), "added": added}
        self.oracle = kernel_table("numpy", sim.dtype.name, sim.variant, sim.only_discs, **options)

    def run(self, name: str, dim: int | tuple[int, int] | None = None, **more: Any) -> None:
        """Launch a kernel of both backends on equal arrays and compare all of them; Warp's results remain."""
        dim = self.sim.model.world_count if dim is None else dim
        values = {**self.sim.launch_values(0, {}), **more}
        used = [key for key in argument_names(self.oracle[name]) if key in GROUPS]
        copies = {key: self.copied(key) for key in used}
        if {"rows", "joints"} <= copies.keys():  # general rows lie in the memory of their joints
            for field in ("impulse", "color"):
                if np.shares_memory(
                    *(getattr(self.sim, key).numpy(f"{key[:-1]}_{field}") for key in ("rows", "joints"))
                ):
                    setattr(copies["rows"], f"row_{field}", getattr(copies["joints"], f"joint_{field}"))
        numbers = {key: numbers_of(values[key], table) for key, table in (("config", CONFIG), ("launch", LAUNCH))}
        written = {group for stage in (*STEP, *SLEEP, *ADDED) if stage.kernel == name for group in stage.writes}
        unwritten = {key: self.copied(key) for key in used if written and key not in written}
        bind(self.oracle[name], dim, {**more, **numbers, **copies}, "cpu")()
        bind(self.sim.kernels[name], dim, values, "cpu")()
        for key, before in unwritten.items():
            for field in set(getattr(self.sim, key).table) - SCRATCH:
                now = getattr(self.sim, key).numpy(field)
                assert now.tobytes() == getattr(before, field).tobytes(), f"{name} writes {key}.{field}"
        for key in used:
            group = getattr(self.sim, key)
            for field in set(group.table) - SCRATCH:
                got, want = (
                    in_use(field, a, self.sim.pairs) for a in (getattr(copies[key], field), group.numpy(field))
                )
                for part in want.dtype.names or (None,):
                    assert_close(
                        f"{name}: {key}.{field} {part or ''}",
                        got if part is None else got[part],
                        want if part is None else want[part],
                        self.bound,
                    )

    def launch(self, name: str) -> None:
        """Launch Warp's kernel alone."""
        bind(self.sim.kernels[name], self.sim.model.world_count, self.sim.launch_values(0, {}), "cpu")()

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


@pytest.mark.parametrize("links", [0, 4])
def test_each_kernel_of_joints_agrees(links: int) -> None:
    """All kinds, or rods with rows across alone, whose tree is solved in some steps."""
    builder = dc.ModelBuilder()
    if links:
        rope_of_rods(builder, links, 30.0, angle=0.5)
    else:
        builder = gallery()
    sim = dc.Simulation(*builder.finalize("float64"), config=dc.SolverConfig(acceleration="none", max_sweeps=12))
    sim.run(6, DT)
    pair, config = Pair(sim, sim.added_kernels), sim.config
    for _ in range(2):
        sim.storage.integrator.set_time_step(DT)
        for phase in PHASES:
            for name in of_phase(phase, config.corrects_positions, added=sim.added_kernels):
                pair.run(name)
    assert sim.rows.numpy("tree_used").any() and not sim.state.numpy("flags").any()


def test_each_kernel_of_surfaces_agrees() -> None:
    sim = simulation(surfaces, "float64", "warp", config=dc.SolverConfig(acceleration="none", max_sweeps=12))
    sim.run(20, DT)
    pair, config = Pair(sim, sim.added_kernels), sim.config
    for step in (1.5 * DT, DT):
        sim.storage.integrator.set_time_step(step)
        for phase in PHASES:
            for name in of_phase(phase, config.corrects_positions, added=sim.added_kernels):
                pair.run(name)
    assert np.count_nonzero(sim.cache.numpy("rolling_impulse")) > 2 and not sim.state.numpy("flags").any()


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
    "surfaces": (surfaces, "world", {}),
    "surfaces by colour": (surfaces, "color", {"method": "jacobi"}),
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
                if field.per in PER_CONTACT and len(one.contacts.numpy(name)):
                    used = (sim.contacts.numpy(name)[first : first + count] for sim in (two, one))
                    assert_close(name, *used, RUN_BOUND)
        for name in ("sweeps", "change", "residual"):
            assert_close(name, two.stats.numpy(name), one.stats.numpy(name), RUN_BOUND)
        assert_close("joint_impulse", two.joints.numpy("joint_impulse"), one.joints.numpy("joint_impulse"), RUN_BOUND)
        assert_close("history", to_numpy(two.stats.history), to_numpy(one.stats.history), RUN_BOUND)
        assert one.capacity() == two.capacity()
    assert seen > 3


@pytest.mark.parametrize("seed", range(3))
def test_no_contact_of_fast_shapes_is_left_out(seed: int) -> None:
    """The oracle looks at all pairs; Warp's kernel leaves those that are too far apart for their speeds."""

    def scene(builder: dc.ModelBuilder) -> None:
        draw = np.random.default_rng(seed)
        builder.add_world(length_scale=1.0)
        ground = builder.add_body(type=dc.BodyType.STATIC)
        builder.add_chain(ground, [(-4.0, 0.4), (-1.0, 0.0), (1.0, 0.0), (4.0, -0.3)])
        for i in range(40):
            at = (0.45 * (i % 8 - 3.5), 0.4 + 0.45 * (i // 8))
            speed, spin = 10.0 ** draw.uniform(-2.0, 1.5), 10.0 ** draw.uniform(-1.0, 1.7)
            body = builder.add_body(at, draw.uniform(-3, 3), draw.normal(size=2) * speed, draw.normal() * spin)
            off = draw.uniform(-0.05, 0.05, 2)
            if i % 4 == 0:
                builder.add_disc(body, 0.2, off)
                builder.add_disc(body, 0.1, -2.0 * off)
            elif i % 4 == 1:
                builder.add_capsule(body, (-0.15, 0.0), (0.15, 0.05), 0.1)
            else:
                count = 4 if i % 4 == 2 else int(draw.integers(3, 9))
                turn = (np.arange(count) + draw.uniform(-0.3, 0.3, count)) * (2.0 * np.pi / count)
                builder.add_polygon(body, 0.25 * np.stack([np.cos(turn), np.sin(turn)], axis=1) + off)

    one, two = (simulation(scene, "float64", backend, contacts_per_body=20) for backend in ("warp", "numpy"))
    for dt in (1.0 / 60.0, 1.0 / 240.0):
        for sim in (one, two):
            sim.collide(dt)
        count = int(one.contacts.numpy("contact_count")[0])
        assert count == two.contacts.numpy("contact_count")[0]
        assert count > 25
        np.testing.assert_array_equal(one.contacts.numpy("key")[:count], two.contacts.numpy("key")[:count])
        assert_close("gap", *(sim.contacts.numpy("gap")[:count] for sim in (two, one)), RUN_BOUND)
