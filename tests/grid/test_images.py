"""Images of a simulation: what they show, whose memory they are, and the way back to the contacts."""

import gc
import json

import numpy as np
import pytest
import warp as wp

import dc_kernels as dc
from bench import cases
from dc_kernels.grid import splat, transfer
from dc_kernels.grid.area import area_points, wall_nodes
from dc_kernels.grid.channels import BODY_CHANNELS, CONTACT_CHANNELS
from dc_kernels.grid.fields import AREA, POINTS
from dc_kernels.grid.grid import Grid
from dc_kernels.grid.image_spec import ImageSpec
from dc_kernels.grid.images import Images
from dc_kernels.grid.stencil import Stencil
from dc_kernels.measure import contact_slots
from dc_kernels.model.arrays import kernel_array
from dc_kernels.runtime.backends import bind, kernel_file, make_kernels
from pipeline import scenes

STATIC = dc.BodyType.STATIC
GRID = Grid(rows=30, columns=41, spacing=0.25, origin=(-1.0, -1.0))
ALL = {"body_channels": tuple(BODY_CHANNELS), "contact_channels": tuple(CONTACT_CHANNELS)}


def pile(worlds=2, steps=40, dtype="float32", backend="warp", bodies=12, **options):
    """Discs, boxes and capsules that fall into a box; the last world is one disc in the air."""
    builder = dc.ModelBuilder()
    rng = np.random.default_rng(5)
    for w in range(worlds):
        builder.add_world(origin=(100.0 * w, 0.0))
        x = 100.0 * w
        builder.add_chain(builder.add_body((x, 0.0), type=STATIC), [(0.0, 6.0), (0.0, 0.0), (8.0, 0.0), (8.0, 6.0)])
        if w == worlds - 1:
            builder.add_discs([(x + 4.0, 5.0)], 0.5, velocity=(1.0, 2.0), angular_velocity=3.0)
            continue
        for i in range(bodies):
            place = (x + 1.0 + 1.1 * (i % 6) + rng.uniform(-0.05, 0.05), 0.45 + 0.9 * (i // 6))
            body = builder.add_body(place, rng.uniform(-3, 3), rng.uniform(-1, 1, 2), rng.uniform(-2, 2))
            if i % 3 == 0:
                builder.add_disc(body, 0.4)
            elif i % 3 == 1:
                builder.add_box(body, 0.3, 0.25)
            else:
                builder.add_capsule(body, (-0.2, 0.0), (0.2, 0.1), 0.2)
    model, state, joints = builder.finalize(dtype, backend=backend)
    sim = dc.Simulation(model, state, joints, **options)
    sim.run(steps, 0.01)
    return sim


def splats(images):
    """The splats of images: that of the bodies, that of the contacts."""
    return [stage for stage in images._scene._program.stages if isinstance(stage, splat.Splat)]


def body_values(sim, name):
    """A channel's value for every body, in float64."""
    values = {n: sim.state.numpy(n).astype(float) for n in ("velocity", "angle", "angular_velocity")}
    values |= {n: sim.model.numpy(n).astype(float) for n in ("mass", "inertia")}
    speed = np.hypot(*values["velocity"].T)
    return {
        "mass": values["mass"],
        "velocity_x": values["velocity"][:, 0],
        "velocity_y": values["velocity"][:, 1],
        "omega": values["angular_velocity"],
        "inertia": values["inertia"],
        "angle_cos": np.cos(values["angle"]),
        "angle_sin": np.sin(values["angle"]),
        "speed": speed,
    }[name]


def contact_values(sim):
    """Channels by name, for the present contacts of all worlds, in float64; also their points and worlds."""
    slots, world = contact_slots(sim.contacts)
    c = {n: sim.contacts.numpy(n)[slots] for n in ("body_a", "body_b", "age")}
    names = ("normal", "arm_a", "arm_b", "gap", "impulse", "friction")
    c |= {n: sim.contacts.numpy(n)[slots].astype(float) for n in names}
    state = {n: sim.state.numpy(n).astype(float) for n in ("position", "velocity", "angular_velocity")}
    speed = [
        state["velocity"][body] + state["angular_velocity"][body, None] * np.stack([-arm[:, 1], arm[:, 0]], axis=1)
        for body, arm in ((c["body_a"], c["arm_a"]), (c["body_b"], c["arm_b"]))
    ]
    relative, n = speed[1] - speed[0], c["normal"]
    table = {
        "normal_x": n[:, 0],
        "normal_y": n[:, 1],
        "gap": c["gap"],
        "impulse_n": c["impulse"][:, 0],
        "impulse_t": c["impulse"][:, 1],
        "closing_speed": -(n * relative).sum(axis=1),
        "sliding_speed": n[:, 1] * relative[:, 0] - n[:, 0] * relative[:, 1],
        "friction": c["friction"],
        "new": (c["age"] == 0).astype(float),
    }
    return table, state["position"][c["body_a"]] + c["arm_a"], world


@pytest.mark.parametrize("area", [False, True])
@pytest.mark.parametrize("kernel", ["poly6", "bilinear"])
def test_every_channel_keeps_its_sum(kernel, area):
    sim = pile(worlds=3)
    images = Images(sim, ImageSpec(GRID, **ALL, stencil=Stencil(kernel), area=area, walls=None))
    gc.collect()  # what the recorded launches use must outlive the constructor
    images.splat()
    found = images.numpy().astype(float).sum(axis=(2, 3))
    dynamic = sim.model.numpy("body_type") == dc.BodyType.DYNAMIC
    world = np.repeat(np.arange(3), np.diff(sim.model.numpy("body_start")))
    table, _, contact_world = contact_values(sim)
    assert len(contact_world) > 25
    assert {0.0, 1.0} == set(table["new"])
    assert images.channels == (*BODY_CHANNELS, *CONTACT_CHANNELS)
    for c, name in enumerate(images.channels):
        values, owner = (
            (body_values(sim, name) * dynamic, world) if name in BODY_CHANNELS else (table[name], contact_world)
        )
        scale = np.bincount(owner, np.abs(values), 3)
        assert (np.abs(found[:, c] - np.bincount(owner, values, 3)) <= 1e-6 * scale).all(), name
    assert not images.missed_bodies.any()
    assert not images.missed_contacts.any()


@pytest.mark.parametrize("bins", [1, 5])
def test_the_oracle_finds_the_same_features(bins):
    """Each kernel on the same arrays, with every channel."""
    sim = pile(worlds=3, dtype="float64")
    sim.state.numpy("flags")[1] = int(dc.Flag.NONFINITE)
    cells = area_points(sim.model, 0.25)
    groups = {name: getattr(sim, name) for name in ("model", "state", "contacts")}
    found = {}
    for backend in ("warp", "numpy"):
        table, maker = make_kernels(backend, "grid.images", "float64"), kernel_file(backend, "groups")
        values = {
            name: maker.group(name, "float64", group.table, {field: group.numpy(field) for field in group.table})
            for name, group in groups.items()
        }
        for kernel, channels, count, spread in (
            ("body_features", BODY_CHANNELS, len(cells.body), 0),
            ("body_features", BODY_CHANNELS, len(cells.body), 1),
            ("contact_features", CONTACT_CHANNELS, sim.contacts.sizes["contact"], 0),
        ):
            out = {
                "count": np.full(3, -1, np.int32),
                "place": np.zeros((count, 2)),
                "bin": np.full(count, -1, np.int32),
                "value": np.zeros((count, len(channels))),
            }
            codes = np.array([channel.code for channel in channels.values()], np.int32)[::-1].copy()
            area = {"start": cells.start, "body": cells.body, "place": cells.point, "weight": cells.weight}
            arguments = {
                **values,
                "world_offset": 0,
                "bins": bins,
                "channel": kernel_array(codes, backend),
                "area": maker.group("area", "float64", AREA, {"spread": spread, **area}),
                "points": maker.group("points", "float64", POINTS, {k: v for k, v in out.items() if k != "value"}),
                "value": kernel_array(out["value"], backend),
            }
            bind(table[kernel], 3, arguments, "cpu")()
            found.setdefault((kernel, spread), []).append(out)
    for (kernel, _), (warp, numpy) in found.items():
        assert warp["count"][1] == 0  # flagged
        np.testing.assert_array_equal(warp["count"], numpy["count"])
        np.testing.assert_array_equal(warp["bin"], numpy["bin"])
        assert (warp["bin"].max() >= 2) == (bins == 5 and kernel == "contact_features")
        for name in ("place", "value"):
            np.testing.assert_allclose(warp[name], numpy[name], rtol=1e-13, atol=1e-13)


def test_the_numpy_backend_draws_the_same_images():
    options = {"worlds": 2, "steps": 14, "dtype": "float64", "bodies": 5}
    small = Grid(rows=12, columns=15, spacing=0.6)
    found = []
    for backend in ("warp", "numpy"):
        sim = pile(backend=backend, **options)
        images = Images(sim, ImageSpec(small, bins=2))
        for _ in range(2):
            images.splat()
        label = dc.to_numpy(images.impulse_image()).copy()
        back = [dc.to_numpy(images.gather(label, reverse=r)).copy() for r in (False, True)]
        found.append([images.numpy().copy(), label, *back])
    slots, _ = contact_slots(sim.contacts)
    assert len(slots) > 3
    for warp, numpy in zip(*found):
        np.testing.assert_allclose(warp, numpy, rtol=1e-10, atol=1e-10)


def test_numpy_torch_and_warp_see_one_image():
    torch = pytest.importorskip("torch")
    images = Images(pile(), ImageSpec(GRID))
    view, tensor = images.numpy(), images.tensor()
    assert view.ctypes.data == tensor.data_ptr() == images.image.ptr == images.splat().ptr
    assert view.ctypes.data % 64 == 0
    assert tuple(tensor.shape) == view.shape == (2, 6, *GRID.shape)
    assert float(tensor.sum()) == pytest.approx(float(view.sum()), rel=1e-5)
    tensor[1, 2, 3, 4] = 7.0
    assert view[1, 2, 3, 4] == images.image.numpy()[1, 2, 3, 4] == 7.0
    # the way back reads the tensor's own memory: what changes there is seen at the next call
    output = torch.zeros(2, 2, *GRID.shape)
    values = images.gather(output)
    output[:, 0] = 3.0
    output[:, 1] = -1.0
    assert images.gather(output).ptr == values.ptr
    slots, _ = contact_slots(images.sim.contacts)
    np.testing.assert_allclose(dc.to_numpy(values)[slots], np.tile([3.0, -1.0], (len(slots), 1)), rtol=1e-6)


@pytest.mark.parametrize("kind", ["torch", "numpy", "warp"])
def test_an_image_becomes_the_solvers_start(kind):
    rng = np.random.default_rng(1)
    sim = pile()
    images = Images(sim, ImageSpec(GRID))
    source = rng.uniform(0, 5, (2, 2, *GRID.shape)).astype(np.float32)
    image = source
    if kind == "torch":
        image = pytest.importorskip("torch").from_numpy(source)
    elif kind == "warp":
        image = wp.array(source, dtype=wp.float32, device="cpu", copy=False)
    kept = source.copy()
    _, points, world = contact_values(sim)
    slots, _ = contact_slots(sim.contacts)
    points = points.astype(np.float32)
    start = np.searchsorted(world, [0, 1, 2])
    for options in ({}, {"stencil": Stencil("bspline")}, {"stencil": Stencil(h=0.4)}, {"reverse": True}):
        images.start_from(image, **options)
        given = {"stencil": Stencil(), **options} if options.get("reverse") else options
        wanted = transfer.gather(source, points, GRID, start=start, **given)
        np.testing.assert_allclose(sim.contacts.numpy("impulse")[slots], wanted, rtol=2e-5)
        np.testing.assert_array_equal(
            dc.to_numpy(images.gather(image, **options))[slots], sim.contacts.numpy("impulse")[slots]
        )
    np.testing.assert_array_equal(source, kept)


def test_many_images_in_turn_are_each_read():
    sim = pile()
    images = Images(sim, ImageSpec(GRID))
    slots, _ = contact_slots(sim.contacts)
    sources = [np.full((2, 1, *GRID.shape), float(i), np.float32) for i in range(20)]
    for i in (*range(20), 0, 19):
        found = dc.to_numpy(images.gather(sources[i]))[slots]
        np.testing.assert_allclose(found, float(i), rtol=1e-6)


def test_what_is_not_the_right_image_is_refused():
    torch = pytest.importorskip("torch")
    images = Images(pile(), ImageSpec(GRID, bins=2))
    shape = (2, 4, *GRID.shape)
    good = torch.zeros(shape)
    images.start_from(good)
    for image, message in (
        (good.double(), "image has dtype float64; it must be float32"),
        (np.zeros(shape), "image has dtype float64"),
        (np.zeros(shape, ">f4"), "image has dtype >f4"),
        (torch.zeros(2, 4, *GRID.shape[::-1]).transpose(2, 3), "image has strides"),
        (np.zeros((2, 4, 30, 82), np.float32)[..., ::2], "image has strides"),
        (torch.zeros(2, 4, *GRID.shape, device="meta"), "image is on meta"),
        (torch.zeros(shape, requires_grad=True), r"requires a gradient.*image.detach\(\)"),
        (torch.zeros(2, 2, *GRID.shape), r"image has shape \(2, 2, 30, 41\); it must be \(2, 4, 30, 41\)"),
        (torch.zeros(1, 4, *GRID.shape), r"image has shape \(1, 4"),
        (torch.zeros(4, *GRID.shape), r"image has shape \(4, 30, 41\)"),
        (list(range(3)), "image is a list"),
    ):
        with pytest.raises(ValueError, match=message):
            images.start_from(image)
    with pytest.raises(ValueError, match=r"it must be \(2, C \* 2, 30, 41\)"):
        images.gather(np.zeros((2, 3, *GRID.shape), np.float32))
    with pytest.raises(ValueError, match="kernel is 'cubist'"):
        images.gather(good, stencil=Stencil("cubist"))
    with pytest.raises(ValueError, match="those of another simulation"):
        images.starter(lambda images: good)(pile())


def test_bad_settings_are_named():
    sim = pile(steps=1)
    for options, message in (
        ({"body_channels": ("mass", "colour")}, r"body_channels\[1\] is 'colour'; it must be one of"),
        ({"contact_channels": ("gap", "gap")}, r"contact_channels\[1\] is 'gap', which is there already"),
        ({"body_channels": "mass"}, "it must be a tuple"),
        ({"body_channels": (), "contact_channels": ()}, "both empty"),
        ({"bins": 0}, "bins is 0"),
        ({"walls": np.nan}, "walls is nan"),
        ({"area": 1}, "area is 1; it must be True or False"),
        ({"stencil": Stencil(normalize="shepard")}, "normalize is 'shepard'"),
        ({"stencil": Stencil(h=1e9)}, "h is 1000000000.0 m"),
    ):
        with pytest.raises(ValueError, match=message):
            ImageSpec(GRID, **options)
    with pytest.raises(ValueError, match="threads is 0"):
        Images(sim, ImageSpec(GRID), threads=0)
    with pytest.raises(ValueError, match="spec is a Grid; it must be an ImageSpec"):
        Images(sim, GRID)
    with pytest.raises(ValueError, match="grid is a tuple; it must be a Grid"):
        ImageSpec((61, 61))
    plain = Images(sim, ImageSpec(GRID, stencil=Stencil(normalize="sum")))
    with pytest.raises(ValueError, match="reverse needs 'particle'"):
        plain.gather(np.zeros((2, 2, *GRID.shape), np.float32), reverse=True)


def test_a_specification_goes_through_json():
    spec = ImageSpec(GRID, **ALL, stencil=Stencil("cubic", h=0.7, nearest=False), bins=3, walls=None, area=True)
    assert ImageSpec.from_dict(json.loads(json.dumps(spec.to_dict()))) == spec
    for change, message in (
        ({"colour": 1}, "colour"),
        ({"grid": {"rows": 3}}, "values of images are .*; they lack 'origin'"),
        ({"bins": 0}, "bins is 0"),
    ):
        with pytest.raises(ValueError, match=message):
            ImageSpec.from_dict({**spec.to_dict(), **change})


def test_without_contacts_nothing_is_touched():
    sim = pile(worlds=3)
    images = Images(sim, ImageSpec(GRID))
    images.splat()
    assert images.numpy()[:2, 4:].any(axis=(1, 2, 3)).all()
    assert not images.numpy()[2, 4:].any()
    touched = [dc.to_numpy(stage.touched) for stage in splats(images)]
    assert touched[0].any(axis=1).all()
    assert touched[1].any(axis=1).tolist() == [True, True, False]
    # contacts that have gone leave nothing behind; a flagged world shows its walls only
    dc.to_numpy(sim.contacts.contact_count)[0] = 0
    sim.state.numpy("flags")[1] = int(dc.Flag.NONFINITE)
    images.splat()
    assert not images.numpy()[:, 4:].any()
    assert set(np.unique(images.numpy()[1])) == {0.0, 100.0}
    assert not touched[1].any()


def test_normals_are_binned_by_their_direction_modulo_pi():
    sim = pile(worlds=3)
    bins = 4
    plain, binned = (Images(sim, ImageSpec(GRID, body_channels=("mass",), bins=b)) for b in (1, bins))
    plain.splat()
    binned.splat()
    assert binned.channels[:3] == ("mass", "normal_x/0", "normal_y/0")
    image = binned.numpy()[:, 1:].reshape(3, bins, 2, *GRID.shape).astype(float)
    np.testing.assert_allclose(image.sum(axis=1), plain.numpy()[:, 1:], atol=1e-5)
    table, _, world = contact_values(sim)
    angle = np.arctan2(table["normal_y"], table["normal_x"]) % np.pi
    where = np.floor(angle / np.pi * bins + 0.5).astype(int) % bins
    assert len(set(where)) == bins
    for b in range(bins):
        for c, name in enumerate(("normal_x", "normal_y")):
            wanted = np.bincount(world, table[name] * (where == b), 3)
            np.testing.assert_allclose(image[:, b, c].sum(axis=(1, 2)), wanted, atol=1e-5)
    # floor and walls lie in the middle of a bin, whatever the sign of the normal or its last bits
    place = contact_slots(sim.contacts)[0]
    normal = sim.contacts.numpy("normal")
    for n, b in (
        ((0, 1), 2),
        ((1e-7, -1), 2),
        ((1, 0), 0),
        ((-1, 1e-7), 0),
        ((1, -1e-7), 0),
        ((-1, -1), 1),
        ((1, 1), 1),
    ):
        normal[place] = n
        binned.splat()
        sums = np.abs(binned.numpy()[:, 1:]).reshape(3, bins, -1).sum(axis=(0, 2))
        assert np.flatnonzero(sums).tolist() == [b]
        # impulses lie in the same bins, and come back from them
        sim.contacts.numpy("impulse")[...] = 1.0
        label = binned.impulse_image()
        assert np.flatnonzero(dc.to_numpy(label).reshape(3, bins, -1).any(axis=(0, 2))).tolist() == [b]
        binned.start_from(label, reverse=True)
        assert sim.contacts.numpy("impulse")[place].sum() == pytest.approx(2 * len(place), rel=1e-5)


@pytest.mark.parametrize("tiled", [False, True])
def test_walls_carry_their_mass_once(tiled, monkeypatch):
    if tiled:
        monkeypatch.setattr(splat, "TILED_BYTES", 1)
    sim = cases.simulation(scenes.Thesis(bodies=30), 2)
    grid = Grid.thesis()
    images, bare = (Images(sim, ImageSpec(grid, walls=w, stencil=Stencil(h=0.75))) for w in (100.0, None))
    assert [stage.tiled for stage in splats(images)] == [tiled, tiled]
    world, row, column = wall_nodes(sim.model, sim.state, grid)
    walls = np.zeros((2, *grid.shape), np.float32)
    walls[world, row, column] = 100.0
    for _ in range(4):
        images.splat()
        bare.splat()
        np.testing.assert_array_equal(images.numpy()[:, 0], bare.numpy()[:, 0] + walls)
        np.testing.assert_array_equal(images.numpy()[:, 1:], bare.numpy()[:, 1:])
        sim.run(15, 0.01)
    assert bare.numpy()[world, 0, row, column].any()
    assert (images.numpy()[:, 0] == 100.0).sum() > 50


def test_tiles_and_bands_give_the_same_bits(monkeypatch):
    sim = pile()
    wide = Grid(rows=140, columns=150, spacing=0.06, origin=(-0.5, -0.5))
    spec = ImageSpec(wide, bins=2, area=True)
    bands = Images(sim, spec)
    monkeypatch.setattr(splat, "TILED_BYTES", 1)
    tiles = Images(sim, spec, threads=2)
    for _ in range(2):
        np.testing.assert_array_equal(dc.to_numpy(bands.splat()), dc.to_numpy(tiles.splat()))
        np.testing.assert_array_equal(dc.to_numpy(bands.impulse_image()), dc.to_numpy(tiles.impulse_image()))
        sim.run(5, 0.01)


def test_the_area_of_a_disc_has_its_second_moment():
    builder = dc.ModelBuilder()
    builder.add_world()
    builder.add_discs([(1.03, 0.94)], 0.5)
    sim = dc.Simulation(*builder.finalize("float64"))
    grid = Grid(rows=41, columns=41, spacing=0.05)
    images = Images(sim, ImageSpec(grid, body_channels=("mass",), contact_channels=(), area=True))
    images.splat()
    image = images.numpy()[0, 0]
    mass = sim.model.numpy("mass")[0]
    assert image.sum() == pytest.approx(mass, rel=1e-12)
    away = grid.nodes() - (1.03, 0.94)
    # a disc has r^2 / 4 about each axis, the cells up to spacing^2 / 12 less, poly6 adds h^2 / 10
    moments = np.einsum("rc,rci,rcj->ij", image, away, away) / mass
    expected = 0.25 / 4 + 0.1**2 / 10
    assert np.diag(moments) == pytest.approx(expected, abs=0.05**2 / 12)
    assert moments[0, 1] == pytest.approx(0.0, abs=1e-5)


def test_an_area_turns_with_its_body():
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0.0, 0.0))
    body = builder.add_body((2.0, 2.0), angle=0.3)
    builder.add_box(body, 1.0, 0.1)
    sim = dc.Simulation(*builder.finalize("float64"))
    grid = Grid(rows=81, columns=81, spacing=0.05)
    images = Images(sim, ImageSpec(grid, body_channels=("mass",), contact_channels=(), area=True))
    for angle in (0.3, 1.4):
        sim.state.numpy("angle")[0] = angle
        images.splat()
        away = grid.nodes() - 2.0
        moments = np.einsum("rc,rci,rcj->ij", images.numpy()[0, 0], away, away)
        axis = np.linalg.eigh(moments)[1][:, 1]
        assert abs(axis @ (np.cos(angle), np.sin(angle))) == pytest.approx(1.0, abs=1e-4)


