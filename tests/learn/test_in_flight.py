"""A solve in flight as a network reads it: the oracle, closed forms, symmetries, whose memory it is, corrections."""

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
from dc_kernels.model.arrays import ArrayGroup, to_numpy
from dc_kernels.runtime.backends import argument_names, bind
from dc_kernels.runtime.program import Fed
from dc_kernels.solve.rows import COLUMNS, LANES
from pipeline.options import RunOptions
from pipeline.scenes import Mixed, Scene, Settled, Thesis

torch = pytest.importorskip("torch")
torch.set_num_threads(1)

DT = 0.01
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


def simulation(scene: Scene, dtype: str = "float64", worlds: int = 3, run: dict | None = None, **config) -> Any:
    options = RunOptions(worlds=worlds, seed=3, dtype=dtype, **(run or {}))
    return options.simulation(scene, dc.SolverConfig.preset("accurate", **config))


def colliding(scene: Scene | None = None, dtype: str = "float64", steps: int = 100, **options) -> dc.Simulation:
    """Worlds in which things have fallen onto each other, their solve begun."""
    sim = simulation(scene or Thesis(bodies=30), dtype, **options)
    sim.run(steps, DT)
    sim.collide(DT)
    sim.solve(pause=0)
    return sim


def grid_over(sim: dc.Simulation, spacing: float = 1.0) -> dc.Grid:
    position = sim.state.numpy("position").astype(float)
    return dc.Grid.from_box(position.min(axis=0) - spacing, position.max(axis=0) + 2.0 * spacing, spacing)


def reader_of(sim: dc.Simulation, **options) -> SolveReader:
    return SolveReader(sim, grid_over(sim), **options)


def contact_slots(reader: SolveReader) -> np.ndarray:
    """Slots of the contacts last read, in the order of ``local``."""
    first, worlds = reader.sim.contacts.numpy("contact_start"), reader.active[: reader.asked]
    counts = np.diff(reader.packed_start[: reader.asked + 1])
    return np.concatenate([first[w] + np.arange(n) for w, n in zip(worlds, counts)])


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


# ---------------------------------------------------------------------- corrections


def correction(reader: SolveReader, output: np.ndarray) -> np.ndarray:
    """What an output means, by its definition: impulses before projection."""
    x = reader.sim.contacts.numpy("impulse")[contact_slots(reader)]
    scale = np.repeat(reader.scale[: reader.asked], np.diff(reader.packed_start[: reader.asked + 1]), axis=0)
    sigma, size, extrapolation, _ = (column[:, None] for column in scale.T)
    step, free, carried = output[:, 0:2], output[:, 2:4], output[:, 4:6]
    by_step = (1.0 + reader.rate[: reader.count, None]) * step * reader.step[: reader.count]
    return x + by_step + (1.0 + extrapolation) * sigma * (free + carried * x / size)


def test_a_correction_ends_on_the_cone():
    sim = colliding(acceleration="none")
    reader = reader_of(sim)
    sim.resume(pause=4)
    reader.read(np.arange(3), begin=False)
    output = np.random.default_rng(2).normal(0.0, 2.0, (reader.count, len(OUTPUT)))
    slots, wanted = contact_slots(reader), correction(reader, output)
    before, friction = sim.contacts.numpy("impulse").copy(), sim.contacts.numpy("friction")[slots]
    assert (wanted[:, 0] < 0.0).any() and (np.abs(wanted[:, 1]) > friction * wanted[:, 0]).any()
    assert reader.correct(torch.from_numpy(output)).all()
    found = sim.contacts.numpy("impulse")[slots]
    normal = np.maximum(wanted[:, 0], 0.0)
    np.testing.assert_allclose(found[:, 0], normal, atol=1e-12)
    np.testing.assert_allclose(found[:, 1], np.clip(wanted[:, 1], -friction * normal, friction * normal), atol=1e-12)
    np.testing.assert_array_equal(reader.before[slots], before[slots])
    np.testing.assert_array_equal(reader.known[slots], found)
    np.testing.assert_array_equal(sim.stats.numpy("replaced"), [1, 1, 1])


