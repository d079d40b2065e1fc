"""Taichi's kernels leave the bits of Warp's: the same names and groups, then stage by stage on the same memory."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import dc_kernels as dc
from dc_kernels._taichi.runtime.signals import WORDS
from dc_kernels.collide.narrowphase import FOUND
from dc_kernels.model.config import CONFIG
from dc_kernels.model.dtypes import aligned_zeros
from dc_kernels.model.fields import LAUNCH
from dc_kernels.model.groups import GROUPS
from dc_kernels.runtime.backends import argument_names, bind, has_kernels, kernel_file, make_kernels
from dc_kernels.solve.rows import has_traits
from dc_kernels.stages import STEP, Stage
from tests.parity.scenes import (
    SCRATCH,
    bounce,
    boxes,
    carried,
    crowd,
    discs,
    frozen,
    in_use,
    kinematic,
    mixed,
    pendulum,
    simulation,
    worlds,
)

pytest.importorskip("dc_kernels._taichi.runtime.compiler", exc_type=ImportError)
from dc_kernels._taichi.groups import SHARED

DT = 0.01
PORTED = tuple(stage for stage in STEP if has_kernels("taichi", stage.file))


def many(builder: dc.ModelBuilder) -> None:
    """All kinds of worlds in one simulation."""
    for scene in (mixed, boxes, pendulum, bounce, kinematic, worlds, carried):
        scene(builder)
    for seed in range(4):
        crowd(builder, seed)


SCENES = {"discs": (frozen, 9), "many": (many, 12)}


def made(backend: str, stage: Stage, sim: dc.Simulation) -> dict[str, Any]:
    """The kernels of a stage's file for a simulation."""
    options = {"variant": sim.variant, "only_discs": sim.only_discs, "traits": has_traits(sim.model)}
    return make_kernels(backend, stage.file, sim.dtype.name, *(options[name] for name in stage.options))


class Twin:
    """A simulation on Warp, and Taichi's kernels on copies of its memory."""

    def __init__(self, sim: dc.Simulation) -> None:
        self.sim = sim
        self.kernels: dict[str, Any] = {}
        for stage in PORTED:
            self.kernels.update(made("taichi", stage, sim))

    def run(self, name: str, dim: int | tuple[int, int] | None = None, threads: int = 1, **more: Any) -> None:
        """Launch a kernel of both backends on equal arrays and compare the bits of all of them; Warp's remain."""
        sim, kernel = self.sim, self.kernels[name]
        dim = sim.model.world_count if dim is None else dim
        values = {**sim.launch_values(0, {}), **more}
        copies = {key: self.copied(key) for key in argument_names(kernel) if key in GROUPS}
        for (group, field), (other, whole) in SHARED.items():  # one memory in the simulation, and so in the copies
            if group in copies and other in copies and hasattr(getattr(sim, group), field):
                one, two = (getattr(sim, name).numpy(key) for name, key in ((group, field), (other, whole)))
                if one.size and one.ctypes.data == two.ctypes.data:
                    setattr(copies[group], field, getattr(copies[other], whole))
        numbers = {
            key: SimpleNamespace(**{field: getattr(values[key], field) for field in table})
            for key, table in (("config", CONFIG), ("launch", LAUNCH))
        }
        numbers["launch"].cut = np.zeros(WORDS, np.int32)
        bind(kernel, dim, {**more, **numbers, **copies, "threads": threads}, "cpu")()
        bind(sim.kernels[name], dim, values, "cpu")()
        for key, copy in copies.items():
            for field, want in getattr(sim, key).views().items():
                # a simulation of Warp solves its worlds in turn: on threads they write to one place of "past" at once
                if field in SCRATCH or (field == "past" and threads > 1):
                    continue
                got, want = (
                    in_use(field, array, getattr(sim, "pairs", None)) for array in (getattr(copy, field), want)
                )
                if (key, field) == ("rows", "body"):  # each thread has a padding body, one behind the other
                    got = np.minimum(got, values["launch"].padding_body)
                assert got.tobytes() == want.tobytes(), f"{name}: {key}.{field}: {difference(got, want)}"

    def copied(self, name: str) -> SimpleNamespace:
        """A group of the simulation in memory of its own."""
        made = {}
        for field, array in getattr(self.sim, name).views().items():
            made[field] = aligned_zeros(array.shape, array.dtype)
            made[field][...] = array
        return SimpleNamespace(**made)


def difference(got: np.ndarray, want: np.ndarray) -> str:
    """Where two arrays differ first."""
    unequal = np.argwhere(got != want)
    at = tuple(int(i) for i in unequal[0]) if len(unequal) else ()
    return f"{len(unequal)} differ, first [{at}]: {got[at]}, Warp has {want[at]}"


def started(scene: Callable[[dc.ModelBuilder], None], steps: int, dtype: str) -> dc.Simulation:
    """A simulation that has run for some steps, and has begun another."""
    sim = simulation(scene, dtype, "warp", config=dc.SolverConfig(max_sweeps=12, tolerance=0.0))
    with np.errstate(all="ignore"):
        sim.run(steps, DT)
    sim.collide(1.5 * DT)  # another time step, and room for what follows
    return sim