def test_bits_do_not_depend_on_threads():
    sim = pile(worlds=5)
    found = []
    for threads in (1, 2, 3):
        images = Images(sim, ImageSpec(GRID, bins=3, area=True), threads=threads)
        image = images.splat()
        label = dc.to_numpy(images.impulse_image())
        back = [dc.to_numpy(images.gather(label, reverse=r)).copy() for r in (False, True)]
        found.append([dc.to_numpy(image).copy(), label.copy(), *back])
    for other in found[1:]:
        for one, two in zip(found[0], other):
            np.testing.assert_array_equal(one, two)
    assert Images(pile(threads=2), ImageSpec(GRID)).threads == 2


def test_images_follow_the_simulation_when_it_grows():
    sim = pile(steps=0, contacts_per_body=0.1)
    images = Images(sim, ImageSpec(GRID))
    images.splat()
    images.impulse_image()
    output = np.full((2, 2, *GRID.shape), 2.0, np.float32)
    images.gather(output)
    room = sim.contacts.sizes["contact"]
    address = images.numpy().ctypes.data
    sim.run(40, 0.01)
    assert sim.contacts.sizes["contact"] > room
    images.splat()
    fresh = Images(sim, ImageSpec(GRID))
    fresh.splat()
    np.testing.assert_array_equal(images.numpy(), fresh.numpy())
    np.testing.assert_array_equal(dc.to_numpy(images.impulse_image()), dc.to_numpy(fresh.impulse_image()))
    assert images.numpy().ctypes.data == address
    images.start_from(output)
    slots, _ = contact_slots(sim.contacts)
    np.testing.assert_allclose(sim.contacts.numpy("impulse")[slots], 2.0, rtol=1e-6)