@pytest.mark.parametrize("what", [np.nan, np.inf, -np.inf, 1e30, "limit"])
@pytest.mark.parametrize("column", [0, 3, 4])
def test_what_is_not_finite_or_too_large_is_left_alone(what, column):
    """In its own world alone; of an output of the largest RMS that is taken, just more is not."""
    sim = colliding(dtype="float32", acceleration="none")
    reader = reader_of(sim, limit=7.0)
    sim.resume(pause=4)
    reader.read(np.arange(3), begin=False)
    output = np.full((reader.count, len(OUTPUT)), 0.01, np.float32)
    part = slice(reader.packed_start[1], reader.packed_start[2])
    if what == "limit":
        output[part] = 0.0
        output[part, 2] = 7.001
    else:
        output[part.start + 3, column] = what
    before = sim.contacts.numpy("impulse").copy()
    assert reader.correct(torch.from_numpy(output)).tolist() == [True, False, True]
    slots = contact_slots(reader)
    changed = (sim.contacts.numpy("impulse") != before).any(axis=1)[slots]
    assert not changed[part].any() and changed[: part.start].any() and changed[part.stop :].any()
    np.testing.assert_array_equal(reader.known[slots], sim.contacts.numpy("impulse")[slots])
    assert sim.stats.numpy("replaced").tolist() == [1, 0, 1]
    if what == "limit":
        output[part, 2] = 6.999
        sim.stats.numpy("replaced").fill(0)
        assert reader.correct(torch.from_numpy(output))[1]


def test_only_the_worlds_asked_for_change():
    sim = colliding()
    reader = reader_of(sim)
    before = sim.contacts.numpy("impulse").copy()
    reader.read(np.array([1]), begin=True)
    assert reader.correct(torch.full((reader.count, len(OUTPUT)), 0.1, dtype=torch.float64)).tolist() == [True]
    rows = np.flatnonzero((sim.contacts.numpy("impulse") != before).any(axis=1))
    assert len(rows) and set(rows) <= set(contact_slots(reader))
    assert sim.stats.numpy("replaced").tolist() == [0, 1, 0]


def test_the_solve_takes_a_correction_up():
    """Impulses moved to the solution end the solve at once, in their world alone."""
    sim = colliding(acceleration="none", max_sweeps=5000, min_sweeps=1)
    reader = reader_of(sim)
    start = sim.contacts.numpy("impulse").copy()
    sim.resume()
    solution, sweeps = sim.contacts.numpy("impulse").copy(), sim.stats.numpy("sweeps").copy()
    sim.contacts.assign("impulse", start)
    sim.solve(pause=0)
    sim.resume(pause=5)
    reader.read(np.array([1]), begin=False)
    slots = contact_slots(reader)
    output = np.zeros((reader.count, len(OUTPUT)))
    change = solution[slots] - sim.contacts.numpy("impulse")[slots]
    output[:, 2:4] = change / (reader.scale[0, 0] * (1.0 + reader.scale[0, 2]))
    assert reader.correct(torch.from_numpy(output)).all()
    sim.resume()
    found = sim.stats.numpy("sweeps")
    assert found[1] < 10 < sweeps[1]
    assert found[[0, 2]].tolist() == sweeps[[0, 2]].tolist()


# ---------------------------------------------------------------------- whose memory it is


def test_nothing_is_copied():
    sim = colliding(dtype="float32")
    reader = reader_of(sim)
    count = reader.read(np.array([0, 2]), begin=True)
    images, local = reader.images(), reader.features()
    assert images.shape == (2, len(IMAGE), *reader.grid.shape) and local.shape == (count, len(LOCAL))
    assert images.data_ptr() == reader.image.ctypes.data
    assert local.data_ptr() == to_numpy(reader.reading.array("local")).ctypes.data
    sim.resume(pause=5)
    reader.read(np.array([0, 2]), begin=False)
    assert not local[:, LOCAL.index("begin")].any()  # the tensors of before show what is read now
    trunk = torch.rand(2, 3, *reader.grid.shape)
    near = reader.gather(trunk)
    assert [tuple(value.shape) for value in near] == [(count, 3)] * 3
    assert [a.data_ptr() for a in near] == [b.data_ptr() for b in reader.gather(trunk)]
    first = near[1].clone()
    trunk.mul_(2.0)  # read where it lies, as it is at the time of the call
    torch.testing.assert_close(reader.gather(trunk)[1], 2.0 * first)
    torch.testing.assert_close(reader.gather(3.0 * trunk)[1], 6.0 * first)
    impulse = sim.contacts.numpy("impulse")
    before, output = impulse.copy(), torch.zeros(count, len(OUTPUT))
    output[:, 2] = 1.0
    reader.correct(output)
    assert (impulse != before).any()


def test_what_is_given_is_handed_to_the_kernels_at_its_address(monkeypatch):
    """Neither the network's image nor its output is copied on the way."""
    sim = colliding(dtype="float32")
    reader = reader_of(sim)
    count = reader.read(np.arange(3), begin=True)
    image, output = torch.rand(3, 2, *reader.grid.shape), torch.zeros(count, len(OUTPUT))
    seen = []
    call = Fed.__call__
    monkeypatch.setattr(Fed, "__call__", lambda self, array, at: (seen.append(at), call(self, array, at)))
    reader.gather(image)
    reader.correct(output)
    assert seen == [image.data_ptr()] * 3 + [output.data_ptr()]