@pytest.mark.parametrize("stage", PORTED, ids=lambda stage: stage.kernel)
def test_kernels_have_the_names_and_arguments_of_warp(stage: Stage) -> None:
    sim = simulation(discs, "float32", "warp")
    warp, taichi = made("warp", stage, sim), made("taichi", stage, sim)
    assert list(taichi) == list(warp)
    for name, kernel in taichi.items():
        assert argument_names(kernel) == argument_names(warp[name]), name


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("scene", list(SCENES))
def test_each_stage_leaves_the_bits_of_warp(scene: str, dtype: str) -> None:
    sim = started(*SCENES[scene], dtype)
    twin = Twin(sim)
    for name in ("predict", "update_pairs"):  # the pairs kept first
        twin.run(name)
    sim.pairs.numpy("valid")[...] = 0
    for stage in STEP:
        if stage.kernel in twin.kernels:
            twin.run(stage.kernel)
        else:
            sim.bind(stage.kernel, 0, sim.model.world_count)()
    assert sim.contacts.numpy("contact_count").sum() > 5
    assert (sim.state.numpy("flags") != 0).any() == (scene == "discs")


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_a_trajectory_has_the_bits_of_warp(dtype: str) -> None:
    """Phase by phase: with the kernels that the stages have; ``test_taichi_steps`` runs a step as one kernel."""
    sims = [simulation(many, dtype, backend, contacts_per_body=0.3) for backend in ("warp", "taichi")]
    for _ in range(200):
        for sim in sims:
            sim.collide(DT)
            sim.solve()
            sim.advance()
    for name in sims[0].state.views():
        want, got = (sim.state.numpy(name) for sim in sims)
        assert got.tobytes() == want.tobytes(), f"{name}: {difference(got, want)}"


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_pairs_of_boxes_have_the_bits_of_warp(dtype: str) -> None:
    found = {}
    for backend in ("warp", "taichi"):
        builder = dc.ModelBuilder()
        many(builder)
        model, state, _ = builder.finalize(dtype, backend=backend)
        boxes_of = dc.ShapeBoxes(model, state.numpy("position"), state.numpy("angle"), margin=0.05, threads=2)
        boxes_of()
        kinds = {name: model.numpy(f"shape_{name}") for name in ("body", "category", "mask")}
        start = model.numpy("shape_start")
        broadphase = dc.Broadphase(
            boxes_of.lower if backend == "taichi" else boxes_of.lower.numpy(),
            boxes_of.upper if backend == "taichi" else boxes_of.upper.numpy(),
            start,
            margin=0.1,
            max_pairs=2000,
            shape_body=kinds["body"],
            body_type=model.numpy("body_type"),
            category=kinds["category"],
            mask=kinds["mask"],
            threads=2,
            backend=backend,
        )
        broadphase()
        broadphase()  # kept
        group = broadphase.pairs
        promised = set(group.table) - SCRATCH - {"near_a", "near_b"}
        found[backend] = {name: in_use(name, group.numpy(name), group).tobytes() for name in promised}
        found[backend] |= {"lower": broadphase.lower.tobytes(), "filters": broadphase._filters.tobytes()}
        assert broadphase.count.numpy().sum() > 50 if backend == "warp" else broadphase.count.sum() > 50
    assert [name for name in found["warp"] if found["warp"][name] != found["taichi"][name]] == []


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_contacts_of_a_stage_have_the_bits_of_warp(dtype: str) -> None:
    found = {}
    for backend in ("warp", "taichi"):
        builder = dc.ModelBuilder()
        many(builder)
        model, state, _ = builder.finalize(dtype, backend=backend)
        place = state.numpy("position"), state.numpy("angle")
        every = [
            np.stack(np.triu_indices(b - a, 1), axis=1) + a
            for a, b in itertools.pairwise(model.numpy("shape_start").tolist())
        ]
        start = np.cumsum([0, *(len(rows) for rows in every)])
        pairs = np.concatenate(every).astype(np.int32)[:, ::-1]  # taken in either order
        narrowphase = dc.Narrowphase(model, *place, np.ascontiguousarray(pairs), pair_start=start, threads=2)
        narrowphase()  # grows
        found[backend] = {name: narrowphase.numpy(name) for name in (*FOUND, "point")}
        place[0][-1, 1] = np.inf
        with pytest.raises(ValueError, match="position"):
            narrowphase()
    assert len(found["warp"]["key"]) > 200
    for name, want in found["warp"].items():
        assert want.tobytes() == found["taichi"][name].tobytes(), difference(found["taichi"][name], want)