def test_the_solution_sent_through_the_grid_is_a_start():
    """With h half the contacts' least distance reverse SPH loses nothing; bilinear back keeps a part."""
    sim = cases.settled(100)
    grid = Grid.thesis()
    images = Images(sim, ImageSpec(grid, stencil=Stencil(h=0.24)))

    def solution(images):
        images.sim.solve()
        return images.impulse_image()

    sim.config = dc.SolverConfig.preset("accurate")  # what it sends is solved to the tolerance
    for reverse in (True, False):
        starts = []

        run = images.starter(solution, reverse=reverse)

        def start(sim, run=run, starts=starts):
            run(sim)
            starts.append(sim.contacts.numpy("impulse").copy())

        sim.step(0.01, start=start)
        slots, _ = contact_slots(sim.contacts)
        solved, begun = sim.contacts.numpy("impulse")[slots], starts[0][slots]
        if reverse:
            assert np.abs(begun - solved).max() < 2e-3 * np.abs(solved).max()
            assert sim.stats.numpy("sweeps")[0] < 30
        else:
            assert 0.05 < np.abs(begun[:, 0]).sum() / np.abs(solved[:, 0]).sum() < 0.8


def test_impulses_keep_their_sum_there_and_back():
    sim = pile(worlds=3)
    images = Images(sim, ImageSpec(GRID))
    label = images.impulse_image()
    table, _, world = contact_values(sim)
    for c, name in enumerate(("impulse_n", "impulse_t")):
        scale = np.abs(table[name]).sum()
        sums = dc.to_numpy(label)[:, c].astype(float).sum(axis=(1, 2))
        np.testing.assert_allclose(sums, np.bincount(world, table[name], 3), atol=1e-6 * scale)
        back = dc.to_numpy(images.gather(label, reverse=True))[contact_slots(sim.contacts)[0], c]
        np.testing.assert_allclose(np.bincount(world, back, 3), np.bincount(world, table[name], 3), atol=2e-6 * scale)
    assert images.impulse_image().ptr == label.ptr


def test_an_image_is_read_at_the_bodies_too():
    """A linear field bilinearly; by reverse SPH the masses that were splatted. Static bodies have rows as well."""
    sim = pile()
    spec = ImageSpec(GRID, body_channels=("mass",), contact_channels=(), walls=None, stencil=Stencil(h=0.2))
    images = Images(sim, spec)
    moving = sim.model.numpy("body_type") == dc.BodyType.DYNAMIC
    masses = images.gather(images.splat(), at="bodies", reverse=True).numpy()[:, 0]
    assert masses[moving] == pytest.approx(sim.model.numpy("mass")[moving], rel=1e-5)
    x, y = np.moveaxis(GRID.nodes(), -1, 0)
    field = np.ascontiguousarray(np.broadcast_to(np.stack([x + 2 * y, 3 - x]), (2, 2, *GRID.shape)), np.float32)
    place = sim.state.numpy("position")
    expected = np.column_stack([place[:, 0] + 2 * place[:, 1], 3 - place[:, 0]])
    assert images.gather(field, at="bodies").numpy() == pytest.approx(expected, abs=1e-4)
    with pytest.raises(ValueError, match="at is 'joints'; it must be one of"):
        images.gather(field, at="joints")
