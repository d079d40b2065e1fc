"""A solve in flight as a network reads it: the oracle, worlds and threads, closed forms, symmetries."""

from __future__ import annotations

import itertools
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels.learn.channels import IMAGE, LOCAL, OUTPUT, SHARE
from dc_kernels.learn.in_flight import RATE_NODES, SolveReader, in_flight_kernels
from dc_kernels.model.arrays import ArrayGroup
from dc_kernels.runtime.backends import argument_names, bind
from dc_kernels.solve.rows import COLUMNS, LANES
from pipeline.scenes import Mixed, Scene, Settled, Thesis
from tests.learn.flights import DT, colliding, contact_slots, reader_of, simulation, torch

STATIC = dc.BodyType.STATIC
# allowed difference of a feature of order 1: float32 rounds velocities, seen here at the scale of a sweep's step
BOUND = {"float64": 1e-9, "float32": 2e-3}
OUT = ("local", "image_value", "place", "place_a", "place_b", "step", "scale")


class Linked(Scene):
    """Discs on joints, which drag over a floor: rows of contacts and of joints; the last world hangs in the air."""

    name = "linked"

    def add_worlds(self, builder: dc.ModelBuilder, streams: Any) -> None:
        for w, _ in enumerate(streams):
            builder.add_world()
            floor = builder.add_body(type=STATIC)
            builder.add_box(floor, 9.0, 0.5, center=(0.0, -0.5))
            hook = builder.add_body((0.0, 8.0), type=STATIC)
            height = 5.0 if w + 1 == len(streams) else 0.5
            bodies = [builder.add_body((1.1 * i, height), velocity=(1.0, -0.5 * i)) for i in range(5)]
            for a, b in itertools.pairwise([hook, *bodies]):
                builder.add_distance_joint(a, b)
            for body in bodies:
                builder.add_disc(body, 0.5)


def named(reader: SolveReader) -> dict[str, np.ndarray]:
    """Features of the contacts by name, copied."""
    return dict(zip(LOCAL, reader.local[: reader.count].T.copy()))


def pictures(reader: SolveReader) -> dict[str, np.ndarray]:
    """Images (asked, rows, columns) by channel, copied."""
    return dict(zip(IMAGE, reader.image[: reader.asked].transpose(1, 0, 2, 3).copy()))


def running(sim: dc.Simulation) -> np.ndarray:
    return np.flatnonzero(sim.running)


# ---------------------------------------------------------------------- the oracle


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("variant", list(COLUMNS))
def test_backends_have_the_same_kernels(dtype, variant):
    warp, oracle = (in_flight_kernels(backend, dtype, variant) for backend in ("warp", "numpy"))
    assert list(warp) == list(oracle)
    for name in warp:
        assert argument_names(warp[name]) == argument_names(oracle[name]), name


def copied(group: ArrayGroup) -> SimpleNamespace:
    """The arrays of a group as the oracle takes them, copied."""
    arrays = {name: group.numpy(name).copy() for name in group.table}
    return SimpleNamespace(**{name: a.view(np.recarray) if a.dtype.names else a for name, a in arrays.items()})


def run_oracle(reader: SolveReader, kernel: str, begin: bool = False, **more: Any) -> dict[str, Any]:
    """All arguments of a kernel after the oracle has run on copies of them."""
    sim = reader.sim
    oracle = in_flight_kernels("numpy", sim.dtype.name, sim.variant)[kernel]
    names = ("model", "state", "contacts", "rows", "motion", "stats")
    values = {"world_offset": 0, "reading": copied(reader.reading), **more}
    values |= {name: copied(getattr(sim, name)) for name in names}
    values["settings"] = SimpleNamespace(
        begin=int(begin),
        accelerated=int(sim.config.acceleration != "none"),
        tolerance=sim.config.ends_at[1],
        cap=reader.cap,
        rate_spacing=RATE_NODES * reader.grid.spacing,
        limit=reader.limit,
        share=0.0 if begin else SHARE,
    )
    for name in OUT if kernel == "solve_features" else ():
        getattr(values["reading"], name).fill(np.nan)
    bind(oracle, reader.worlds, values, "cpu")()
    return values