def test_colors_of_a_stage_are_those_of_warp() -> None:
    draw = np.random.default_rng(3)
    a = np.zeros(400, np.int32)
    b = draw.integers(1, 40, 400).astype(np.int32)
    a[200:] = (b[200:] + draw.integers(1, 38, 200) - 1) % 39 + 1
    color = draw.integers(-3, 70, 400).astype(np.int32)
    movable = np.arange(40) % 9 != 2
    for kept in (None, color):
        want = dc.color(a, b, movable, color=None if kept is None else kept.copy())
        got = dc.color(a, b, movable, color=None if kept is None else kept.copy(), backend="taichi")
        np.testing.assert_array_equal(got, want)
    assert (want == 63).sum() > 9 and (want == color).sum() > 9


def test_colors_of_a_callers_own_rows_are_those_of_warp() -> None:
    found = {}
    for backend in ("warp", "taichi"):
        draw = np.random.default_rng(5)
        a, b = draw.permuted(np.tile(np.arange(12, dtype=np.int32), (90, 1)), axis=1)[:, :2].T
        every = {
            "launch": {},
            "model": {"body_start": [0, 12], "body_type": np.arange(12) % 4 // 2 * 2},
            "state": {"flags": [0]},
            "joints": {},
            "contacts": {"contact_start": [0, 50], "contact_count": [50], "body_a": a[:50], "body_b": b[:50]},
            "rows": {"row_start": [0, 40], "row_body_a": a[50:], "row_body_b": b[50:], "row_color": np.zeros(40)},
        }
        every["rows"]["line_start"] = [0, 0]
        every["contacts"]["color"] = draw.integers(-1, 9, 50)
        arrays = {group: {k: np.array(v, np.int32) for k, v in some.items()} for group, some in every.items()}
        arrays["rows"]["color_mask"] = np.zeros(12, np.uint64)
        make, tables = kernel_file(backend, "groups").group, {**GROUPS, "launch": LAUNCH}
        values = {name: make(name, "float32", tables[name], some) for name, some in arrays.items()}
        for name in ("keep_colors", "color_constraints"):
            bind(make_kernels(backend, "collide.color", "float32")[name], 1, values, "cpu")()
        found[backend] = arrays["contacts"]["color"].tolist(), arrays["rows"]["row_color"].tolist()
    assert found["warp"] == found["taichi"]
    assert len(set(found["warp"][1])) > 5


@pytest.mark.parametrize("stage", PORTED, ids=lambda stage: stage.kernel)
def test_a_stage_has_the_same_bits_on_threads(stage: Stage) -> None:
    twin = Twin(started(*SCENES["many"], "float32"))
    twin.sim.pairs.numpy("valid")[...] = 0
    twin.run(stage.kernel, threads=3)


def test_a_fault_of_one_bit_in_any_stage_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    twin = Twin(started(discs, 3, "float32"))
    whole, faults = bind, []

    def faulty(kernel: Any, dim: Any, values: dict[str, Any], device: str) -> Any:
        launch = whole(kernel, dim, values, device)

        def run() -> None:
            arrays = {
                (key, field): array for key in GROUPS if key in values for field, array in vars(values[key]).items()
            }
            before = {name: array.tobytes() for name, array in arrays.items()}
            launch()
            changed = [name for name, array in arrays.items() if array.tobytes() != before[name]]
            # what there was nothing to do for may be wrong, too
            name = next(
                n for n in (*changed, *arrays) if n[0] in current.writes and n[1] not in SCRATCH and arrays[n].size
            )
            arrays[name].reshape(-1).view(np.uint8)[0] ^= 1
            faults.append(".".join(name))

        return run if kernel in twin.kernels.values() else launch

    monkeypatch.setattr(f"{__name__}.bind", faulty)
    twin.sim.pairs.numpy("valid")[...] = 0
    for current in PORTED:
        with pytest.raises(AssertionError) as caught:
            twin.run(current.kernel)
        assert str(caught.value).startswith(f"{current.kernel}: {faults[-1]}: 1 differ")
    assert len(faults) == len(STEP)


@settings(max_examples=6, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6), count=st.integers(1, 9), steps=st.integers(0, 3), dt=st.sampled_from([0.003, 0.02]))
def test_drawn_scenes_have_the_bits_of_warp_and_the_numbers_of_the_oracle(
    seed: int, count: int, steps: int, dt: float
) -> None:
    def scene(builder: dc.ModelBuilder) -> None:
        crowd(builder, seed, count)
        discs(builder, 1 + seed % 3, 1 + count % 3)
        pendulum(builder)  # the kernels are then those of the scene "many"

    config = dc.SolverConfig(max_sweeps=12, tolerance=0.0)
    warp, oracle = (simulation(scene, "float64", backend, config=config) for backend in ("warp", "numpy"))
    warp.run(steps, dt)
    oracle.run(steps, dt)
    oracle.collide(dt)
    oracle.solve()
    warp.collide(dt)  # room for what the stages find again
    twin = Twin(warp)
    for stage in PORTED:
        twin.run(stage.kernel)
        if stage.kernel == "unpack_impulses":
            solved = [sim.motion.numpy("solved")[:, :3][: sim.model.body_count] for sim in (warp, oracle)]
            np.testing.assert_allclose(*solved, rtol=1e-7, atol=1e-7)
