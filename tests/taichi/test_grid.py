"""Splat, gather, images and their derivatives by Taichi's kernels: the bits of Warp's, on the caller's memory."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import warp as wp

import dc_kernels as dc
from dc_kernels.grid import splat, transfer
from dc_kernels.grid.area import area_points, wall_nodes
from dc_kernels.grid.channels import BODY_CHANNELS, CONTACT_CHANNELS
from dc_kernels.grid.gather import gather_kernel
from dc_kernels.grid.grid import Grid
from dc_kernels.grid.image_spec import ImageSpec
from dc_kernels.grid.images import Images
from dc_kernels.grid.scene import Scene, SceneSplat
from dc_kernels.grid.stencil import BILINEAR, POLY6, Stencil
from dc_kernels.model.arrays import to_numpy
from dc_kernels.runtime.backends import argument_names, make_kernels
from dc_kernels.runtime.program import Fed
from dc_kernels.torch_ops.transfer import gather_torch, splat_torch

pytest.importorskip("taichi")
BACKENDS = ("warp", "taichi")
GRID = Grid(rows=13, columns=19, spacing=0.25, origin=(-1.0, 0.5))
NARROW = Grid(rows=3, columns=5, spacing=0.5)
FILES = {
    "grid.splat": ("float32",),
    "grid.gather": ("float32",),
    "grid.images": ("float32",),
    "grid.tiles": ("float32",),
}


@pytest.mark.parametrize("file", FILES)
def test_kernels_have_the_names_and_arguments_of_warp(file: str) -> None:
    warp, taichi = (make_kernels(backend, file, *FILES[file]) for backend in BACKENDS)
    assert list(taichi) == list(warp)
    assert {n: argument_names(k) for n, k in taichi.items()} == {n: argument_names(k) for n, k in warp.items()}


def cloud(grid: Grid, dtype: str, count: int = 90, channels: int = 3, bins: int = 1) -> dict[str, Any]:
    """Points in and around a grid, of two worlds, with values and bins."""
    draw = np.random.default_rng(3)
    size = np.array([grid.columns - 1, grid.rows - 1]) * grid.spacing
    points = (grid.origin + draw.uniform(-0.2, 1.2, (count, 2)) * size).astype(dtype)
    points[:4] = grid.origin + np.array([[0.0, 0.0], size, [0.5, 0.5], [1e30, -1e30]])
    values = draw.normal(size=(count, channels)).astype(dtype)
    return {"points": points, "values": values, "start": [0, 40, count], "point_bin": draw.integers(0, bins, count)}


def round_trip(grid: Grid, stencil: Stencil, dtype: str, backend: str, *, bins: int = 1, **options: Any) -> list[bytes]:
    """Bytes of a splat and its gather as torch operators, and of all their derivatives."""
    given = cloud(grid, dtype, bins=bins)
    more = {"start": given["start"], "point_bin": given["point_bin"], "bins": bins, "backend": backend, **options}
    points, values = (torch.from_numpy(given[name]).requires_grad_() for name in ("points", "values"))
    image = splat_torch(points, values, grid, stencil, **more)
    results = [image, *torch.autograd.grad((image * image).sum(), (points, values), retain_graph=True)]
    if stencil.normalize != "shepard":
        back = gather_torch(image, points, grid, stencil, **more)
        results += [back, *torch.autograd.grad((back * back).sum(), (points, values))]
    return [result.detach().numpy().tobytes() for result in results]


CASES = {
    "poly6": (GRID, POLY6, "float32", 1),
    "gaussian": (GRID, Stencil("gaussian"), "float32", 1),
    "bilinear": (GRID, BILINEAR, "float32", 1),
    "bspline": (GRID, Stencil("bspline"), "float32", 1),
    "sum": (GRID, Stencil(h=1.1, normalize="sum"), "float32", 2),
    "lost": (GRID, Stencil(h=0.1, nearest=False), "float32", 1),
    "shepard": (GRID, Stencil(normalize="shepard"), "float32", 2),
    "narrow": (NARROW, POLY6, "float32", 1),
    "narrow bspline": (NARROW, Stencil("bspline"), "float32", 3),
    "double": (GRID, Stencil("cubic"), "float64", 1),
    "double bilinear": (GRID, BILINEAR, "float64", 2),
}


@pytest.mark.parametrize("case", CASES)
def test_splat_gather_and_derivatives_have_the_bits_of_warp(case: str) -> None:
    grid, stencil, dtype, bins = CASES[case]
    warp, taichi = (round_trip(grid, stencil, dtype, backend, bins=bins) for backend in BACKENDS)
    assert [a == b for a, b in zip(warp, taichi, strict=True)] == [True] * len(warp)


def test_the_bits_do_not_depend_on_threads() -> None:
    one, two = (round_trip(GRID, POLY6, "float32", "taichi", threads=threads) for threads in (1, 2))
    assert one == two


@pytest.mark.parametrize(("kernel", "support"), [("poly6", 0.8), ("poly6", 0.5), ("bilinear", None)])
def test_tiles_do_not_change_a_bit(kernel: str, support: float | None) -> None:
    grid = Grid(rows=150, columns=140, spacing=0.25, origin=(0.3, -1.0))
    given = cloud(grid, "float32", count=700, bins=2)
    given["points"][9] = np.nan
    first, count = splat.first_and_count(np.array([0, 300, 700]))
    found = []
    for backend, tiled in (("warp", True), ("taichi", False), ("taichi", True)):
        arrays = {"start": first, "count": count, "place": given["points"], "bin": given["point_bin"].astype(np.int32)}
        points = splat.points_group(grid, 2, backend, "float32", **arrays)
        memory = splat.allocate_image(2, 6, grid)
        value, image = (splat.kernel_array(array, backend) for array in (given["values"], memory))
        stencil = Stencil(kernel, h=support)  # type: ignore[arg-type]
        bound = splat.Splat(stencil, grid, points, value, image, bins=2, backend=backend, threads=2, tiled=tiled)
        assert bound.tiled == tiled
        bound()
        bound()  # clears what the first call left
        found.append((memory.tobytes(), bound.missed.tobytes()))
    assert found[0] == found[1] == found[2]


def test_a_reverse_gather_and_points_in_space() -> None:
    given = cloud(GRID, "float32")
    deep = np.concatenate([given["points"], given["values"][:, :1]], axis=1)
    found = []
    for backend in BACKENDS:
        options = {"start": given["start"], "backend": backend}
        image = transfer.splat(deep, given["values"], GRID, **options)
        back = transfer.gather(image, deep, GRID, POLY6, reverse=True, **options)
        found.append((image.tobytes(), back.tobytes()))
    assert found[0] == found[1]


def test_memory_of_numpy_torch_and_warp_is_used_where_it_lies() -> None:
    given = cloud(GRID, "float32", channels=2)
    image = splat.allocate_image(2, 2, GRID)
    points = torch.from_numpy(given["points"])
    values = wp.array(given["values"], dtype=wp.float32, device="cpu", copy=False)
    bound = transfer.Transfer(GRID, backend="taichi").at(points, start=given["start"]).splat(values, image)
    taken = {argument.name: argument.value for argument in bound._launches[0].arguments}
    assert taken["points.place"].ctypes.data == points.data_ptr()
    assert taken["value"].ctypes.data == values.ptr
    assert taken["image"].ctypes.data == image.ctypes.data
    bound()
    once = image.copy()
    bound()  # clears what it touched before
    np.testing.assert_array_equal(image, once)
    assert once.any()


def test_memory_that_would_be_misused_is_refused_by_name() -> None:
    given = cloud(GRID, "float32", channels=1)
    memory = np.zeros(2 * 13 * 19 + 90, np.float32)
    image, inside = memory[: 2 * 13 * 19].reshape(2, 1, 13, 19), memory[400:490].reshape(90, 1)
    bound = transfer.Transfer(GRID, backend="taichi").at(given["points"], start=given["start"])
    with pytest.raises(ValueError, match="image shares memory with values"):
        bound.splat(inside, image)
    frozen = image.copy()
    frozen.flags.writeable = False
    with pytest.raises(ValueError, match="image is read-only"):
        bound.splat(given["values"], frozen)
    with pytest.raises(ValueError, match="values has strides"):
        bound.splat(np.zeros((90, 2), np.float32)[:, :1], image)


def test_an_image_is_read_where_each_call_gives_it() -> None:
    given = cloud(GRID, "float32", channels=2)
    start = np.array(given["start"])
    found = []
    for backend in BACKENDS:
        first, count = splat.first_and_count(start)
        points = splat.points_group(GRID, 2, backend, "float32", start=first, count=count, place=given["points"])
        values = np.zeros((90, 2), np.float32)
        arrays = [splat.kernel_array(array, backend) for array in (splat.allocate_image(1, 2, GRID), values)]
        fed = Fed(gather_kernel(BILINEAR, GRID, points, *arrays, most=50, backend=backend), "image", 2, backend=backend)
        for seed in (1, 2):
            image = torch.rand((2, 2, 13, 19), generator=torch.Generator().manual_seed(seed))
            fed(image, image.data_ptr())
            found.append(values.tobytes())
    assert found[:2] == found[2:] and found[0] != found[1]


def pile(dtype: str) -> dc.Simulation:
    """Discs and boxes that have fallen into a box, in two worlds."""
    builder = dc.ModelBuilder()
    for w in range(2):
        builder.add_world(origin=(100.0 * w, 0.0))
        ground = builder.add_body((100.0 * w, 0.0), type=dc.BodyType.STATIC)
        builder.add_chain(ground, [(0.0, 3.0), (0.0, 0.0), (4.0, 0.0), (4.0, 3.0)])
        for i in range(6):
            body = builder.add_body((100.0 * w + 0.6 + 0.55 * i, 0.4 + 0.1 * w), 0.4 * i, (0.3 * i, -0.1), 0.2 * i)
            builder.add_disc(body, 0.3) if i % 2 else builder.add_box(body, 0.25, 0.2)
    sim = dc.Simulation(*builder.finalize(dtype))
    sim.run(12, 0.01)
    sim.collide(0.01)
    return sim


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_images_of_bodies_and_contacts_have_the_bits_of_warp(dtype: str) -> None:
    sim, grid = pile(dtype), Grid(rows=16, columns=20, spacing=0.25, origin=(-0.4, -0.4))
    spec = ImageSpec(
        grid,
        body_channels=tuple(BODY_CHANNELS),
        contact_channels=tuple(CONTACT_CHANNELS),
        bins=3,
        area=True,
        walls=100.0,
    )
    found = {}
    for backend in BACKENDS:
        groups = {
            name: {field: array.copy() for field, array in getattr(sim, name).views().items()}
            for name in ("model", "state", "contacts")
        }
        scene = Scene(**groups, worlds=2, room=sim.contacts.sizes["contact"], backend=backend, dtype=dtype)
        memory = splat.allocate_image(2, len(spec.channels), grid, dtype)
        image = splat.kernel_array(memory, backend)
        stage = SceneSplat(
            spec,
            scene,
            image,
            bodies=area_points(sim.model, grid.spacing),
            walls=wall_nodes(sim.model, sim.state, grid),
        )
        stage()
        stage()
        points = {name: to_numpy(getattr(stage.contact_points, name)).tobytes() for name in ("place", "bin", "count")}
        found[backend] = [memory.tobytes(), stage.missed_bodies.tobytes(), stage.missed_contacts.tobytes(), points]
        assert memory[0, : len(BODY_CHANNELS)].any(axis=(1, 2)).all()
    assert found["warp"] == found["taichi"]


def test_images_of_a_simulation_and_the_way_back_have_the_bits_of_warp(tmp_path: Path) -> None:
    settled = pile("float32")
    settled.solve()
    settled.advance()
    settled.save(tmp_path / "pile.h5")
    spec = ImageSpec(Grid(rows=16, columns=20, spacing=0.25, origin=(-0.4, -0.4)), bins=3, area=True, walls=100.0)
    found = []
    for backend in BACKENDS:
        sim = dc.Simulation.load(tmp_path / "pile.h5", backend=backend)
        images = Images(sim, spec)
        images.splat()
        label = images.impulse_image()
        sim.contacts.numpy("impulse")[...] = 0.0
        images.start_from(label)
        assert sim.contacts.numpy("impulse").any()
        found.append([images.numpy().tobytes(), to_numpy(label).tobytes(), sim.contacts.numpy("impulse").tobytes()])
    assert found[0] == found[1]