def assert_features(reader: SolveReader, begin: bool) -> None:
    wanted = run_oracle(reader, "solve_features", begin)["reading"]
    for name in OUT:
        rows = reader.asked if name == "scale" else reader.count
        found, right = reader.reading.numpy(name)[:rows], getattr(wanted, name)[:rows]
        unit = right if name == "scale" else 1.0
        np.testing.assert_allclose(found / unit, right / unit, rtol=0, atol=BOUND[reader.sim.dtype.name], err_msg=name)


CASES = {
    "discs": (Thesis(bodies=30), {"acceleration": "none"}),
    "discs aitken": (Thesis(bodies=30), {}),
    "discs sor": (Thesis(bodies=30), {"acceleration": "sor"}),
    "mixed": (Mixed(bodies=14), {"acceleration": "none", "tolerance": 1e-6}),
    "mixed jacobi": (Mixed(bodies=14), {"method": "jacobi"}),
    "joints": (Linked(), {"acceleration": "none", "tolerance": 1e-7}),
}


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("case", list(CASES))
def test_the_kernels_agree(case, dtype):
    scene, config = CASES[case]
    sim = colliding(scene, dtype, 3 if case == "joints" else 100, **config)
    reader = reader_of(sim)
    draw = np.random.default_rng(1)
    for pause, worlds in itertools.zip_longest((0, 3, 5, 4), (running(sim), [0, 2], [1])):
        if pause:
            sim.resume(pause=pause)
        worlds = running(sim) if worlds is None else np.array(worlds)
        assert reader.read(worlds, begin=not pause) >= 5
        assert_features(reader, begin=not pause)
        output = draw.normal(0.0, 0.2, (reader.count, len(OUTPUT))).astype(dtype)
        output[: reader.packed_start[1]] *= 1e3 if pause == 5 else 1.0  # more than is taken
        wanted = run_oracle(reader, "correct_impulses", output=output)
        taken = reader.correct(torch.from_numpy(output))
        some = np.diff(reader.packed_start[: len(worlds) + 1]) > 0
        assert taken.tolist() == [pause != 5, *some[1:]]
        for label, group, names in (
            ("contacts", sim.contacts, ("impulse",)),
            ("reading", reader.reading, ("before", "known")),
            ("stats", sim.stats, ("replaced",)),
        ):
            for name in names:
                right = getattr(wanted[label], name)
                np.testing.assert_allclose(group.numpy(name), right, rtol=0, atol=BOUND[dtype], err_msg=name)


def test_the_oracle_reads_and_corrects_by_itself():
    """The whole way on the other backend: splat, gather, what is given with each call."""
    made = {}
    for backend in ("warp", "numpy"):
        sim = colliding(
            Settled(bodies=8), steps=2, worlds=2, run={"backend": backend}, acceleration="none", max_sweeps=30
        )
        reader = reader_of(sim)
        rows = []
        for pause in (0, 4, 4):
            if pause:
                sim.resume(pause=pause)
            reader.read(running(sim), begin=not pause)
            near = reader.gather(reader.images()[:, :5].contiguous())
            output = torch.cat([0.1 * near[0], near[2][:, :1]], dim=1)
            taken = reader.correct(output)
            rows += [reader.features().numpy().copy(), reader.images().numpy().copy(), taken]
            rows += [value.numpy().copy() for value in near]
        sim.resume()
        made[backend] = [*rows, sim.contacts.numpy("impulse").copy(), sim.stats.numpy("sweeps").copy()]
    assert made["warp"][0].shape[0] > 3
    for a, b in zip(made["warp"], made["numpy"], strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-8)


# ---------------------------------------------------------------------- worlds, threads, room