def test_gather_is_bilinear_at_three_places():
    sim = colliding()
    reader = reader_of(sim)
    reader.read(np.array([0, 2]), begin=True)
    rows, columns = reader.grid.shape
    x = reader.grid.origin[0] + reader.grid.spacing * torch.arange(columns, dtype=torch.float64)
    y = reader.grid.origin[1] + reader.grid.spacing * torch.arange(rows, dtype=torch.float64)
    plane = torch.stack([x.expand(rows, -1), y[:, None].expand(-1, columns), torch.ones(rows, columns)])
    image = torch.stack([plane, 10.0 * plane]).contiguous()  # the second world asked for
    factor = np.repeat([1.0, 10.0], np.diff(reader.packed_start[:3]))[:, None]
    for value, place in zip(reader.gather(image), (reader.place, reader.place_a, reader.place_b), strict=True):
        wanted = np.column_stack([place[: reader.count], np.ones(reader.count)])
        np.testing.assert_allclose(value.numpy(), factor * wanted, atol=1e-9)


# ---------------------------------------------------------------------- bad input


def test_bad_input_is_refused():
    sim = colliding(dtype="float32")
    reader = reader_of(sim)
    for worlds, message in (
        ([0, 3], r"worlds\[1\] is 3; it must lie in \[0, 2\], above"),
        ([-1], r"worlds\[0\] is -1; it must lie in \[0, 2\]"),
        ([2, 0], r"worlds\[1\] is 0; it must lie"),
        ([1, 1], r"worlds\[1\] is 1; it must lie in \[0, 2\], above"),
        ([0.5], r"worlds has dtype float64"),
        ([[0]], r"worlds has dtype int64, shape \(1, 1\)"),
    ):
        with pytest.raises(ValueError, match=message):
            reader.read(np.array(worlds), begin=True)
    count = reader.read(np.array([0, 1]), begin=True)
    rows, columns = reader.grid.shape
    good = torch.zeros(2, 4, rows, columns)
    for image, message in (
        (good.double(), "image has dtype float64; it must be float32"),
        (good[:1], rf"image has shape \(1, 4, {rows}, {columns}\); it must be \(2, C, {rows}, {columns}\)"),
        (good[0], "image has shape"),
        (good.transpose(2, 3), "it must be contiguous"),
        (good.to(memory_format=torch.channels_last), "it must be contiguous"),
        (good.clone().requires_grad_(), "image requires a gradient"),
        ([1.0], "image is a list"),
    ):
        with pytest.raises(ValueError, match=message):
            reader.gather(image)
    for output, message in (
        (torch.zeros(count + 1, len(OUTPUT)), rf"output has shape \({count + 1}, 6\); it must be \({count}, 6\)"),
        (torch.zeros(count, 4), "output has shape"),
        (torch.zeros(count, len(OUTPUT), dtype=torch.float64), "output has dtype float64"),
        (torch.zeros(len(OUTPUT), count).T, "it must be contiguous"),
    ):
        with pytest.raises(ValueError, match=message):
            reader.correct(output)
    assert not sim.stats.numpy("replaced").any()
    for options, message in (
        ({"cap": 0.0}, "cap is 0.0; it must be > 0"),
        ({"limit": float("nan")}, "limit is nan; it must be > 0"),
        ({"threads": 0}, "threads is 0"),
    ):
        with pytest.raises(ValueError, match=message):
            reader_of(sim, **options)


def test_a_solve_that_is_not_paused_is_refused():
    sim = colliding()
    reader = reader_of(sim)
    sim.resume()
    with pytest.raises(ValueError, match=r"worlds\[0\] is 2, whose solve is not paused"):
        reader.read(np.array([2]), begin=False)
    sim.advance()
    with pytest.raises(ValueError, match="whose solve is not paused"):
        reader.read(np.array([0]), begin=False)


def test_simulations_that_cannot_be_read_are_refused():
    sim = colliding()
    reader = reader_of(sim)
    sim.config = dc.SolverConfig(acceleration="nncg")
    sim.solve(pause=0)
    with pytest.raises(ValueError, match="acceleration is 'nncg'"):
        reader.read(np.array([0]), begin=True)
    colored = dc.Simulation(*Thesis(bodies=5).build(1, 0).finalize(), schedule="color")
    with pytest.raises(ValueError, match="it must be 'cpu' and 'world'"):
        SolveReader(colored, grid_over(colored))