def everything(reader: SolveReader) -> list[np.ndarray]:
    """Copies of all that was read."""
    arrays = [getattr(reader, name)[: reader.count].copy() for name in ("local", "place", "place_a", "place_b", "step")]
    return [*arrays, reader.image[: reader.asked].copy(), reader.scale[: reader.asked].copy()]


def test_threads_read_the_same_bits():
    made = []
    for threads in (1, 2, 3):
        sim = colliding(worlds=5, dtype="float32")
        reader = reader_of(sim, threads=threads)
        reader.read(running(sim), begin=True)
        near = [value.numpy().copy() for value in reader.gather(reader.images())]
        reader.correct(torch.ones(reader.count, len(OUTPUT)))
        sim.resume(pause=5)
        reader.read(np.array([0, 1, 3, 4]), begin=False)
        made.append([*near, *everything(reader), sim.contacts.numpy("impulse").copy()])
    for other in made[1:]:
        for a, b in zip(made[0], other, strict=True):
            np.testing.assert_array_equal(a, b)


def test_a_world_is_read_alike_whatever_the_others():
    sim = colliding()
    reader = reader_of(sim)
    sim.resume(pause=6)
    reader.read(np.arange(3), begin=False)
    whole, first = everything(reader), reader.packed_start.copy()
    for worlds in ([1], [0, 2], [2]):
        reader.read(np.array(worlds), begin=False)
        rows = np.concatenate([np.arange(first[w], first[w + 1]) for w in worlds])
        for i, (found, wanted) in enumerate(zip(everything(reader), whole, strict=True)):
            np.testing.assert_array_equal(found, wanted[rows if i < 5 else worlds])


def test_a_world_without_contacts_shows_nothing():
    sim = colliding(Linked(), steps=3)  # the last world has joints only
    reader = reader_of(sim)
    assert reader.read(np.array([0]), begin=True) > 0
    assert reader.images()[0].any()
    assert reader.read(np.array([2]), begin=True) == 0
    assert reader.features().shape == (0, len(LOCAL)) and not reader.images().any()
    start = sim.contacts.numpy("impulse").copy()
    assert reader.correct(torch.zeros(0, len(OUTPUT), dtype=torch.float64)).tolist() == [False]
    np.testing.assert_array_equal(sim.contacts.numpy("impulse"), start)
    reader.read(np.arange(3), begin=True)
    assert [plane.any().item() for plane in reader.images()] == [True, True, False]


def test_room_that_grows_is_taken_up():
    sim = dc.Simulation(*Thesis(bodies=30).build(3, 3).finalize("float64"), contacts_per_body=0.1, pairs_per_shape=0.5)
    grid = dc.Grid.from_box((0.0, 0.0), (9.0, 9.0), 1.0)
    reader = SolveReader(sim, grid)
    room = reader.local.shape[0]
    sim.run(100, DT)
    sim.collide(DT)
    sim.solve(pause=0)
    reader.begin()
    np.testing.assert_array_equal(reader.known, sim.contacts.numpy("impulse"))
    fresh = SolveReader(sim, grid)
    for r in (reader, fresh):
        assert r.read(np.arange(3), begin=True) > room
    for a, b in zip(everything(reader), everything(fresh), strict=True):
        np.testing.assert_array_equal(a, b)
    values = reader.images()[:, :4].contiguous()
    for a, b in zip(reader.gather(values), fresh.gather(values), strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=0)


# ---------------------------------------------------------------------- closed forms


def scene_of(*discs: tuple[Any, ...], gravity: float = 0.0, floor: bool = False, dtype: str = "float64") -> Any:
    """A world of discs (position, radius, velocity, spin), its solve begun."""
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0.0, -gravity), length_scale=1.0)
    if floor:
        builder.add_box(builder.add_body(type=STATIC), 5.0, 0.5, center=(0.0, -0.5), friction=0.5)
    for position, radius, velocity, spin in discs:
        builder.add_disc(builder.add_body(position, 0.0, velocity, spin), radius, friction=0.5)
    sim = dc.Simulation(*builder.finalize(dtype), config=dc.SolverConfig(acceleration="none"))
    sim.collide(DT)
    sim.solve(pause=0)
    return sim, SolveReader(sim, dc.Grid.from_box((-6.0, -2.0), (6.0, 6.0), 0.5))


def test_a_disc_on_the_ground():
    """Mass m falls for one step and slides: the contact wants m g dt, and mu m g dt against the sliding."""
    _, reader = scene_of(((1.25, 0.5), 0.5, (2.0, 0.0), 0.0), gravity=9.8, floor=True)
    assert reader.read(np.array([0]), begin=True) == 1
    mass = math.pi * 0.25
    normal, mu = mass * 9.8 * DT, 0.5
    tangent = -mu * normal  # the tangent of (0, 1) is (1, 0)
    sigma = math.hypot(normal, tangent)
    np.testing.assert_allclose(reader.step[0], [normal, tangent], rtol=1e-12)
    np.testing.assert_allclose(reader.scale[0, [0, 2, 3]], [sigma, 4.0, 5.0 * sigma], rtol=1e-12)
    stop = -mass / 3.0 * 2.0  # what would stop the sliding disc: its effective mass is 1 / (1/m + r^2/I)
    wanted = {
        "step_n": np.arcsinh(normal / sigma),
        "step_t": np.arcsinh(tangent / sigma),
        "free_n": np.arcsinh(normal / sigma),
        "free_t": np.arcsinh(stop / sigma),
        "body_b_n": np.arcsinh(normal / sigma),
        "body_b_t": np.arcsinh(tangent / sigma),
        "degree_b": 0.25,
        "normal_cos": -1.0,
        "new": 1.0,
        "rate": 0.5 * math.log(5.0),
        "rate_near": 0.5 * math.log(5.0),
        "begin": 1.0,
        "size": 0.25 * math.log(sigma / 1e-20),
        "left": 0.25 * math.log(sigma / 1e-4),
    }
    wanted |= {"local_n": wanted["step_n"], "local_t": wanted["step_t"]}
    for name, value in named(reader).items():  # body A is static: it neither moves nor has a degree
        np.testing.assert_allclose(value, wanted.get(name, 0.0), atol=1e-9, err_msg=name)
    np.testing.assert_allclose(reader.place[0], [1.25, 0.0], atol=1e-12)
    np.testing.assert_allclose(reader.place_a[0], [1.25, 0.0], atol=1e-12)  # not the centre of what does not move
    np.testing.assert_allclose(reader.place_b[0], [1.25, 0.5], atol=1e-12)
    # p = (s_t, s_n) in world axes, n = (0, 1); its length is 1 in units of sigma
    total = {name: plane.sum() for name, plane in pictures(reader).items()}
    length = np.arcsinh(1.0)
    shown = {"step_xy": length * tangent / sigma, "step_yy": length * normal / sigma}
    shown |= {"contacts": 1.0, "new": 1.0, "normal_cos": -1.0}
    for name, value in total.items():
        np.testing.assert_allclose(value, shown.get(name, 0.0), atol=1e-9, err_msg=name)


def test_what_is_carried():
    """Impulses before the solve: how much of the cone is used, who presses, who slides; the solve is at rest."""
    sim, reader = scene_of(
        ((0.0, 0.5), 0.5, (0.0, 0.0), 0.0), ((2.0, 0.5), 0.5, (0.0, 0.0), 0.0), gravity=9.8, floor=True
    )
    weight = math.pi * 0.25 * 9.8 * DT
    sim.contacts.numpy("impulse")[:2] = [[2.0 * weight, -weight], [0.5 * weight, 0.1 * weight]]
    sim.solve(pause=0)
    reader.read(np.array([0]), begin=True)
    found = named(reader)
    np.testing.assert_allclose(found["cone"], [-1.0, 0.4], rtol=1e-12)
    np.testing.assert_array_equal(found["closed"], [1.0, 1.0])
    np.testing.assert_array_equal(found["sliding"], [1.0, 0.0])
    # the first lets go of half, the second doubles; nothing slides but by what friction itself has moved
    np.testing.assert_allclose(reader.step[:2], [[-weight, weight], [0.5 * weight, -0.1 * weight]], rtol=1e-9)
    sigma = reader.scale[0, 0]
    np.testing.assert_allclose(sigma, np.sqrt(np.square(reader.step[:2]).sum() / 2.0), rtol=1e-12)
    np.testing.assert_allclose(found["impulse_n"], 0.25 * np.arcsinh([2.0 * weight / sigma, 0.5 * weight / sigma]))
    np.testing.assert_allclose(found["impulse_t"], 0.25 * np.arcsinh([-weight / sigma, 0.1 * weight / sigma]))
    np.testing.assert_allclose(reader.scale[0, 1], weight * math.sqrt((4.0 + 1.0 + 0.25 + 0.01) / 2.0), rtol=1e-12)
    np.testing.assert_allclose(found["contacts"], 0.25 * math.log(2.0))


BY_SIDE = (("body", "_n"), ("body", "_t"), ("degree", ""))
SWAPPED = {f"{name}_{a}{d}": f"{name}_{b}{d}" for a, b in ("ab", "ba") for name, d in BY_SIDE}
DISCS = [
    ((-1.0, 0.0), 0.5, (2.0, 0.3), 0.5),
    ((-0.2, -0.6), 0.5, (0.1, 0.9), -2.0),
    ((0.3, 0.36), 0.6, (-1.0, 0.2), 1.0),
    ((-0.75, 1.0), 0.7, (0.5, -0.9), 3.0),
]


def test_who_is_a_and_who_is_b_does_not_show_in_images():
    """The same discs in the opposite order: every normal is turned round, A and B change places."""
    seen = []
    for order in (1, -1):
        sim, reader = scene_of(*DISCS[::order])
        assert reader.read(np.array([0]), begin=True) == 4
        places = np.lexsort(np.round(reader.place[:4], 9).T)
        slots = contact_slots(reader)[places]
        impulse = np.array([[0.3, 0.1], [0.2, -0.1], [0.0, 0.0], [0.5, 0.2]])
        sim.contacts.numpy("impulse")[slots] = impulse
        sim.solve(pause=0)
        reader.begin()
        # a solve in flight whose last sweep changed them so
        for slot, change in zip(sim.rows.numpy("slot")[slots], 0.1 * impulse[::-1]):
            sim.rows.numpy("change")[[slot, slot + LANES]] = change
        iteration = sim.stats.numpy("iteration")
        iteration["step_before"], iteration["step_last"] = 4.0, 1.0
        sim.contacts.numpy("impulse")[slots] += 0.3 * impulse[[1, 3, 0, 2]]
        for begin in (True, False):
            reader.read(np.array([0]), begin=begin)
            rows = {name: value[places] for name, value in named(reader).items()}
            seen.append((sim.contacts.numpy("normal")[slots], rows, pictures(reader)))
    for (normal, rows, images), (turned, other, mirrored) in zip(seen[:2], seen[2:]):
        np.testing.assert_allclose(turned, -normal, atol=1e-12)
        for name in IMAGE:
            np.testing.assert_allclose(mirrored[name], images[name], atol=1e-9, err_msg=name)
        for name in LOCAL:
            value = rows[SWAPPED.get(name, name)]
            if name.startswith("body"):  # a vector along the normal, which is turned
                value = -value
            if name == "share_a":
                value = 1.0 - value
            np.testing.assert_allclose(other[name], value, atol=1e-9, err_msg=name)
    assert seen[1][2]["since_xx"].any() and seen[1][2]["step_xx"].any()


def test_a_step_is_what_the_last_sweep_changed():
    """By two solves of one sweep more: step, rate and change since the last call as they are defined."""
    sim = colliding(acceleration="none")
    reader = reader_of(sim)
    start, after = sim.contacts.numpy("impulse").copy(), []
    for sweeps in (7, 8, 9):
        sim.contacts.assign("impulse", start)
        sim.solve(dc.SolverConfig(acceleration="none", max_sweeps=sweeps))
        after.append(sim.contacts.numpy("impulse").copy())
    sim.contacts.assign("impulse", start)
    sim.solve(pause=0)
    reader.begin()
    sim.resume(pause=9)
    reader.read(np.arange(3), begin=False)
    slots, found = contact_slots(reader), named(reader)
    before, last = (np.diff(after, axis=0)[i][slots] for i in (0, 1))
    np.testing.assert_allclose(reader.step[: reader.count], last, atol=1e-12)
    for w, part in enumerate(map(slice, reader.packed_start[:3], reader.packed_start[1:4])):
        sigma = math.sqrt(np.square(last[part]).sum() / (part.stop - part.start))
        ratio = math.sqrt(np.square(last[part]).sum() / np.square(before[part]).sum())
        assert 0.3 < ratio < 1.0
        np.testing.assert_allclose(reader.scale[w, [0, 2]], [sigma, ratio / (1.0 - ratio)], rtol=1e-6)
        np.testing.assert_allclose(found["rate"][part], -0.5 * math.log(1.0 - ratio), rtol=1e-6)
        since = (after[-1] - start)[slots][part] / sigma
        np.testing.assert_allclose(found["since_n"][part], 0.5 * np.arcsinh(since[:, 0]), rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(found["since_t"][part], 0.5 * np.arcsinh(since[:, 1]), rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(found["sweeps"][part], 0.25 * math.log(10.0))


def test_the_extrapolation_is_capped():
    sim = colliding(acceleration="none")
    reader = reader_of(sim, cap=8.0)
    sim.resume(pause=5)
    iteration = sim.stats.numpy("iteration")
    iteration["step_before"], iteration["step_last"] = [4.0, 1.0, 1.0], [1.0, 0.9999, 3.0]  # shrink, hardly, grow
    reader.read(np.arange(3), begin=False)
    np.testing.assert_allclose(reader.scale[:3, 2], [1.0, 8.0, 8.0], rtol=1e-9)
    np.testing.assert_allclose(reader.scale[:3, 3], reader.scale[:3, 0] * [2.0, 9.0, 9.0], rtol=1e-9)


def test_features_do_not_depend_on_units():
    """A pile 1024 times larger, faster and heavier, its impulses and their tolerance in proportion."""
    made = []
    for length, density in ((1.0, 1.0), (1024.0, 1.0), (1.0, 1024.0)):
        scene = Settled(bodies=20, radius=0.5 * length, gravity=9.8 * length, density=density)
        momentum = length**3 * density  # mass times speed
        sim = simulation(scene, worlds=2, acceleration="none", tolerance=1e-5 * momentum)
        sim.run(2, DT)
        sim.collide(DT)
        sim.solve(pause=0)
        reader = SolveReader(sim, dc.Grid.from_box((0.0, 0.0), (8.0 * length, 8.0 * length), length))
        reader.begin()
        reader.read(np.arange(2), begin=True)
        seen = [reader.local[: reader.count].copy(), reader.image.copy()]
        sim.resume(pause=5)
        reader.read(np.arange(2), begin=False)
        made.append([*seen, reader.local[: reader.count].copy(), reader.image.copy()])
        made[-1] += [reader.place[: reader.count] / length, reader.step[: reader.count] / momentum]
    assert len(made[0][0]) > 50
    for other in made[1:]:
        for a, b in zip(made[0], other, strict=True):
            np.testing.assert_allclose(a, b, rtol=0, atol=1e-7)
